"""The divergence campaign: histories edited at random, each found at the place where its first effect is.

A forger changes one thing in a recording and makes all checksums and the chain anew. Where that first shows is found
out here without `nmes.playback`: the edited inputs are done to a fresh world, which is recorded, and the two histories
are laid side by side.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import orjson
import pytest

from nmes.playback import replay
from nmes.protocol import parse
from nmes.recording import Recorder, Recording
from nmes.recording.records import who_said
from nmes.world import World
from recordings import Line, record, rewrite, send

ENGINES = ("ballistic", "mujoco", "pymunk")
HISTORY = ("clients", "commands", "replies", "refused", "ticks", "faults")  # the topics that tell what happened


def session(seed: int) -> Callable[[World, int], None]:
    """Two clients who build, push, look and step as a seed has it."""

    def play(world: World, client: int) -> None:
        rng = random.Random(seed)
        clients = [client, world.join()]
        cubes: list[str] = []

        def say(**command: Any) -> dict[str, Any]:
            return send(world, rng.choice(clients), **command)

        for i in range(3):
            cubes.append(say(type="spawn_cube", position=[3.0 * i, rng.uniform(1, 5), 0])["spawned"])
        for i in range(12):
            for _ in range(rng.randrange(1, 4)):
                numbers = [rng.uniform(-9, 9) for _ in range(3)]
                match rng.randrange(5):
                    case 0:
                        cubes.append(say(type="spawn_cube", position=[3.0 * len(cubes), abs(numbers[0]), 0])["spawned"])
                    case 1:
                        say(type="set_cube_state", cube_name=rng.choice(cubes), linear_velocity=[numbers[0], 1.5, 0])
                    case 2:
                        say(type="apply_physics", cube_name=rng.choice(cubes), impulse=[0.1 * numbers[0], 0.25, 0])
                    case _:
                        say(type="apply_physics", cube_name=rng.choice(cubes), force=[numbers[0], numbers[1], 0])
            say(type="step", ticks=rng.randrange(1, 4)) if i % 4 else world.tick()
            say(type="get_world_state")

    return play


class Group(NamedTuple):
    """A command with all that it led to, or one other line."""

    lines: list[Line]

    @property
    def command(self) -> dict[str, Any] | None:
        return orjson.loads(self.lines[0].data) if self.lines[0].topic == "commands" else None


def groups_of(lines: list[Line]) -> list[Group]:
    groups: list[Group] = []
    for line in lines:
        last = groups[-1].lines if groups else [line]
        effect = last[0].topic == "commands" and last[-1].topic != "replies"
        if effect and line.topic != "commands":
            last.append(line)
        else:
            groups.append(Group([line]))
    return groups


def numbers_in(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    if isinstance(value, dict | list):
        for key, part in value.items() if isinstance(value, dict) else enumerate(value):
            yield from numbers_in(part, (*path, key))
    elif isinstance(value, float):
        yield path


def nudged(group: Group, rng: random.Random) -> Group:
    """One number of the command by one unit in the last place."""
    command: Any = group.command
    *path, last = rng.choice(list(numbers_in(command)))
    place = command
    for key in path:
        place = place[key]
    place[last] = float(np.nextafter(place[last], rng.choice([-np.inf, np.inf])))
    return Group([group.lines[0]._replace(data=orjson.dumps(command)), *group.lines[1:]])


def edited(lines: list[Line], rng: random.Random) -> tuple[str, list[Line]]:
    """Changes one thing; returns what, and the new history."""
    kind = rng.choice(["nudge", "drop", "repeat", "swap", "digest"])
    if kind == "digest":
        at = rng.choice([i for i, line in enumerate(lines) if line.topic == "ticks"])
        ticks = orjson.loads(lines[at].data)
        number, digit = rng.randrange(len(ticks["digests"])), rng.randrange(32)
        old = ticks["digests"][number]
        wrong = f"{int(old[digit], 16) ^ rng.randrange(1, 16):x}"
        ticks["digests"][number] = old[:digit] + wrong + old[digit + 1 :]
        return kind, [*lines[:at], lines[at]._replace(data=orjson.dumps(ticks)), *lines[at + 1 :]]
    groups = groups_of(lines)
    if kind != "nudge" and rng.random() < 0.5:
        # The command alone, and not what it led to.
        groups = [Group([line]) for line in lines]
    commands = [i for i, group in enumerate(groups) if group.command is not None]
    match kind:
        case "nudge":
            at = rng.choice([i for i in commands if list(numbers_in(groups[i].command))])
            groups[at] = nudged(groups[at], rng)
        case "drop":
            del groups[rng.choice(commands)]
        case "repeat":
            at = rng.choice(commands)
            groups.insert(at, groups[at])
        case "swap":
            one, other = rng.sample(commands, 2)
            groups[one], groups[other] = groups[other], groups[one]
    return kind, [line for group in groups for line in group.lines]


Event = tuple[Any, ...]


def events_of(lines: list[Line]) -> list[tuple[int, Event]]:
    """The events of a history, each tick by itself, with the numbers of the records that tell of them."""
    events: list[tuple[int, Event]] = []
    for number, line in enumerate(lines):
        if line.topic == "ticks":
            ticks = orjson.loads(line.data)
            for i, digest in enumerate(ticks["digests"]):
                events.append((number, ("tick", ticks["frame"] + i, digest)))
        elif line.topic in HISTORY:
            events.append((number, (line.topic, line.data)))
    return events


def retold(path: Path, lines: list[Line], config: dict[str, Any]) -> list[Event]:
    """Does the inputs of a history to a fresh world; returns what happens then."""
    world = World(config)
    recorder = world.journal = Recorder(path, world, pose_rate=0)
    for group in groups_of(lines):
        first = group.lines[0]
        if first.topic == "commands":
            client, command = who_said(first.data)
            world.handle(client, parse(command))
        elif first.topic == "clients":
            world.join()
        elif first.topic == "ticks":
            for _ in orjson.loads(first.data)["digests"]:
                world.tick()
    recorder.close()
    world.close()
    history: list[Line] = []

    def keep(lines: list[Line]) -> list[Line]:
        history.extend(lines)
        return lines

    rewrite(path, path.with_suffix(".copy"), keep)
    return [event for _, event in events_of(history)]


def campaign(folder: Path, seed: int, cases: int) -> list[str]:
    """Edits one session in many ways; returns what each came to."""
    folder.mkdir(exist_ok=True)
    rng = random.Random(seed)
    engine = ENGINES[seed % len(ENGINES)]
    source = record(folder / "x.mcap", session(seed), {"backend": engine}, pose_rate=0)
    original = Recording(source)
    assert original.complete
    outcomes = []
    for case in range(cases):
        changes: list[tuple[str, list[Line]]] = []

        def edit(lines: list[Line], changes: list[tuple[str, list[Line]]] = changes) -> list[Line]:
            changes.append(edited(lines, rng))
            return changes[0][1]

        forged = rewrite(source, folder / f"{case}.mcap", edit)
        (kind, lines), what = changes[0], f"session {seed}, case {case}"
        here = events_of(lines)
        there = retold(folder / f"{case}.retold", lines, original.config)
        report, copy = replay(forged), Recording(forged)
        assert copy.complete, what  # all checksums are in order
        assert copy.end["head"] != original.end["head"], what  # so no signature fits
        unchained = rewrite(source, folder / f"{case}.old", partial(lambda lines, _: lines, lines), chained=False)
        assert not Recording(unchained).complete, what
        parts = [i for i, (one, other) in enumerate(zip(here, there, strict=False)) if one[1] != other]
        if not parts and len(here) == len(there):
            # It is another history, but a true one: all that was said and all that came of it would have been so.
            assert kind in ("nudge", "swap", "repeat", "drop"), what
            assert report.verdict == "reproduced", what
            outcomes.append("true")
            continue
        at = parts[0] if parts else min(len(here), len(there))
        divergence = report.divergence
        assert report.verdict == "diverged" and divergence is not None, f"{what}: {kind} was not found"
        number, event = here[at]
        assert divergence.record == number, (
            f"{what}: {kind} found at {divergence}, not at record {number}: {event}, {there[at]}"
        )
        if event[0] == "tick" and there[at][0] == "tick":
            assert (divergence.kind, divergence.frame) == ("digest", there[at][1]), what
        if kind == "digest":
            # Nothing but the digest is wrong, at the very tick, so there are no two states to show.
            assert (divergence.kind, divergence.value) == ("digest", None), what
        shown = "seen" if divergence.value is not None else "unseen"
        outcomes.append(shown if divergence.kind == "digest" and kind != "digest" else divergence.kind)
    return outcomes


def judge(folder: Path, seeds: range, cases: int) -> Counter[str]:
    counts = Counter(outcome for seed in seeds for outcome in campaign(folder / str(seed), seed, cases))
    assert counts.total() == len(seeds) * cases
    # Some edits tell of another history that is just as true: two pushes of one tick in another order, a question that
    # is asked again, a last bit that is rounded away. For them there is the head of the chain.
    assert counts["true"] <= 0.3 * counts.total()
    # Somebody looks at all cubes after every step, which is when both states can be shown.
    assert counts["seen"] >= 10 * counts["unseen"]
    return counts


def test_every_edit_is_found_where_it_first_shows(tmp_path: Path) -> None:
    judge(tmp_path, range(3), 20)


@pytest.mark.long
def test_each_of_a_thousand_edits_is_found_where_it_first_shows(tmp_path: Path) -> None:
    judge(tmp_path, range(100, 140), 25)
