from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from nmes.backend.fingerprint import fingerprint
from nmes.cli import main
from nmes.errors import RecordingError
from nmes.playback.export import messages
from nmes.playback.fork import fork
from nmes.playback.log import Log
from nmes.playback.log_replay import LogReport, replay_log
from nmes.recording import Recording
from nmes.world import World
from recordings import busy, record, send

Rows = list[dict[str, Any]]


def written(path: Path, rows: Rows) -> Log:
    path.write_text("".join(f"{json.dumps(row)}\n" for row in rows))
    return Log(path)


def exported(path: Path) -> Rows:
    return [dict(row) for row in messages(Recording(path))]


def faulting(world: World, client: int) -> None:
    for by_clock in (False, True):
        send(world, client, type="spawn_cube", cube_name="far")
        while world.fault is None:
            send(world, client, type="apply_physics", cube_name="far", impulse=[1e15, 0, 0])
            world.tick() if by_clock else send(world, client, type="step")
        send(world, client, type="reset")


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> Rows:
    return exported(record(tmp_path_factory.mktemp("logs") / "busy.mcap", busy))


@pytest.mark.parametrize("play", [busy, faulting])
def test_an_exported_recording_is_reproduced(tmp_path: Path, play: Callable[[World, int], None]) -> None:
    path = record(tmp_path / "x.mcap", play, {"seed": 7})
    summary = Recording(path).summary()
    report = replay_log(written(tmp_path / "x.jsonl", exported(path)))
    assert (report.verdict, report.divergence) == ("reproduced", None)
    assert report.commands == report.replies == summary.commands.total()
    assert report.ticks == report.digests == summary.ticks
    assert report.passed_over == ({"refused frames": summary.refused} if summary.refused else {})


def test_structures_on_other_engines_are_reproduced_from_a_log(tmp_path: Path) -> None:
    def play(world: World, client: int) -> None:
        one, two = (send(world, client, type="spawn_cube", position=[0, y, 0])["spawned"] for y in (3, 5))
        send(world, client, type="create_joint", cube1=one, cube2=two, joint_type="hinge")
        send(world, client, type="step", ticks=20)
        send(world, client, type="get_world_state")

    path = record(tmp_path / "x.mcap", play, {"backend": "mujoco"})
    assert replay_log(written(tmp_path / "x.jsonl", exported(path))).verdict == "reproduced"


def test_a_log_that_begins_with_a_keyframe_is_replayed_from_it(tmp_path: Path) -> None:
    parent = record(tmp_path / "parent.mcap", busy, {"seed": 7})
    world = World({"backend": "ballistic", "mode": "lockstep", "seed": 7})
    recorder = fork(Recording(parent), world, tmp_path / "child.mcap", 20)
    send(world, world.join(), type="step", ticks=30)
    recorder.close()
    rows = exported(tmp_path / "child.mcap")
    report = replay_log(written(tmp_path / "x.jsonl", rows))
    assert (report.verdict, report.divergence, report.passed_over) == ("reproduced", None, {})
    assert (report.ticks, report.digests) == (30, 30)
    assert rows[1]["kind"] == "keyframe"
    late = replay_log(written(tmp_path / "x.jsonl", [rows[0], *rows[2:], rows[1]]))
    assert late.divergence is not None and late.divergence.kind == "client"
    late = replay_log(written(tmp_path / "x.jsonl", [*rows, rows[1]]))
    assert late.divergence is not None and late.divergence.kind == "order"
    for snapshot, message in (("?", "is no keyframe"), ("e30=", "is no keyframe"), (3, "does not have the shape")):
        rows[1]["message"] = {"snapshot": snapshot}
        with pytest.raises(RecordingError, match=f"line 2 {message}"):
            replay_log(written(tmp_path / "x.jsonl", rows))


def where(rows: Rows, kind: str, **parts: Any) -> int:
    return next(
        i for i, row in enumerate(rows) if row["kind"] == kind and parts.items() <= dict(row["message"]).items()
    )


@pytest.mark.parametrize(
    ("spoil", "kind"),
    [
        (lambda rows: rows[where(rows, "reply", type="cube_info")]["message"].update(mass=3), "reply"),
        (lambda rows: rows[where(rows, "command", type="apply_physics")]["message"].update(force=[9, 0, 0]), "digest"),
        (lambda rows: rows[where(rows, "ticks")]["message"]["digests"].__setitem__(0, "0" * 32), "digest"),
        (lambda rows: rows.pop(where(rows, "reply", type="physics_applied")), "order"),
        (lambda rows: rows.pop(where(rows, "ticks")), "order"),
        (lambda rows: rows.pop(where(rows, "command", type="step")), "order"),
        (lambda rows: rows.pop(where(rows, "joined")), "order"),
        (lambda rows: rows[where(rows, "joined")].update(client=4), "client"),
    ],
)
def test_a_log_that_was_changed_diverges(tmp_path: Path, rows: Rows, spoil: Callable[[Rows], Any], kind: str) -> None:
    rows = json.loads(json.dumps(rows))
    spoil(rows)
    report = replay_log(written(tmp_path / "x.jsonl", rows))
    assert report.verdict == "diverged"
    assert report.divergence is not None and report.divergence.kind == kind, report.divergence
    assert report.divergence.message.startswith(f"line {report.divergence.record}")
    if kind == "reply":
        assert report.divergence.value is not None
        assert (report.divergence.value.cube, report.divergence.value.field) == ("one", "mass")


BARE: Rows = [
    {"type": "auth", "password": "secret"},
    {"type": "auth_success", "protocol": 1},
    {"type": "spawn_cube", "cube_name": "a", "position": [0, 5, 0]},
    {"type": "apply_physics", "cube_name": "a", "impulse": [1, 0, 0]},
    {"type": "step", "ticks": 60},
    {"type": "stepped", "frame": 60, "t": 1.0},
    {"type": "boo"},
    {"type": "get_cube_info", "cube_name": "b", "id": 8},
    {"type": "state", "frame": 60},
]


def ran(path: Path, rows: Rows) -> LogReport:
    return replay_log(written(path, rows))


def test_messages_without_metadata_are_run_and_compared_as_far_as_possible(tmp_path: Path) -> None:
    report = ran(tmp_path / "x.jsonl", BARE)
    assert (report.verdict, report.whole) == ("agrees", False)
    assert (report.commands, report.replies, report.ticks, report.digests) == (5, 1, 60, 0)
    assert report.passed_over == {"auth messages": 1, "auth_success messages": 1, "state messages": 1}
    assert [line.split(": ")[:2] for line in report.refused] == [
        ["line 7", "unknown_type"],
        ["line 8", "cube_not_found"],
    ]
    only = [row for row in BARE if row["type"] != "stepped"]
    assert (ran(tmp_path / "only.jsonl", only).verdict) == "ran"
    wrong = [{**row, "frame": 61} if row["type"] == "stepped" else row for row in BARE]
    report = ran(tmp_path / "wrong.jsonl", wrong)
    assert report.verdict == "diverged" and report.divergence is not None and report.divergence.value is not None
    assert (report.divergence.record, report.divergence.value.field) == (6, "frame")


def test_answers_are_matched_to_their_commands(tmp_path: Path) -> None:
    asked = [{"type": "ping", "id": i} for i in range(3)]
    assert ran(tmp_path / "a.jsonl", [*asked, {"type": "pong", "id": 1}, {"type": "pong", "id": 2}]).replies == 2
    report = ran(tmp_path / "b.jsonl", [*asked, {"type": "pong", "id": 7}])
    assert report.divergence is not None and report.divergence.kind == "reply"
    report = ran(tmp_path / "c.jsonl", [{"type": "pong"}])
    assert report.divergence is not None and report.divergence.kind == "order"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"type":"ping"}\n{"type"\n', "line 2 is not JSON"),
        ('{"type":"ping"}\n\n[1]\n', "line 3 is no JSON object"),
        ('{"a":1}\n', "line 1 is neither a message"),
        ('{"kind":"ticks","message":{"frame":1}}\n', "line 1 does not have the shape of ticks"),
        ('{"kind":"reply","message":7}\n', "line 1 does not have the shape of reply"),
        ('{"kind":"command","client":"x","message":{}}\n', "line 1 has no number of a client"),
        ('{"kind":"recording","message":{"nmes.world":{}}}\n', "line 1 does not say how its world began"),
    ],
)
def test_an_invalid_log_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "x.jsonl"
    path.write_text(text)
    with pytest.raises(RecordingError, match=message):
        replay_log(Log(path))
    code, output = run("replay", path)
    assert code == 2 and message in output and "Traceback" not in output


def said(client: int, **message: Any) -> dict[str, Any]:
    return {"kind": "command", "client": client, "message": message}


def test_clients_of_whom_a_log_does_not_say_that_they_came_have_their_numbers(tmp_path: Path) -> None:
    world = World({"mode": "lockstep"})
    client = [world.join() for _ in range(3)][-1]
    told = send(world, client, type="get_world_info")
    assert told["counts"]["clients"] == 3
    answer = {"kind": "reply", "client": client, "message": told}
    assert ran(tmp_path / "x.jsonl", [said(client, type="get_world_info"), answer]).verdict == "agrees"


def test_a_client_that_left_says_nothing_more(tmp_path: Path) -> None:
    came, left = ({"kind": kind, "client": 1, "message": {"client": 1, "event": kind}} for kind in ("joined", "left"))
    report = ran(tmp_path / "x.jsonl", [came, left, said(1, type="ping")])
    assert report.divergence is not None
    assert report.divergence.message == "line 3 has client 1 says something, and is not there"


def test_a_number_that_no_client_comes_to_is_refused(tmp_path: Path) -> None:
    assert ran(tmp_path / "x.jsonl", [said(65_536, type="ping")]).verdict == "ran"
    for number in (65_537, 2**53 - 1):
        with pytest.raises(RecordingError, match="line 2 is of client"):
            ran(tmp_path / "x.jsonl", [said(1, type="ping"), said(number, type="ping")])


def test_the_lines_before_a_wrong_one_are_run(tmp_path: Path) -> None:
    path = tmp_path / "x.jsonl"
    path.write_text('{"type":"ping"}\n{"type":"stepped","frame":1}\n{"type"\n')
    report = replay_log(Log(path))
    assert report.divergence is not None and report.divergence.record == 2


# -- the command -----------------------------------------------------------------------------------------------------


def run(*arguments: str | Path) -> tuple[int, str]:
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.output


def test_nmes_replay_takes_what_nmes_export_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, target = record(tmp_path / "x.mcap", busy), tmp_path / "x.jsonl"
    assert run("export", source, "--to", "jsonl", "--output", target)[0] == 0
    code, output = run("replay", target)
    assert code == 0
    assert output.startswith("reproduced: 38 commands, 38 replies compared; 40 ticks, 40 digests compared\n")
    code, output = run("replay", target, "--json")
    assert (code, json.loads(output)["verdict"]) == (0, "reproduced")
    code, output = run("replay", target, "--backend", "mujoco")
    assert code == 2 and "a log goes with --json only" in output
    target.write_text(target.read_text().replace('"force":[1.5,0.25,0]', '"force":[1.5,0.5,0]'))
    code, output = run("replay", target)
    assert code == 1
    assert "does not come out the same: its digest differs" in output
    monkeypatch.setattr("nmes.playback.report.fingerprint", lambda backend: {**fingerprint(backend), "probe": "0ff"})
    code, output = run("replay", target)
    assert code == 3 and output.startswith("not comparable") and "(here: 0ff)" in output
    assert run("export", source, "--to", "jsonl", "--output", target)[0] == 0
    code, output = run("replay", target)
    assert code == 0 and output.startswith("reproduced, on another machine: 38 commands") and "(here: 0ff)" in output


def test_nmes_replay_says_what_of_a_bare_log_was_compared(tmp_path: Path) -> None:
    path = tmp_path / "x.jsonl"
    path.write_text("".join(f"{json.dumps(row)}\n" for row in BARE if row["type"] != "stepped"))
    code, output = run("replay", path)
    assert code == 0
    assert output.startswith("ran: 5 commands, 0 replies compared; 60 ticks, 0 digests compared\n")
    assert "it was run in a new one, in lockstep" in output
    assert "nothing could be compared" in output
    assert "refused, line 6: unknown_type" in output
    assert "passed over: 1 state messages" in output
