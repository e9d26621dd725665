from __future__ import annotations

import random
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import orjson
import pytest

from nmes.playback import replay
from nmes.protocol import Request
from nmes.recording import Kind
from nmes.recording.records import said_by, who_said
from nmes.world import World
from recordings import Line, busy, changed, commands_of, divergence, first, record, rewrite


@pytest.fixture(scope="module")
def busy_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("replay") / "busy.mcap", busy)


def test_a_changed_digest_is_found_at_its_tick(busy_file: Path, tmp_path: Path) -> None:
    def edit(lines: list[Line]) -> list[Line]:
        at = [i for i, line in enumerate(lines) if line.topic == "ticks"][3]
        ticks = orjson.loads(lines[at].data)
        ticks["digests"][0] = "0" * 32
        frame.append(ticks["frame"])
        return changed(lines, at, orjson.dumps(ticks))

    frame: list[int] = []
    result = divergence(busy_file, tmp_path, edit)
    assert (result.kind, result.frame) == ("digest", frame[0])
    assert result.value is None  # nothing else is different


def test_a_changed_input_is_found_at_its_tick_and_shown(busy_file: Path, tmp_path: Path) -> None:
    def edit(lines: list[Line]) -> list[Line]:
        at = next(i for i in commands_of(lines) if b"apply_physics" in lines[i].data)
        record = orjson.loads(lines[at].data)
        force = record["message"]["force"]
        force[0] = float(np.nextafter(force[0], 2))
        tick = orjson.loads(lines[first(lines, "ticks", at)].data)
        frame.append(tick["frame"])
        return changed(lines, at, orjson.dumps(record))

    frame: list[int] = []
    result = divergence(busy_file, tmp_path, edit)
    assert (result.kind, result.frame) == ("digest", frame[0])
    assert result.value is not None and result.seen is not None and result.seen >= result.frame
    assert result.value.cube == "one"
    assert result.value.field in ("position/0", "linear_velocity/0")
    assert result.value.amount is not None and 0 < result.value.amount < 1e-15


def test_a_changed_reply_is_found_with_both_values(busy_file: Path, tmp_path: Path) -> None:
    def edit(lines: list[Line]) -> list[Line]:
        at = next(i for i, line in enumerate(lines) if b'"cube_info"' in line.data)
        record = orjson.loads(lines[at].data)
        position = record["message"]["position"]
        values.extend([position[1], position[1] + 0.5])
        position[1] += 0.5
        return changed(lines, at, orjson.dumps(record))

    values: list[float] = []
    result = divergence(busy_file, tmp_path, edit)
    assert (result.kind, result.client, result.command) == ("reply", 1, "get_cube_info")
    assert result.value is not None
    assert (result.value.cube, result.value.field) == ("one", "position/1")
    assert [result.value.actual, result.value.expected] == values
    assert result.value.amount == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("before", "after", "field", "expected", "actual"),
    [
        (b'"spawned":"two"', b'"spawned":"owt"', "spawned", "owt", "two"),
        (b'"cubes":["one","two"]', b'"cubes":["one"]', "cubes", "1 items", "2 items"),
        (b'"frozen":false', b'"frozen":true', "frozen", True, False),
        (b'"sleeping":false,', b"", "sleeping", None, False),
        (
            b'{"type":"paused"',
            b'{ "type":"paused"',
            "",
            '{ "type":"paused","frame":15}',
            '{"type":"paused","frame":15}',
        ),
        (b'{"type":"pong"', b'{{"type":"pong"', "", '{{"type":"pong"}', {"type": "pong"}),
    ],
)
def test_any_change_of_a_reply_is_shown(
    busy_file: Path, tmp_path: Path, before: bytes, after: bytes, field: str, expected: object, actual: object
) -> None:
    def edit(lines: list[Line]) -> list[Line]:
        at = next(i for i in commands_of(lines, "replies") if before in lines[i].data)
        return changed(lines, at, lines[at].data.replace(before, after))

    result = divergence(busy_file, tmp_path, edit)
    assert result.kind == "reply" and result.value is not None
    assert (result.value.field, result.value.expected, result.value.actual) == (field, expected, actual)
    assert result.value.amount is None


def test_a_step_behind_which_the_file_ends_ticks_nothing(busy_file: Path, tmp_path: Path) -> None:
    def edit(lines: list[Line]) -> list[Line]:
        steps = [i for i in commands_of(lines) if b'"step"' in lines[i].data]
        return lines[: steps[1] + 1]

    report = replay(rewrite(busy_file, tmp_path / "x.mcap", edit))
    assert report.verdict == "reproduced"
    assert (report.ticks, report.frames) == (1, (0, 1))  # those of the first step


def test_a_missing_reply_is_reported_with_the_next_record(busy_file: Path, tmp_path: Path) -> None:
    def edit(lines: list[Line]) -> list[Line]:
        at = commands_of(lines, "replies")[0]
        return [*lines[:at], *lines[at + 1 :]]

    result = divergence(busy_file, tmp_path, edit)
    assert (result.kind, result.value) == ("order", None)
    assert "the recording has client 1's command" in result.message and "now comes: reply" in result.message


def test_a_client_with_another_number_is_found(busy_file: Path, tmp_path: Path) -> None:
    def edit(lines: list[Line]) -> list[Line]:
        return changed(lines, first(lines, "clients"), b'{"client":7,"event":"joined"}')

    result = divergence(busy_file, tmp_path, edit)
    assert result.kind == "client" and "client 7 joined; now it has number 1" in result.message


def test_a_changed_picture_is_found(busy_file: Path, tmp_path: Path) -> None:
    for topic in ("/tf", "/scene", "/boxes/two"):

        def edit(lines: list[Line], topic: str = topic) -> list[Line]:
            at = first(lines, topic)
            return changed(lines, at, lines[at].data.replace(b"two", b"owt"))

        assert divergence(busy_file, tmp_path, edit).kind == "poses"


def test_a_picture_of_which_a_part_is_missing_is_found(busy_file: Path, tmp_path: Path) -> None:
    def lone(lines: list[Line]) -> list[Line]:
        at = next(i for i, line in enumerate(lines) if line.topic == "ticks" and lines[i + 1].topic == "replies")
        return [*lines[: at + 1], Line("/scene", lines[at].log_time, b"a scene that never was"), *lines[at + 1 :]]

    assert divergence(busy_file, tmp_path, lone).kind == "poses"

    def cut(lines: list[Line]) -> list[Line]:
        return lines[: first(lines, "/tf")]

    assert replay(rewrite(busy_file, tmp_path / "cut.mcap", cut)).verdict == "reproduced"


def test_a_frame_is_refused_as_the_recording_says(busy_file: Path, tmp_path: Path) -> None:
    def refuse(lines: list[Line]) -> list[Line]:
        at = commands_of(lines)[0]
        client, frame = who_said(lines[at].data)
        as_refused = Line("refused", lines[at].log_time, client.to_bytes(4, "little") + frame)
        return [*lines[:at], as_refused, *lines[at + 1 :]]

    def take(lines: list[Line]) -> list[Line]:
        at = first(lines, "refused")
        data = lines[at].data
        as_command = Line("commands", lines[at].log_time, said_by(int.from_bytes(data[:4], "little"), data[4:]))
        return [*lines[:at], as_command, *lines[at + 1 :]]

    result = divergence(busy_file, tmp_path, refuse)
    assert result.kind == "order" and "was no command, and is a command now" in result.message
    result = divergence(busy_file, tmp_path, take)
    assert result.kind == "order" and "was a command, and is no command now" in result.message


@pytest.mark.parametrize("topic", ["commands", "refused"])
def test_a_frame_behind_which_the_file_ends_does_nothing(busy_file: Path, tmp_path: Path, topic: str) -> None:
    def edit(lines: list[Line]) -> list[Line]:
        frame = b'{"type":"apply_physics","cube_name":"one","impulse":[1e15,0,0]}'
        batch = b'{"type":"batch","commands":[%b,{"type":"step","ticks":2}]}' % frame
        data = said_by(1, batch) if topic == "commands" else (1).to_bytes(4, "little") + batch
        return [*lines, Line(topic, lines[-1].log_time, data)]

    def watch(world: World, happened: Request | Kind | None) -> None:
        worlds[:] = [world]

    worlds: list[World] = []
    made = rewrite(busy_file, tmp_path / "x.mcap", edit)
    report = replay(made, watch=watch)
    assert report.verdict == "reproduced"
    assert worlds[0].fault is None and report.frames[1] == worlds[0].ticks


def test_dropped_repeated_and_swapped_records_are_found(busy_file: Path, tmp_path: Path) -> None:
    # What clients and the clock did. What viewers are shown, or that somebody left, may be dropped without effect.
    def history(line: Line) -> bool:
        return line.topic in ("ticks", "commands", "replies", "refused")

    def drop(lines: list[Line], i: int) -> list[Line]:
        return [*lines[:i], *lines[i + 1 :]]

    def repeat(lines: list[Line], i: int) -> list[Line]:
        return [*lines[: i + 1], *lines[i:]]

    def swap(lines: list[Line], i: int) -> list[Line]:
        return [*lines[:i], lines[i + 1], lines[i], *lines[i + 2 :]]

    def edit(change: Callable[[list[Line], int], list[Line]], lines: list[Line]) -> list[Line]:
        places = [i for i in range(len(lines) - 1) if history(lines[i]) and history(lines[i + 1])]
        return change(lines, rng.choice(places))

    rng = random.Random(3)
    for change in (drop, repeat, swap):
        for _ in range(30):
            divergence(busy_file, tmp_path, partial(edit, change))


def test_dropped_repeated_and_swapped_commands_are_found(busy_file: Path, tmp_path: Path) -> None:
    # With their replies, so that the order of things is right and only what they do is different.
    def pushes(lines: list[Line]) -> list[int]:
        return [i for i in commands_of(lines) if b"apply_physics" in lines[i].data]

    def drop(number: int, lines: list[Line]) -> list[Line]:
        i = pushes(lines)[number]
        return [*lines[:i], *lines[i + 2 :]]

    def repeat(number: int, lines: list[Line]) -> list[Line]:
        i = pushes(lines)[number]
        return [*lines[:i], *lines[i : i + 2], *lines[i:]]

    def swap(number: int, lines: list[Line]) -> list[Line]:  # two pushes of one client
        one, two = pushes(lines)[number], pushes(lines)[(number + 2) % 16]
        lines = list(lines)
        lines[one], lines[two] = lines[two], lines[one]
        return lines

    for number in range(16):
        for edit in (drop, repeat, swap):
            result = divergence(busy_file, tmp_path, partial(edit, number))
            assert result.kind in ("digest", "reply")


def test_a_missing_client_and_malformed_records_are_reported(busy_file: Path, tmp_path: Path) -> None:
    def stranger(lines: list[Line]) -> list[Line]:
        at = first(lines, "clients")
        return [*lines[:at], *lines[at + 1 :]]

    result = divergence(busy_file, tmp_path, stranger)
    assert result.kind == "order" and "client 1" in result.message

    def fault(lines: list[Line]) -> list[Line]:
        at = first(lines, "ticks")
        return changed(lines, at, orjson.dumps({"frame": 1, "digests": []}))

    report = replay(rewrite(busy_file, tmp_path / "shape.mcap", fault))
    assert report.damage is not None and "does not have the shape of ticks" in report.damage
    assert not report.cut
