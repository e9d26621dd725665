"""Recordings and tasks of matches that somebody has made up: refused in words, whatever they say."""

from __future__ import annotations

import json
import random
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings

from creatures import snake
from deeds import Deed, deeds_at, sleep, stay
from duels import DUEL, duel, push, roles
from modelled import modelled
from nmes.errors import DocumentError, NmesError, ProofError
from nmes.evaluation import Match, MatchTask, brain_of, prove_match
from nmes.evaluation.match import match_metadata
from nmes.evaluation.match_task import METADATA
from nmes.evaluation.steps import Drive
from nmes.genome import Genome
from nmes.playback import replay
from nmes.protocol import parse
from nmes.recording import Recorder
from nmes.world import World

PLAYERS = {"red": Genome(push()), "blue": Genome(snake())}


def record(
    path: Path,
    says: dict[str, str],
    *,
    config: dict[str, Any] | None = None,
    swap: bool = False,
    task: MatchTask | None = None,
    nudge: str | None = None,
    before: Sequence[dict[str, Any]] = (),
    breaks: dict[int, Deed] | None = None,
) -> Path:
    """Records a match of half a second that says of itself what it is not.

    Args:
        path: The file.
        says: What its metadata have otherwise.
        config: What its world has otherwise than the task's.
        swap: Whether creatures are driven in the other order.
        task: The task, if it is another.
        nudge: Who is driven otherwise than by its brain.
        before: What was done in the world before it was recorded.
        breaks: What else happens, by the number of the step before which it does.
    """
    task = task or duel(duration=0.5)
    world = World({**task.world_config(3), **(config or {})})
    about = {METADATA: {**match_metadata(task, PLAYERS, 3)[METADATA], **says}}
    done = world.join() if before else None
    for command in before:
        assert done is not None and world.execute(done, command)["type"] != "error"
    recorder = world.journal = Recorder(path, world, about=about)
    match = Match(world, PLAYERS, {role: brain_of(genome) for role, genome in PLAYERS.items()}, task, 3)
    client = world.join() if done is None else done
    try:
        waiting: list[Drive] = []
        for number, step in enumerate(match.steps()):
            client = (breaks or {}).get(number, stay)(world, client)
            if isinstance(step, Drive):
                assert isinstance(step.controls, np.ndarray)
                step.controls[0] += 1e-7 * (step.creature == nudge)
                waiting.append(step)
                if not swap or len(waiting) == len(PLAYERS):
                    for drive in reversed(waiting):
                        world.drive(client, drive.creature, drive.controls)
                    waiting.clear()
            elif step is None:
                world.tick()
            else:
                world.handle(client, parse(step))
        world.leave(client)
    finally:
        recorder.close()
        world.close()
    return path


def other(**changes: Any) -> dict[str, str]:
    """Returns metadata that names another task."""
    return {"task": json.dumps(duel(**{"duration": 0.5, **changes}).document)}


@pytest.mark.parametrize(
    ("says", "error", "said"),
    [
        ({}, None, ""),
        ({"seed": "4"}, ProofError, "the world is not the task's"),
        ({"seed": "-1"}, ProofError, "names no seed, but '-1'"),
        ({"seed": "9" * 400}, ProofError, "names no seed"),
        ({"task": "{}"}, DocumentError, "format: is missing"),
        ({"task": "[]"}, DocumentError, ""),
        ({"task": json.dumps({**DUEL, "roles": []})}, DocumentError, "1 to 8 roles"),
        (
            other(**roles({"name": "green", "objective": "time"}, {"target": "green", "objective": "time"})),
            ProofError,
            "does not begin with the roles of duel",
        ),
        (other(**roles({"position": [-1.001, 0, 0]}, {})), ProofError, "another spawn_creature"),
        (other(roles=DUEL["roles"][::-1]), ProofError, "does not begin with the roles of duel"),
        (
            {"task": json.dumps({**DUEL, "roles": DUEL["roles"][:1]})},
            DocumentError,
            "roles/0/target: expected another role",
        ),
        (other(duration=0.4), ProofError, "after the end of the episode"),
        (other(duration=0.6), ProofError, "the recording ends before the episode does"),
    ],
    ids=range(13),
)
def test_what_a_recording_says_of_its_match_is_held_against_its_log(
    says: dict[str, str] | Any, error: type[NmesError] | None, said: str, tmp_path: Path
) -> None:
    path = record(tmp_path / "x.mcap", says)
    if error is None:
        assert prove_match(path, brain=True).results["red"].score is not None
        return
    with pytest.raises(error) as caught:
        prove_match(path)
    assert said in caught.value.message


def test_creatures_are_driven_in_the_order_of_their_roles(tmp_path: Path) -> None:
    with pytest.raises(ProofError, match="where there should be a drive of red"):
        prove_match(record(tmp_path / "x.mcap", {}, swap=True))


@pytest.mark.parametrize(("nudge", "code"), [("red", "not_comparable"), ("blue", "diverged")])
def test_only_whom_an_onnx_brain_drives_may_be_driven_otherwise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, nudge: str, code: str
) -> None:
    monkeypatch.setitem(PLAYERS, "red", Genome(modelled()))
    made = record(tmp_path / "x.mcap", {}, nudge=nudge)
    with pytest.raises(ProofError, match=f"what the brain of {nudge} does") as error:
        prove_match(made, brain=True)
    assert error.value.code == code and prove_match(made).results["red"].score is not None


def test_a_match_in_another_world_is_none_of_the_task(tmp_path: Path) -> None:
    with pytest.raises(ProofError, match="the world is not the task's"):
        prove_match(record(tmp_path / "x.mcap", {}, config={"gravity": [0, -1, 0]}))


@pytest.mark.parametrize("brain", [True, False])
def test_a_match_in_a_world_in_which_something_stood_before_proves_nothing(tmp_path: Path, brain: bool) -> None:
    wall = {"type": "spawn_cube", "cube_name": "wall", "position": [0, 0.5, 0], "size": 1, "freeze": True}
    pasts: list[list[dict[str, Any]]] = [[wall], [{"type": "step"}]]
    for number, before in enumerate(pasts):
        made = record(tmp_path / f"{number}.mcap", {}, before=before)
        assert replay(made).verdict == "reproduced"
        with pytest.raises(ProofError, match="begins with a world in which something was done before"):
            prove_match(made, brain=brain)


@pytest.mark.parametrize("brain", [True, False])
@pytest.mark.parametrize("number", [9, 60], ids=["coming to rest", "driven"])
def test_a_match_whose_world_sleeps_proves_nothing(tmp_path: Path, number: int, brain: bool) -> None:
    made = record(tmp_path / "x.mcap", {}, breaks={number: sleep})
    assert replay(made).verdict == "reproduced"
    with pytest.raises(ProofError, match="it has a sleep after its client left") as error:
        prove_match(made, brain=brain)
    assert error.value.code == "diverged"


@pytest.mark.parametrize("brain", [True, False])
def test_a_match_of_a_body_that_may_not_play_proves_nothing(tmp_path: Path, brain: bool) -> None:
    light = duel(duration=0.5, limits={"mass": 0.1})
    made = record(tmp_path / "x.mcap", {}, task=light)
    with pytest.raises(ProofError, match="red: the body has"):
        prove_match(made, brain=brain)


# -- anything that can be recorded, anywhere --------------------------------------------------------------------------


@cache
def honest_scores() -> dict[str, float | None]:
    """Returns what the match is worth to each role in which nothing else happens."""
    with TemporaryDirectory() as folder:
        results = prove_match(record(Path(folder) / "x.mcap", {})).results
    scores = {role: result.score for role, result in results.items()}
    assert None not in scores.values()
    return scores


@settings(max_examples=100)
@given(deeds_at("blue", 110))  # steps: at rest at 21
def test_whatever_happens_on_the_way_no_other_scores_are_proved(deeds: dict[int, Deed]) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "x.mcap"
        with suppress(NmesError, LookupError):  # where an honest match cannot go on, the recording ends
            record(path, {}, breaks=deeds)
        try:
            results = prove_match(path).results
        except ProofError:
            return
    assert {role: result.score for role, result in results.items()} == honest_scores()


def mangled(value: Any, draw: random.Random) -> Any:
    """Returns a document with one thing in it replaced by something else."""
    if isinstance(value, (dict, list)) and value and draw.random() < 0.85:
        key = draw.choice(list(value) if isinstance(value, dict) else range(len(value)))
        copy = value.copy()
        copy[key] = mangled(value[key], draw)
        return copy
    odd: list[Any] = [
        None,
        True,
        -1,
        0,
        1e308,
        "",
        "red",
        "time",
        "max.red.height",
        "red.apart.blue > 0",
        [],
        {},
        [1, 2, 3],
        "\u202e",
    ]
    return draw.choice(odd)


def test_a_document_that_is_nearly_a_match_is_one_or_is_refused() -> None:
    draw, refused = random.Random(5), 0
    sound = json.loads(json.dumps({**DUEL, "ends": [{"name": "met", "when": "red.apart.blue < 1"}], "margin": 0.1}))
    for _ in range(400):
        try:
            MatchTask(mangled(mangled(sound, draw), draw))
        except DocumentError as error:
            refused += 1
            assert error.message
    assert 100 < refused < 400
