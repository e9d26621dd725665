"""Episodes that were recorded soundly, by a world that did all they say, but are not what an evaluation does."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import orjson
import pytest
from hypothesis import given, settings

from boards import DASH, entries_of, run
from creatures import snake
from deeds import STEP, Deed, batch_of, come_back, commands_about, deeds_about, deeds_at, hiding, let_in, sleep, stay
from modelled import modelled
from nmes.errors import NmesError, ProofError
from nmes.evaluation import Episode, Task, prove
from nmes.evaluation.episode import METADATA, brain_of
from nmes.evaluation.proof import retrace
from nmes.evaluation.steps import Drive
from nmes.genome import Genome
from nmes.playback import replay
from nmes.protocol import parse
from nmes.recording import Recorder
from nmes.world import World
from nmes.world.journal import Journal
from recordings import Edit, Line, changed, commands_of, rewrite

Change = Callable[[dict[str, Any]], dict[str, Any]]


def record(
    path: Path,
    config: dict[str, Any],
    *,
    extra: dict[int, dict[str, Any]],
    other: bool = False,
    change: Change = dict,
    layout: int | None = None,
    limits: dict[str, Any] | None = None,
    creature: dict[str, Any] | None = None,
    nudge: float = 0.0,
    breaks: dict[int, Deed] | None = None,
    seed: int = 3,
) -> Path:
    """Records an episode, of which every reply and every digest is true.

    Args:
        path: The file.
        config: What its world has otherwise than the task's.
        extra: Commands by the number of the step before which they come.
        other: Whether another client says them.
        change: What becomes of each command of the episode's own.
        layout: The layout that the creature is driven in; another than it has is refused.
        limits: What the task says of bodies.
        creature: The genome, if it is not a snake's.
        nudge: How much its first motor is driven by beside what the brain says.
        breaks: What else happens, by the number of the step before which it does.
        seed: The episode's.
    """
    task, genome = Task(DASH if limits is None else {**DASH, "limits": limits}), Genome(creature or snake())
    world = World({**task.world_config(seed), **config})
    about = {METADATA: {"task": json.dumps(task.document), "genome": genome.hash, "seed": str(seed)}}
    recorder = world.journal = Recorder(path, world, about=about)
    episode, client = Episode(world, genome, brain_of(genome), task, seed), world.join()
    stranger = None
    try:
        for number, step in enumerate(episode.steps()):
            client = (breaks or {}).get(number, stay)(world, client)
            if number in extra:
                stranger = world.join() if other else client
                world.execute(stranger, extra[number])
            if step is None:
                world.tick()
            elif isinstance(step, Drive):
                assert isinstance(step.controls, np.ndarray)
                step.controls[0] += nudge
                if layout is None:
                    world.drive(client, step.creature, step.controls)
                else:
                    drive = {"type": "drive", "creature": step.creature, "controls": step.controls.tolist()}
                    world.execute(client, {**drive, "layout": layout})
            else:
                command = change(json.loads(step))
                world.handle(client, parse(step if command == json.loads(step) else json.dumps(command).encode()))
        world.leave(client)
    finally:
        recorder.close()
        world.close()
    return path


def test_an_episode_that_is_recorded_by_hand_proves_its_score(tmp_path: Path) -> None:
    assert prove(record(tmp_path / "x.mcap", {}, extra={}), brain=True).result.score is not None


def test_a_creature_whose_brain_was_not_let_drive_it_proves_nothing(tmp_path: Path) -> None:
    with pytest.raises(ProofError, match="where there should be what the brain of the creature does"):
        prove(record(tmp_path / "x.mcap", {}, extra={}, layout=999_999), brain=True)


@pytest.mark.parametrize("brain", [True, False])
def test_a_creature_that_may_not_take_part_proves_nothing(tmp_path: Path, brain: bool) -> None:
    assert prove(record(tmp_path / "y.mcap", {}, extra={}, limits={"mass": 3}), brain=brain).result.score is not None
    with pytest.raises(ProofError, match="at most 1 are allowed"):
        prove(record(tmp_path / "x.mcap", {}, extra={}, limits={"mass": 1}), brain=brain)


@pytest.mark.parametrize(
    "config", [{"gravity": [0, -1, 0]}, {"substeps": 1}, {"friction": 3}, {"keyframes": 0}], ids=str
)
def test_an_episode_in_another_world_is_none_of_the_task(tmp_path: Path, config: dict[str, Any]) -> None:
    with pytest.raises(ProofError, match="the world is not the task's"):
        prove(record(tmp_path / "x.mcap", config, extra={}))


@pytest.mark.parametrize("other", [False, True], ids=["its client", "another client"])
@pytest.mark.parametrize("command", commands_about("creature"), ids=lambda command: str(command["type"]))
def test_a_command_that_no_evaluation_gives_is_found(tmp_path: Path, command: dict[str, Any], other: bool) -> None:
    for number in (1, 3, 40):
        path = record(tmp_path / f"{number}.mcap", {}, extra={number: command}, other=other)
        with pytest.raises(ProofError, match=r"where there should be|after the end|is no recording of"):
            prove(path, brain=True)


@pytest.mark.parametrize("change", [{"position": [0, 5, 0]}, {"target": [1, 0, 0]}, {"rotation": [0, 0, 0.5]}], ids=str)
def test_a_scene_that_is_set_otherwise_is_found(tmp_path: Path, change: dict[str, Any]) -> None:
    def changed(command: dict[str, Any]) -> dict[str, Any]:
        name = "set_cube_state" if "rotation" in change else "spawn_creature"
        return {**command, **change} if command["type"] == name else command

    with pytest.raises(ProofError, match="where there should be another"):
        prove(record(tmp_path / "x.mcap", {}, extra={}, change=changed))


# -- who is in the world, and whether it stays the same one -----------------------------------------------------------


@pytest.mark.parametrize("brain", [True, False])
@pytest.mark.parametrize("number", [3, 32, 70], ids=["coming to rest", "at its start", "driven"])
@pytest.mark.parametrize(
    ("interrupt", "found"),
    [
        (sleep, "a sleep after its client left"),
        (come_back, "a client who came after its client left"),
        (let_in, "a client who came where there should be"),
    ],
)
def test_a_world_that_is_left_or_sleeps_on_the_way_proves_nothing(
    tmp_path: Path, interrupt: Deed, found: str, number: int, brain: bool
) -> None:
    made = record(tmp_path / "x.mcap", {}, extra={}, breaks={number: interrupt})
    assert replay(made).verdict == "reproduced"
    for prover in (partial(prove, brain=brain), retrace):
        with pytest.raises(ProofError, match=f"it has {found}") as error:
            prover(made)
        assert error.value.code == "diverged"


@pytest.mark.parametrize("told", [0, 1, 2], ids=["before it", "once it is received", "after its tick"])
def test_an_episode_whose_last_tick_is_within_a_command_proves_nothing(tmp_path: Path, told: int) -> None:
    pushed = {"type": "apply_physics", "cube_name": "creature.c0", "impulse": [9, 0, 0]}
    made = record(tmp_path / "x.mcap", {}, extra={}, breaks={91: hiding(batch_of(pushed, STEP), told)})
    assert replay(made).verdict == "reproduced"
    for prover in (prove, partial(prove, brain=True), retrace):
        with pytest.raises(ProofError, match="the recording ends before") as error:
            prover(made)
        assert error.value.code == "damaged"


def test_an_episode_that_nobody_leaves_proves_nothing(tmp_path: Path) -> None:
    made = record(tmp_path / "x.mcap", {}, extra={}, breaks={91: hiding(stay, 1)})
    assert replay(made).verdict == "reproduced"
    with pytest.raises(ProofError, match="the recording ends before its client left"):
        prove(made)


def test_a_leaderboard_lists_no_creature_whose_world_slept(tmp_path: Path) -> None:
    board, task = tmp_path / "board.sqlite", tmp_path / "dash.json"
    task.write_text(json.dumps(DASH))
    assert run("tasks", board, "--allow", task).exit_code == 0
    made = [record(tmp_path / f"{seed}.mcap", {}, extra={}, breaks={70: sleep}, seed=seed) for seed in DASH["seeds"]]
    refused = run("add", board, *made)
    assert refused.exit_code == 1 and "it has a sleep after its client left" in refused.stderr
    assert entries_of(board) == []


# -- anything that can be recorded, anywhere --------------------------------------------------------------------------

OF_OTHER_CONFIGS = {"lived", "keyframe"}  # than a task's, which a proof looks at first: see above


@cache
def honest_score() -> float:
    """Returns what the episode is worth in which nothing else happens."""
    with TemporaryDirectory() as folder:
        score = prove(record(Path(folder) / "x.mcap", {}, extra={})).result.score
    assert score is not None
    return score


def check_that_nothing_is_gained(deeds: dict[int, Deed]) -> None:
    """Checks that an episode on whose way more happens proves nothing, or what it is worth without."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "x.mcap"
        with suppress(NmesError, LookupError):  # where an honest evaluation cannot go on, the recording ends
            record(path, {}, extra={}, breaks=deeds)
        try:
            score = prove(path).result.score
        except ProofError:
            return
    assert score == honest_score()


def test_there_is_a_deed_for_all_that_a_world_tells_its_journal() -> None:
    assert {*deeds_about("creature"), *OF_OTHER_CONFIGS} == {name for name in vars(Journal) if not name.startswith("_")}


@settings(max_examples=100)
@given(deeds_at("creature", 91))  # steps: at rest at about 32
def test_whatever_happens_on_the_way_no_other_score_is_proved(deeds: dict[int, Deed]) -> None:
    check_that_nothing_is_gained(deeds)


# -- what a model may round otherwise ---------------------------------------------------------------------------------


def _another_digest(lines: list[Line]) -> list[Line]:
    at = [number for number, line in enumerate(lines) if line.topic == "ticks"][-1]
    ticks = orjson.loads(lines[at].data)
    ticks["digests"][-1] = "0" * 32
    return changed(lines, at, orjson.dumps(ticks))


def _another_command(lines: list[Line]) -> list[Line]:
    return _other(lines, lambda _drive: {"type": "ping"})


def _too_many_controls(lines: list[Line]) -> list[Line]:
    return _other(lines, lambda drive: {**drive, "controls": [*drive["controls"], 0.0]})


def _other(lines: list[Line], change: Change) -> list[Line]:
    at = commands_of(lines)[-1]
    sent = orjson.loads(lines[at].data)
    return changed(lines, at, orjson.dumps({**sent, "message": change(sent["message"])}))


def test_what_an_onnx_brain_puts_out_may_be_rounded_otherwise(tmp_path: Path) -> None:
    made = record(tmp_path / "x.mcap", {}, extra={}, creature=modelled(), nudge=1e-7)
    with pytest.raises(ProofError, match="what the brain of the creature does: it has an ONNX brain") as error:
        prove(made, brain=True)
    assert error.value.code == "not_comparable"
    assert prove(made).result.score is not None


@pytest.mark.parametrize("nudge", [0.0, 1e-7], ids=["as here", "rounded"])
@pytest.mark.parametrize("forge", [_another_digest, _another_command, _too_many_controls])
def test_nothing_else_is_excused_by_an_onnx_brain(tmp_path: Path, forge: Edit, nudge: float) -> None:
    made = record(tmp_path / "x.mcap", {}, extra={}, creature=modelled(), nudge=nudge)
    with pytest.raises(ProofError) as error:
        prove(rewrite(made, tmp_path / "forged.mcap", forge), brain=True)
    assert error.value.code == "diverged"
