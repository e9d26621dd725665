"""Which recordings a host removes from its folder, and which it never does."""

from __future__ import annotations

import logging
import os
from pathlib import Path

import pytest
from click.testing import CliRunner
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from nmes import Client
from nmes.cli import main
from nmes.recording import Recorder, Recording
from nmes.recording.signing import sign
from nmes.server.retention import DAY, Retention
from nmes.world import World
from processes import process, ready
from servers import PASSWORD, PATIENCE, until

NOW = 1_000 * DAY


def record(folder: Path, name: str, age: float, *, closed: bool = True) -> Path:
    """Writes a recording that was last written so many days before `NOW`."""
    path = folder / f"{name}.mcap"
    world = World({"backend": "ballistic", "mode": "lockstep"})
    world.journal = recorder = Recorder(path, world, flush_interval=0)
    world.tick()
    recorder.flush()
    text = path.read_bytes()
    recorder.close()
    if not closed:
        path.write_bytes(text)
    world.journal = None
    world.close()
    os.utime(path, (NOW - age * DAY,) * 2)
    return path


def left(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_what_is_older_than_so_many_days_is_removed_the_oldest_first(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for name, age in (("b", 31), ("c", 29), ("a", 31), ("z", 300)):
        record(tmp_path, name, age)
    (tmp_path / "notes.txt").write_text("no recording")
    os.utime(tmp_path / "notes.txt", (0, 0))
    (tmp_path / "folder.mcap").mkdir()
    (tmp_path / "link.mcap").symlink_to(tmp_path / "z.mcap")
    with caplog.at_level(logging.INFO):
        removed = Retention(tmp_path, 30, None).sweep(NOW, ())
    assert [path.name for path in removed] == ["z.mcap", "a.mcap", "b.mcap"]
    assert left(tmp_path) == ["c.mcap", "folder.mcap", "link.mcap", "notes.txt"]
    assert "MB of recordings, the oldest first: z.mcap, a.mcap, b.mcap" in caplog.text


def test_too_much_is_brought_down_to_the_limit_and_no_further(tmp_path: Path) -> None:
    paths = [record(tmp_path, name, age) for name, age in (("a", 3), ("b", 2), ("c", 1))]
    size = sum(path.stat().st_size for path in paths)
    assert Retention(tmp_path, None, size).sweep(NOW, ()) == []
    assert Retention(tmp_path, None, size - 1).sweep(NOW, ()) == paths[:1]
    assert Retention(tmp_path, 2.5, 0).sweep(NOW, ()) == paths[1:]


def test_what_is_signed_marked_or_being_written_stays(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    signed, marked, writing = (record(tmp_path, name, 500) for name in ("signed", "marked", "writing"))
    fresh = record(tmp_path, "fresh", 0.9, closed=False)  # that another host may be writing
    stale = record(tmp_path, "stale", 1.1, closed=False)  # what a kill has left
    sign(Recording(signed), Ed25519PrivateKey.generate())
    (tmp_path / "marked.mcap.keep").touch()
    retention = Retention(tmp_path, 1, 0)
    with caplog.at_level(logging.INFO):
        assert retention.sweep(NOW, {writing}) == [stale]
        assert retention.sweep(NOW, {writing}) == []
    assert {path.name for path in (signed, marked, writing, fresh)} <= set(left(tmp_path))
    assert caplog.text.count("more than the 0.0 MB of --keep") == 1  # told once
    (tmp_path / "marked.mcap.keep").unlink()
    assert retention.sweep(NOW, {writing}) == [marked]
    assert retention.sweep(NOW, ()) == [writing]


def test_what_is_being_written_stays_however_its_folder_is_called(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writing = [record(tmp_path, name, 500) for name in ("a", "b")]
    (tmp_path / "link").symlink_to(tmp_path)
    monkeypatch.chdir(tmp_path)
    for folder, others in ((Path("."), tmp_path), (tmp_path, Path("link")), (Path("link"), Path())):
        assert Retention(folder, 1, 0).sweep(NOW, {others / path.name for path in writing}) == []


def test_a_folder_that_is_not_there_yet_is_no_failure(tmp_path: Path) -> None:
    assert Retention(tmp_path / "no", 1, 1).sweep(NOW, ()) == []


def test_nmes_serve_removes_old_recordings_and_says_so_but_not_the_one_it_writes(tmp_path: Path) -> None:
    old, kept = record(tmp_path, "old", 999), record(tmp_path, "kept", 999)
    (tmp_path / "kept.mcap.keep").touch()
    options = ["--port", "0", "--backend", "ballistic", "--mode", "lockstep", "--record", str(tmp_path)]
    with process("serve", "--json", *options, "--keep", "30d", "--keep", "1MB", NMES_PASSWORD=PASSWORD) as server:
        line = ready(server)
        until(lambda: not old.exists())
        with Client(port=line["port"], password=PASSWORD, timeout=PATIENCE) as client:
            client.step()
        server.terminate()
        _, err = server.communicate(timeout=PATIENCE)
    assert server.returncode == 0
    assert "MB of recordings, the oldest first: old.mcap\n" in err
    assert kept.exists() and Recording(line["recording"]).complete


@pytest.mark.parametrize(
    "options", [["--keep", "30"], ["--keep", "0d"], ["--keep", "-1d"], ["--keep", "1GB", "--keep", "2MB"],
                ["--keep", "9d", "--no-record"], ["--keep", "1e9GB"]]
)  # fmt: skip
def test_what_cannot_be_kept_is_wrong_usage(options: list[str], tmp_path: Path) -> None:
    outcome = CliRunner().invoke(
        main, ["serve", "--port", "0", "--record", str(tmp_path / "no"), *options], env={"NMES_PASSWORD": PASSWORD}
    )
    assert outcome.exit_code == 2 and "--keep" in outcome.output
