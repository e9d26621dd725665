from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

import programs
from nmes.backend.fingerprint import fingerprint
from nmes.cli import main
from nmes.errors import RecordingError
from nmes.playback import replay, states, watch, world_at
from nmes.playback.drift import measure_drift
from nmes.playback.export import messages
from nmes.playback.log import Log
from nmes.playback.log_replay import replay_log
from nmes.protocol import Request, parse
from nmes.recording import REFUSED_LIMIT, Recorder, Recording
from nmes.world import World
from recordings import Line, busy, changed, divergence, first, record, rewrite, send


@pytest.fixture(scope="module")
def busy_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("replay") / "busy.mcap", busy)


# -- what is recorded is reproduced ----------------------------------------------------------------------------------


def test_a_recording_is_reproduced(busy_file: Path) -> None:
    report = replay(busy_file)
    assert (report.verdict, report.ticks, report.commands) == ("reproduced", 40, 47)
    assert report.sim_seconds == pytest.approx(40 / 60)
    assert report.speed > 0
    assert report.divergence is None and report.damage is None and report.differences == {}


frames = st.sampled_from(
    [
        b'{"type":"spawn_cube","position":[1,2,3]}',
        b'{"type":"spawn_cube","cube_name":"named","is_base":true}',
        b'{"type":"despawn_cube","cube_name":"named_BASE"}',
        b'{"type":"apply_physics","force":[1.1,2.2,3.3],"impulse":[0.1,0,0]}',
        b'{"type":"apply_force","force":[0,30,0]}',
        b'{"type":"set_cube_state","cube_name":"named_BASE","position":[0,9,0]}',
        b'{"type":"freeze_cube","cube_name":"named_BASE","freeze":false}',
        b'{"type":"create_joint","cube1":"named_BASE","cube2":"named_BASE","joint_type":"fixed"}',
        b'{"type":"get_world_state"}',
        b'{"type":"get_world_info","id":[1,null]}',
        b'{"type":"step","ticks":3}',
        b'{"type":"pause"}',
        b'{"type":"resume"}',
        b'{"type":"set_mode","mode":"lockstep"}',
        b'{"type":"set_mode","mode":"fast"}',
        b'{"type":"reset","seed":5}',
        b'{"type":"subscribe","every":2}',
        b'{"type":"batch","commands":[{"type":"spawn_cube"},{"type":"nonsense"},{"type":"step"}]}',
        b'{"type":"apply_physics","impulse":[1e15,0,0]}',
        b'{"type":"spawn_cube","mass":-1}',
        b'{"type":"nonsense","id":"x"}',
        b"[1,2]",
        b"\xff",
        b"not json " * 10_000,
    ]
)
recorded_inputs = st.lists(
    st.one_of(
        st.tuples(st.just("frame"), st.integers(0, 2), frames),
        st.tuples(st.just("tick"), st.integers(1, 8), st.none()),
        st.tuples(st.sampled_from(["join", "leave", "flush"]), st.integers(0, 2), st.none()),
    ),
    max_size=40,
)


@settings(max_examples=80, deadline=None)
@given(recorded_inputs, st.sampled_from(["ballistic", "pymunk"]), st.sampled_from([0.0, 10.0, 60.0]))
def test_any_history_is_reproduced(
    tmp_path_factory: pytest.TempPathFactory, program: list[Any], backend: str, pose_rate: float
) -> None:
    def play(world: World, client: int) -> None:
        clients = [client]
        for what, number, frame in program:
            match what:
                case "tick":
                    for _ in range(number):
                        world.tick()
                case "join":
                    clients.append(world.join())
                case "leave" if len(clients) > 1:
                    world.leave(clients.pop(number % len(clients)))
                case "frame":
                    world.handle(clients[number % len(clients)], parse(frame))
                case "flush":
                    assert isinstance(world.journal, Recorder)
                    world.journal.flush()

    path = record(tmp_path_factory.mktemp("any") / "x.mcap", play, {"backend": backend}, pose_rate=pose_rate)
    recording = Recording(path)
    assert recording.complete
    report = replay(recording)
    assert report.verdict == "reproduced", report.divergence
    summary = recording.summary()
    assert (report.ticks, report.commands) == (summary.ticks, summary.commands.total() + summary.refused)


@pytest.mark.parametrize("backend", ["mujoco", "pymunk", "ballistic"])
@pytest.mark.parametrize("number", range(3))
def test_structures_are_reproduced(tmp_path: Path, backend: str, number: int) -> None:
    def play(world: World, client: int) -> None:
        for step in programs.draw(number, 120):
            for command in programs.commands(world, step):
                world.execute(client, command)

    path = record(tmp_path / "x.mcap", play, {"backend": backend})
    report = replay(path)
    assert report.verdict == "reproduced", report.divergence
    assert report.ticks > 50


def test_faults_are_reproduced_in_commands_and_by_the_clock(tmp_path: Path) -> None:
    def play(world: World, client: int) -> None:
        for by_clock in (False, True):
            send(world, client, type="spawn_cube", cube_name="far")
            while world.fault is None:
                send(world, client, type="apply_physics", cube_name="far", impulse=[1e15, 0, 0])
                world.tick() if by_clock else send(world, client, type="step")
            send(world, client, type="spawn_cube")
            world.tick()
            send(world, client, type="reset")

    path = record(tmp_path / "x.mcap", play)
    assert Recording(path).summary().faults == 2
    assert replay(path).verdict == "reproduced"

    def edit(lines: list[Line]) -> list[Line]:
        at = first(lines, "faults")
        return changed(lines, at, lines[at].data.replace(b"diverged", b"exploded"))

    result = divergence(path, tmp_path, edit)
    assert result.kind == "fault" and "exploded" in result.message


def test_refused_frames_that_were_not_kept_whole_are_reproduced(tmp_path: Path) -> None:
    def play(world: World, client: int) -> None:
        world.handle(client, parse(b'{"type":"spawn_cube","mass":-1,"id":3,"x":"%s"}' % (b"y" * REFUSED_LIMIT)))
        world.execute(client, {"type": "spawn_cube", "mass": object()})

    path = record(tmp_path / "x.mcap", play)
    report = replay(path)
    assert (report.verdict, report.commands) == ("reproduced", 2)


BATCH: list[dict[str, Any]] = [
    {"type": "spawn_cube", "cube_name": "a", "position": [0, 9, 0]},
    {"type": "step", "ticks": 3},
    {"type": "spawn_cube", "cube_name": "b"},
    {"type": "step", "ticks": 100},
    {"type": "spawn_cube", "cube_name": "c"},
]


@pytest.mark.parametrize("backend", ["ballistic", "pymunk"])
@pytest.mark.parametrize("command", [{"type": "step", "ticks": 100}, {"type": "batch", "commands": BATCH}])
def test_a_recording_that_stops_inside_a_command_is_replayed_to_its_last_tick(
    tmp_path: Path, backend: str, command: dict[str, Any]
) -> None:
    class Told(BaseException):
        pass

    def stop() -> None:
        if world.frame == 7:
            raise Told

    # As a host does that is told to stop.
    path = tmp_path / "x.mcap"
    world = World({"backend": backend, "mode": "lockstep"})
    recorder = world.journal = Recorder(path, world)
    world.between = stop
    client = world.join()
    with pytest.raises(Told):
        send(world, client, **command)
    recorder.close()
    cubes, poses = world.poses()

    report = replay(path)
    assert (report.verdict, report.ticks, report.commands, report.frames) == ("reproduced", 7, 0, (0, 7))
    assert report.damage is None
    recording = Recording(path)
    assert [state.frame for state in states(recording)] == [1, 2, 3, 4, 5, 6, 7]
    for frame in (None, 2):
        there = world_at(recording, frame)
        assert there.frame == (7 if frame is None else 2)
        if frame is None:
            assert there.cubes() == cubes
            np.testing.assert_array_equal(there.poses()[1], poses)
        there.close()
    frames = []
    for _ in watch(recording, lambda world: frames.append(world.frame)):
        pass
    assert frames == [1, 2, 3, 4, 5, 6, 7]
    for engine in ("ballistic", backend):
        drift = measure_drift(recording, engine)
        assert (drift.ticks, drift.commands, drift.ended) == (7, 1, None)
    rows = b"".join(orjson.dumps(row) + b"\n" for row in messages(recording))
    (tmp_path / "x.jsonl").write_bytes(rows)
    log = replay_log(Log(tmp_path / "x.jsonl"))
    assert (log.verdict, log.digests, log.passed_over) == ("reproduced", 7, {"commands without their answer": 1})


def test_a_recording_that_a_crash_cut_in_a_command_is_reproduced_up_to_there(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    world = World({"backend": "ballistic", "mode": "lockstep"})
    recorder = world.journal = Recorder(path, world)
    world.between = lambda: recorder.flush() if world.frame == 7 else None
    send(world, world.join(), type="step", ticks=100)
    recorder.close()
    path.write_bytes(path.read_bytes()[: next(Recording(path).chunks())[0]])
    report = replay(path)
    assert (report.verdict, report.ticks, report.commands, report.frames) == ("reproduced", 7, 0, (0, 7))
    assert report.cut and report.damage is not None
    assert Recording(path).last_frame == 7
    there = world_at(Recording(path))
    assert there.frame == 7
    there.close()


def test_an_exception_in_the_replay_itself_is_no_divergence(busy_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*args: object) -> None:
        raise ZeroDivisionError("a mistake")

    monkeypatch.setattr("nmes.playback.recording_replay._RecordingReplay._compare_poses", fail)
    with pytest.raises(ZeroDivisionError):
        replay(busy_file)


def test_progress_goes_up_to_the_size(busy_file: Path) -> None:
    calls: list[tuple[int, int]] = []
    replay(busy_file, progress=lambda done, total: calls.append((done, total)))
    size = busy_file.stat().st_size
    assert calls and all(0 < done <= total == size for done, total in calls)
    assert calls == sorted(calls)


# -- on other machines -----------------------------------------------------------------------------------------------


@pytest.fixture
def elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lets this machine compute, so it seems, otherwise than those that recordings were made on."""
    monkeypatch.setattr("nmes.playback.report.fingerprint", lambda backend: {**fingerprint(backend), "probe": "0ff"})


@pytest.mark.usefixtures("elsewhere")
def test_equal_digests_are_reproduced_on_another_machine_too(busy_file: Path) -> None:
    report = replay(busy_file)
    assert (report.verdict, report.ticks, report.divergence) == ("reproduced", 40, None)
    assert report.differences == {"probe": (Recording(busy_file).fingerprint["probe"], "0ff")}


@pytest.mark.usefixtures("elsewhere")
def test_other_digests_on_another_machine_are_not_comparable(busy_file: Path, tmp_path: Path) -> None:
    harder = Recording(rewrite(busy_file, tmp_path / "harder.mcap", push_harder))
    report = replay(harder)
    assert report.verdict == "not_comparable" and report.divergence is not None
    for run_again in (lambda: world_at(harder, 30), lambda: [*states(harder)]):
        with pytest.raises(RecordingError, match="recorded with another probe") as error:
            run_again()
        assert error.value.code == "not_comparable"


@pytest.mark.parametrize("item", ["architecture", "simd", "libc", "python", "os", "cpu", "cpu_flags"])
def test_names_of_processors_and_libraries_decide_nothing(
    busy_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, item: str
) -> None:
    monkeypatch.setattr("nmes.playback.report.fingerprint", lambda backend: {**fingerprint(backend), item: "other"})
    assert replay(busy_file).differences == {}
    assert replay(rewrite(busy_file, tmp_path / "harder.mcap", push_harder)).verdict == "diverged"


def test_an_engine_that_is_not_installed_is_not_comparable(busy_file: Path) -> None:
    recording = Recording(busy_file)
    recording.config["backend"] = "no-such-engine"
    report = replay(recording)
    assert (report.verdict, report.ticks) == ("not_comparable", 0)
    assert report.differences == {"backend": ("no-such-engine", "not installed")}


def test_a_world_that_changes_a_command_diverges(busy_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # A world that behaves otherwise than when it was recorded, not a recording that was changed.
    perform = World.handle

    def handle(world: World, client: int, request: Request) -> bytes:
        if request.type == "apply_physics" and world.frame > 10:
            request = parse(request.raw.replace(b"1.5", b"1.6"))
        return perform(world, client, request)

    monkeypatch.setattr(World, "handle", handle)
    report = replay(busy_file)
    assert report.verdict == "diverged"
    assert report.divergence is not None and report.divergence.kind == "digest"
    assert report.ticks == report.divergence.frame - 1 >= 10


# -- the commands ----------------------------------------------------------------------------------------------------


def run(*arguments: str | Path) -> tuple[int, str]:
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.output


def test_nmes_replay_prints_the_verdict(busy_file: Path, tmp_path: Path) -> None:
    code, output = run("replay", busy_file)
    assert code == 0
    assert output.startswith("reproduced: 40 ticks, 47 commands, ")
    assert output.endswith(" times faster than real time\n")

    def edit(lines: list[Line]) -> list[Line]:
        at = next(i for i, line in enumerate(lines) if b'"cube_info"' in line.data)
        return changed(lines, at, lines[at].data.replace(b'"mass":1', b'"mass":3'))

    edited = rewrite(busy_file, tmp_path / "edited.mcap", edit)
    code, output = run("replay", edited)
    assert code == 1
    assert "diverged at frame 1" in output
    assert "cube one: mass: recorded 3" in output and "now 1" in output and "differs by 2" in output


def test_nmes_replay_prints_json(busy_file: Path, tmp_path: Path) -> None:
    code, output = run("replay", busy_file, "--json")
    report = json.loads(output)
    assert code == 0
    assert (report["verdict"], report["ticks"], report["commands"]) == ("reproduced", 40, 47)
    path = rewrite(busy_file, tmp_path / "x.mcap", lambda lines: [*lines[:3], *lines[5:]])
    code, output = run("replay", path, "--json")
    report = json.loads(output)
    assert (code, report["verdict"]) == (1, "diverged")
    assert {"frame", "kind", "cube", "field", "expected", "actual", "difference", "seen"} <= set(report["divergence"])


def test_nmes_replay_and_info_report_damage(busy_file: Path, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(busy_file.read_bytes()[:-100])
    code, output = run("replay", path)
    assert code == 0
    assert "reproduced: 40 ticks" in output and "incomplete: the file ends in its summary" in output
    path.write_bytes(busy_file.read_bytes().replace(b"application/octet-stream", b"application/octet-strean", 1))
    code, output = run("replay", path)
    assert code == 2
    assert "DAMAGED: the checksum of the summary does not match" in output
    code, output = run("info", path)
    assert code == 0
    assert "no: the checksum of the summary does not match" in output
    for command in ("replay", "info"):
        code, output = run(command, tmp_path)
        assert code == 2
        assert "is not a regular file" in output


@pytest.mark.usefixtures("elsewhere")
def test_nmes_replay_says_what_differs_on_another_machine(busy_file: Path, tmp_path: Path) -> None:
    code, output = run("replay", busy_file)
    assert code == 0
    assert output.startswith("reproduced, on another machine: 40 ticks, 47 commands, ")
    assert "\n  probe: " in output and "(here: 0ff)" in output
    assert json.loads(run("replay", busy_file, "--json")[1])["drift"] is None
    harder = rewrite(busy_file, tmp_path / "harder.mcap", push_harder)
    code, output = run("replay", harder)
    assert code == 3
    assert output.startswith("not comparable: it was recorded with another\n  probe: ")
    assert run("fork", harder, "--at", "30", "--output", tmp_path / "fork.mcap")[0] == 3
    assert run("export", harder, "--to", "csv", "--output", tmp_path / "x.csv")[0] == 3


@pytest.mark.parametrize("command", ["diff", "export"])
def test_the_old_name_of_an_option_works_and_is_not_in_the_help(busy_file: Path, tmp_path: Path, command: str) -> None:
    harder = rewrite(busy_file, tmp_path / "harder.mcap", push_harder)
    other = record(tmp_path / "other.mcap", busy, {"gravity": [0, -1, 0]})
    arguments: dict[str, list[str | Path]] = {
        "diff": [harder, other],
        "export": [harder, "--to", "csv"],
    }
    refused = run(command, *arguments[command])[1]
    output = run(command, *arguments[command], "--keep-going")[1]
    assert output != refused and output == run(command, *arguments[command], "--anyway")[1]
    assert "--keep-going" in run(command, "--help")[1] and "--anyway" not in run(command, "--help")[1]


def push_harder(lines: list[Line]) -> list[Line]:
    return [line._replace(data=line.data.replace(b"[1.5,0.25,0]", b"[1.5,0.26,0]")) for line in lines]


@pytest.mark.usefixtures("elsewhere")
def test_a_replay_on_another_machine_measures_the_drift(tmp_path: Path) -> None:
    # As if the engine pushed harder here: 2 N more for a tick.
    def strengthen(lines: list[Line]) -> list[Line]:
        at = next(i for i, line in enumerate(lines) if b'"force":[1.5' in line.data)
        lines[at] = lines[at]._replace(data=lines[at].data.replace(b"[1.5", b"[3.5"))
        return lines

    path = rewrite(record(tmp_path / "x.mcap", busy, pose_rate=60), tmp_path / "y.mcap", strengthen)
    code, output = run("replay", path)
    assert code == 3 and "it agrees as far as 0 ticks" in output
    assert "metres from where each cube was recorded" in output
    drift = json.loads(run("replay", path, "--json")[1])["drift"]
    ends = {name: samples[-1]["distance"] for name, samples in drift["cubes"].items()}
    assert ends["one"] == pytest.approx(2 / 60 * 39.5 / 60, rel=0.02)  # on 1 kg, for the 40 ticks
    assert ends["two"] < 1e-6


def test_nmes_info_counts_faults(tmp_path: Path) -> None:
    def play(world: World, client: int) -> None:
        send(world, client, type="spawn_cube", cube_name="far")
        send(world, client, type="apply_physics", cube_name="far", impulse=[1e15, 0, 0])
        send(world, client, type="step")

    code, output = run("info", record(tmp_path / "x.mcap", play))
    assert code == 0
    assert "\nfaults" in output


def test_nmes_info_shows_what_a_recording_is(busy_file: Path) -> None:
    code, output = run("info", busy_file)
    assert code == 0
    rows = {line.split("  ", 1)[0]: line.split("  ", 1)[1].strip() for line in output.splitlines() if line[0] != " "}
    assert rows["world"] == "main, seed 0"
    assert rows["engine"].startswith("ballistic")
    assert rows["ticks"] == "40"
    assert rows["clients"] == "2"
    assert rows["complete"] == "yes"
    assert "  apply_physics" in output
    code, output = run("info", busy_file, "--json")
    about = json.loads(output)
    assert code == 0
    assert (about["ticks"], about["commands"]["step"], about["complete"]) == (40, 9, True)
