"""What creatures score: the same every time, and provable from a recording alone."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from creatures import SINE, cpg, exploding, mlp, snake
from layout import ROOT
from nmes.errors import ProofError
from nmes.evaluation import Episode, Evaluation, Task, evaluate, prove
from nmes.genome import Genome
from nmes.playback import replay
from nmes.world import World

DASH = {
    "format": "nmes-task/1",
    "name": "dash",
    "description": "Get away from the start.",
    "duration": 2.5,
    "seeds": [3, 4],
    "vary": {"yaw": [-1, 1], "drop": [0.01, 0.1]},
    "objective": "displacement.horizontal - 0.001 * energy",
}


def task(**changes: Any) -> Task:
    return Task({**DASH, **changes})


@pytest.mark.parametrize("brain", [SINE, cpg(4), mlp(4), None], ids=["sine", "cpg", "mlp", "none"])
def test_a_recording_proves_the_score_that_evaluating_gave(brain: dict[str, Any] | None, tmp_path: Path) -> None:
    genome = Genome(snake(brain))
    first, second = evaluate(genome, task()), evaluate(genome, task(), record=tmp_path)
    assert first == second and first.error is None and first.score is not None
    assert [result.ticks for result in first.results] == [150, 150]
    assert first.results[0].score != first.results[1].score or brain is None
    for path, result in zip(second.recordings, second.results, strict=True):
        assert replay(path).verdict == "reproduced"
        assert prove(path).result == prove(path, brain=True).result == result
    assert len(list(tmp_path.iterdir())) == 2
    assert Evaluation.from_json(json.loads(json.dumps(first.to_json()))) == first


@pytest.mark.parametrize(("drop", "settle", "begins"), [(0.0, 0.5, 30), (0.0, 0.1, 15), (0.02, 0.1, 19)])
def test_an_episode_begins_where_a_creature_has_been_at_rest_for_a_quarter_of_a_second_and_settling_is_over(
    drop: float, settle: float, begins: int
) -> None:
    still = task(vary={"drop": [drop, drop]}, settle=settle, settle_limit=4.0, duration=0.1)
    world = World(still.world_config(3))
    result = Episode(world, Genome(snake()), None, still, 3).run()
    assert result.ticks == 6 and world.frame - result.ticks == begins


def test_seeds_may_be_chosen() -> None:
    genome = Genome(snake())
    whole, one = evaluate(genome, task()), evaluate(genome, task(), seeds=[4])
    assert one.results == whole.results[1:]
    assert one.spread == 0.0 and whole.spread is not None and whole.spread > 0.0


def test_scoring_a_recording_finds_the_same_end_of_the_episode(tmp_path: Path) -> None:
    ends = [{"name": "gone", "when": "displacement.horizontal > 0.1"}]
    evaluation = evaluate(Genome(snake()), task(ends=ends), record=tmp_path)
    for path, result in zip(evaluation.recordings, evaluation.results, strict=True):
        assert result.ended == "gone" and result.ticks < 150
        assert 0.1 < result.distance < 0.11
        assert prove(path).result == result


def test_a_creature_that_a_task_does_not_allow_is_an_error() -> None:
    evaluation = evaluate(Genome(snake()), task(limits={"cubes": 3}))
    assert evaluation.error is not None and "4 cubes, at most 3" in evaluation.error
    assert evaluation.results == () and evaluation.score is None


def test_a_divergence_is_a_result_with_a_reason_and_can_be_proved(tmp_path: Path) -> None:
    evaluation = evaluate(Genome(exploding()), task(), record=tmp_path)
    assert evaluation.error is None and evaluation.score is None and evaluation.faults == 2
    for path, result in zip(evaluation.recordings, evaluation.results, strict=True):
        assert result.fault is not None and result.fault.startswith("diverged: ") and result.score is None
        assert 0 < result.ticks < 20
        assert prove(path).result == prove(path, brain=True).result == result


def test_a_score_that_is_no_number_is_a_fault() -> None:
    evaluation = evaluate(Genome(snake()), task(objective="1 / (energy - energy)"))
    assert evaluation.faults == 2 and evaluation.score is None and "finite" in (evaluation.results[0].fault or "")


def test_a_recording_of_another_run_proves_no_score(tmp_path: Path) -> None:
    path = next((ROOT / "replays").glob("*.mcap"))
    with pytest.raises(ProofError, match="no recording of `nmes eval`"):
        prove(path)
