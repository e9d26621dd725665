"""Hosts that are started again with the folder of their recordings: all worlds are there, and go on from their ends."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from click.testing import CliRunner

from fleets import PLAIN, Fleet, kill, settle
from nmes.cli import main
from nmes.errors import CommandFailed
from nmes.playback.fork import fork
from nmes.recording import Recorder, Recording
from nmes.server.kept_worlds import CLOSED, kept_worlds
from nmes.world import World
from processes import process, ready
from recordings import Line, record, rewrite
from servers import PASSWORD, PATIENCE

DURABLE = ("--flush-interval", "0")
ALONE_AND_SHARED = pytest.mark.parametrize("workers", [(), ("--workers", "2")], ids=["one process", "workers"])


@contextmanager
def serving(folder: Path, *options: str) -> Iterator[Fleet]:
    arguments = ["--json", "--port", "0", "--record", str(folder), *PLAIN, *options]
    with process("serve", *arguments, NMES_PASSWORD=PASSWORD) as server:
        yield Fleet(server, folder, ready(server))


def end(host: Fleet) -> None:
    """Ends a host and its workers such that none of them can do anything about it."""
    for pid in (host.server.pid, *host.workers()):
        kill(pid)
    host.server.wait(PATIENCE)


class Twin:
    """A world that gets what a hosted one gets, and is never disturbed."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.digests: list[str] = []
        self._world = World({"backend": "ballistic", "mode": "lockstep", "keyframes": 10.0, "name": name})
        self._client = self._world.join()

    def drive(self, host: Fleet, ticks: int) -> None:
        """Drives both on."""
        with host.client(self.name) as client:
            for _ in range(ticks):
                number = len(self.digests)
                spawn = {"type": "spawn_cube", "cube_name": f"c{number}", "position": [number, 2, 0]}
                push = {"type": "apply_physics", "cube_name": f"c{number // 2}", "impulse": [number % 5, 1, 0]}
                for command in (spawn, push, {"type": "step"}):
                    assert client.request(command)["type"] != "error"
                    self._world.execute(self._client, command)
                self.digests.append(self._world.digest().hex())


@ALONE_AND_SHARED
def test_all_worlds_of_a_host_that_was_killed_go_on_where_they_ended(workers: tuple[str, ...], tmp_path: Path) -> None:
    red, *_ = twins = [Twin(name) for name in ("red", "green", "blue")]
    with serving(tmp_path, *workers, *DURABLE, "--worlds", "red,green") as host:
        host.client().create_world("blue")
        for ticks, twin in enumerate(twins, 3):
            twin.drive(host, ticks)
        end(host)
    with serving(tmp_path, *workers, *DURABLE, "--resume", str(tmp_path), "--worlds", "green,pink") as host:
        worlds = host.worlds()
        assert list(worlds) == ["green", "pink", "blue", "red"]  # first those that are named
        assert [worlds[name]["asleep"] for name in worlds] == [True, False, True, True]
        assert host.info["resumed"] == 3 and host.info["world_count"] == 4
        red.drive(host, 4)
        with host.client() as client:  # the first world is for those who name none
            assert client.get_world_info()["frame"] == 4
        end(host)
    with serving(tmp_path, *workers, *DURABLE, "--resume", str(tmp_path)) as host:
        assert list(host.worlds()) == ["blue", "green", "red"]
        for twin in twins:
            twin.drive(host, 2)
        host.stop()
    for twin in twins:
        assert host.digests(twin.name) == twin.digests
    assert len(red.digests) == 9 and len(sorted(tmp_path.glob("red-*.mcap"))) == 3


def test_a_world_whose_host_is_killed_while_it_goes_on_from_a_recording_ends_where_that_ended(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    config = {"backend": "pymunk", "mode": "lockstep", "name": "red"}
    whole = record(tmp_path / "red-20260101T000000.000000Z.mcap", lambda world, client: world.tick(), config)
    recording, world = Recording(whole), World(config)
    about = {"nmes.parent": recording.lineage(recording.last_frame)}
    begun = Recorder(tmp_path / "red-20260101T000001.000000Z.mcap", world, about=about)
    found = kept_worlds(tmp_path)
    assert [(name, kept.path) for name, kept in found.items()] == [("red", whole)]
    assert "000001.000000Z.mcap is left where it is: it ends before the frame" in caplog.text
    gone_on = fork(recording, world, tmp_path / "red-20260101T000002.000000Z.mcap")
    assert kept_worlds(tmp_path)["red"].path == gone_on.path
    for recorder in (begun, gone_on):
        recorder.close()


def test_a_recording_that_begins_with_a_newer_keyframe_is_told_of_where_a_world_would_go_on_from_it(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    def make_newer(lines: list[Line]) -> list[Line]:
        assert lines[0].topic == "keyframes"
        return [lines[0]._replace(data=b'{"version":99}\n'), *lines[1:]]

    config = {"backend": "mujoco", "mode": "lockstep", "name": "re_d"}  # beside it there might be one called "re:d"
    whole, newer, newest = (tmp_path / f"re_d-20260101T00000{second}.000000Z.mcap" for second in range(3))
    parent, world = Recording(record(whole, lambda world, client: world.tick(), config)), World(config)
    fork(parent, world, newest).close()
    world.close()
    rewrite(newest, newer, make_newer)
    assert kept_worlds(tmp_path)["re_d"].path == newest
    assert caplog.text == ""  # nobody looks at how those before it begin
    newest.unlink()
    assert kept_worlds(tmp_path)["re_d"].path == whole
    assert f"{newer} is left where it is: a keyframe has a snapshot of version 99" in caplog.text
    (tmp_path / CLOSED).write_text(f"{newer.name}\n")
    assert kept_worlds(tmp_path) == {}


@ALONE_AND_SHARED
def test_a_world_that_only_just_goes_on_when_its_host_is_killed_loses_nothing(
    workers: tuple[str, ...], tmp_path: Path
) -> None:
    red = Twin("red")
    with serving(tmp_path, *workers, "--worlds", "red") as host:
        red.drive(host, 3)
        host.stop()
    for _ in range(2):
        with serving(tmp_path, *workers, "--resume", str(tmp_path), "--flush-interval", "60") as host:
            with host.client("red") as client:
                assert client.get_world_info()["frame"] == 3
            end(host)
    assert len(sorted(tmp_path.glob("red-*.mcap"))) == 3


@ALONE_AND_SHARED
def test_worlds_that_were_closed_for_good_stay_closed(workers: tuple[str, ...], tmp_path: Path) -> None:
    with serving(tmp_path, *workers, *DURABLE, "--worlds", "red,green,blue") as host:
        for name in ("red", "green"):
            Twin(name).drive(host, 2)
        host.client().close_world("green")
        host.client().close_world("blue")  # which nobody had entered
        host.client().create_world("green", seed=5)
        host.client().create_world("pink")
        host.client().close_world("pink")
        host.stop()
    with serving(tmp_path, *workers, "--resume", str(tmp_path)) as host:
        assert list(host.worlds()) == ["green", "red"]
        with host.client("green") as client:
            assert client.get_world_info()["frame"] == 0  # it is the second of that name
        host.client().close_world("red")  # that sleeps
        host.stop()
    assert list(kept_worlds(tmp_path)) == ["green"]


@ALONE_AND_SHARED
def test_worlds_stay_those_of_their_makers_and_of_nobody_else(workers: tuple[str, ...], tmp_path: Path) -> None:
    folder, makers = tmp_path / "recordings", tmp_path / "makers"
    makers.mkdir()
    for maker in ("ann", "bob"):
        (makers / maker).write_text(f"of {maker}")
    options = [*workers, *DURABLE, "--makers", str(makers)]

    def worlds_of(host: Fleet, maker: str) -> list[str]:
        return [world["world"] for world in host.client(password=f"of {maker}").worlds()]

    with serving(folder, *options, "--worlds", "main") as host:
        for maker, names in (("ann", ("red", "green")), ("bob", ("blue",))):
            for name in names:
                host.client(password=f"of {maker}").create_world(name)
        for name in ("red", "main"):
            Twin(name).drive(host, 2)
        end(host)
    (makers / "bob").unlink()
    again = [*options, "--resume", str(folder), "--max-worlds-each", "1"]  # of which ann has two already
    for frame in (2, 3):  # the second time from recordings that go on from others
        with serving(folder, *again) as host:
            assert list(host.worlds()) == ["blue", "green", "main", "red"]
            assert worlds_of(host, "ann") == ["green", "red"]
            with host.client("red", password="of ann") as client:
                assert client.get_world_info()["frame"] == frame
                client.step()
            for name, password in (("main", "of ann"), ("blue", "of ann"), ("blue", "of bob")):
                with pytest.raises(CommandFailed) as refused:
                    host.client(name, password=password).connect()
                assert refused.value.code == "auth_failed"
            with pytest.raises(CommandFailed) as refused:
                host.client(password="of ann").create_world("pink")
            assert refused.value.code == "limit_reached"
            host.server.terminate()
            _, err = host.server.communicate(timeout=PATIENCE)
        assert "of a world that 'bob' created, who is none of --makers" in err
    (makers / "bob").write_text("of bob")
    with serving(folder, *again) as host:
        assert worlds_of(host, "bob") == ["blue"]  # nobody was in it meanwhile
        assert [world["world"] for world in host.client(password="of ann").close_world("red")] == ["green"]


def test_a_world_stays_that_of_its_maker_where_a_host_goes_on_with_its_recording_alone(tmp_path: Path) -> None:
    folder, makers = tmp_path / "recordings", tmp_path / "makers"
    makers.mkdir()
    (makers / "ann").write_text("of ann")
    options = [*DURABLE, "--makers", str(makers)]
    with serving(folder, *options) as host:
        host.client(password="of ann").create_world("red")
        Twin("red").drive(host, 2)
        host.stop()
    for frame in (2, 3):
        newest = max(folder.glob("red-*.mcap"))
        arguments = ["--json", "--port", "0", "--record", str(folder), *options, "--resume", str(newest)]
        with process("serve", *arguments, NMES_PASSWORD=PASSWORD) as server:
            host = Fleet(server, folder, ready(server))
            with host.client("red", password="of ann") as client:
                assert client.get_world_info()["frame"] == frame
                client.step()
            assert [world["world"] for world in host.client(password="of ann").worlds()] == ["red"]
            host.stop()


@pytest.mark.parametrize("how", ["a recording", "a folder", "a folder with workers"])
def test_a_world_of_a_maker_is_opened_by_a_password_of_its_own_too(how: str, tmp_path: Path) -> None:
    folder, makers, passwords = tmp_path / "recordings", tmp_path / "makers", tmp_path / "passwords"
    for directory, name, password in ((makers, "ann", "of ann"), (passwords, "red", "of red")):
        directory.mkdir()
        (directory / name).write_text(password)
    options = [*DURABLE, "--makers", str(makers)]
    with serving(folder, *options) as host:
        host.client(password="of ann").create_world("red")
        Twin("red").drive(host, 2)
        host.stop()
    kept = next(folder.glob("red-*.mcap")) if how == "a recording" else folder
    workers = ["--workers", "2"] if how == "a folder with workers" else []
    again = [*options, *workers, "--record", str(folder), "--world-passwords", str(passwords), "--resume", str(kept)]
    with process("serve", "--json", "--port", "0", *again, NMES_PASSWORD=PASSWORD) as server:
        host = Fleet(server, folder, ready(server))
        for password in ("of ann", "of red"):
            assert [world["world"] for world in host.client(password=password).worlds()] == ["red"]
            with host.client("red", password=password) as client:
                assert client.get_world_info()["frame"] == 2
        with pytest.raises(CommandFailed) as refused:
            host.client(password="of red").close_world("red")
        assert refused.value.code == "auth_failed"
        assert list(host.client(password="of ann").close_world("red")) == []
        host.stop()


def test_roles_of_worlds_that_a_folder_keeps_have_passwords_without_their_config(tmp_path: Path) -> None:
    folder, config, secret = tmp_path / "recordings", tmp_path / "arena.json", tmp_path / "player"
    config.write_text('{"roles": {"player": {}}}')
    secret.write_text("of players")
    role = ["--role", f"player={secret}"]
    with serving(folder, *role, "--config", str(config), "--worlds", "red") as host:
        Twin("red").drive(host, 1)
        host.stop()
    with serving(folder, *role, "--resume", str(folder)) as host:
        with host.client("red", password="of players") as client:
            assert client.welcome["role"] == "player"
        host.stop()


def test_a_world_whose_recording_is_damaged_is_told_of_and_others_go_on(tmp_path: Path) -> None:
    with serving(tmp_path, *DURABLE, "--worlds", "red,green") as host:
        for name in ("red", "green"):
            Twin(name).drive(host, 3)
        host.stop()
    (path,) = tmp_path.glob("red-*.mcap")
    reached = [offset for offset, _ in Recording(path).chunks()]
    path.write_bytes(path.read_bytes()[: reached[len(reached) // 2]])
    (tmp_path / "pink-20260101T000000.000000Z.mcap").write_bytes(b"")  # as a full disk leaves one
    shutil.copy(path, tmp_path / "mine.mcap")
    (tmp_path / "notes.txt").write_text("x")
    with serving(tmp_path, "--resume", str(tmp_path)) as host:
        assert list(host.worlds()) == ["green", "red"]
        with host.client("red") as client:
            assert client.get_world_info()["frame"] < 3  # up to where it can be read
        path = next(iter(tmp_path.glob("green-*.mcap")))
        path.unlink()
        with pytest.raises(CommandFailed) as refused:
            host.client("green").connect()
        assert refused.value.code == "world_unavailable"
        host.server.terminate()
        _, err = host.server.communicate(timeout=PATIENCE)
    assert "pink-20260101T000000.000000Z.mcap is left where it is" in err and "Traceback" not in err


def test_worlds_whose_files_are_called_alike_are_all_kept(tmp_path: Path) -> None:
    names = ["a+b", "a_b", "a:b", "ab", "x" * 64]
    with serving(tmp_path, "--worlds", ",".join(names)) as host:
        for name in names:
            Twin(name).drive(host, 1)
        host.stop()
    assert list(kept_worlds(tmp_path)) == sorted(names)
    with serving(tmp_path, "--resume", str(tmp_path)) as host:
        with host.client("a:b") as client:
            assert client.get_world_info()["frame"] == 1
        host.client().close_world("a_b")
        host.stop()
    assert list(kept_worlds(tmp_path)) == sorted({*names} - {"a_b"})
    assert len((tmp_path / CLOSED).read_text().split()) == 1


def test_an_empty_folder_keeps_no_worlds(tmp_path: Path) -> None:
    with serving(tmp_path, "--resume", str(tmp_path)) as host:
        assert list(host.worlds()) == ["main"] and "resumed" not in host.info
        host.stop()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--at", "3"], "--at needs --resume FILE"),
        (["--max-worlds", "1"], "2 worlds are more than --max-worlds 1 allows"),
    ],
)
def test_what_does_not_fit_a_folder_is_refused(arguments: list[str], says: str, tmp_path: Path) -> None:
    with serving(tmp_path, "--worlds", "red,green") as host:
        for name in ("red", "green"):
            Twin(name).drive(host, 1)
        host.stop()
    outcome = CliRunner().invoke(main, ["serve", "--resume", str(tmp_path), *arguments], env={"NMES_PASSWORD": "x"})
    assert outcome.exit_code == 2 and says in outcome.output


def test_recordings_that_may_be_gone_on_from_are_not_removed(tmp_path: Path) -> None:
    with serving(tmp_path, "--worlds", "red,green") as host:
        for name in ("red", "green"):
            Twin(name).drive(host, 1)
        host.stop()
    for options in ((), ("--keep", "0.001MB")):
        with serving(tmp_path, "--resume", str(tmp_path), *options) as host:
            with host.client("red") as client:
                client.step()
            if options:
                settle(lambda: len(sorted(tmp_path.glob("red-*.mcap"))) < 3)
                with host.client("green") as client:
                    assert client.get_world_info()["frame"] == 1
            host.stop()
