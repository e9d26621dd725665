"""The task `scout`: who sees leads who does not, by a channel, and without it nobody arrives."""

from __future__ import annotations

from math import hypot
from pathlib import Path

import numpy as np
import pytest

from nmes.errors import DocumentError
from nmes.evaluation import MatchTask, Task, play, prove_match
from nmes.genome import Genome
from scouting import WEIGHTS, climb, lookout, mean_score, rover, without_channel

TASK = MatchTask.load("scout")
LED = np.zeros(WEIGHTS)
"""A pair made by hand: the scout says how far ahead and how far aside the beacon is; the runner rolls, and turns so."""
LED[[0, 6, 8, 9, 11, 12]] = 6.0, 1.5, 0.25, -0.045, 0.25, 0.045


def test_a_runner_that_is_led_comes_nearer_and_one_that_hears_nothing_does_not() -> None:
    assert mean_score(LED, TASK, TASK.seeds) > 1.5
    assert abs(mean_score(LED, without_channel(TASK), TASK.seeds)) < 0.1


def test_a_match_with_voices_is_proved_from_its_recording(tmp_path: Path) -> None:
    players = {"scout": lookout(LED[:8]), "runner": rover(LED[8:])}
    (match,) = play(TASK, players, seeds=[3], record=tmp_path)
    assert match.recording is not None
    assert prove_match(match.recording, brain=True).results == match.results
    assert match.results["scout"].score == match.results["runner"].score != 0.0


def test_the_beacon_is_where_the_seed_draws_it() -> None:
    genomes = {"scout": Genome(lookout(LED[:8])), "runner": Genome(rover(LED[8:]))}
    places = [TASK.entry(seed, genomes)[0]["position"] for seed in range(1, 41)]
    assert all(4.0 <= hypot(x, z) <= 6.0 for x, _, z in places)
    assert {(x > 0, z > 0) for x, _, z in places} == {(a, b) for a in (False, True) for b in (False, True)}
    assert places[0] == TASK.entry(1, genomes)[0]["position"]


def test_only_props_of_matches_are_put_away_and_not_between_crossed_bounds() -> None:
    document = TASK.document
    document = {**document, "props": [{**document["props"][0], "away": {"distance": [6, 4]}}]}
    with pytest.raises(DocumentError) as error:
        MatchTask(document)
    assert [path for path, _ in error.value.found] == ["props/0/away/distance"]
    walk = Task.load("walk").document
    prop = {"id": "p", "size": [1, 1, 1], "mass": 1, "away": {"distance": [4, 6]}}
    with pytest.raises(DocumentError) as error:
        Task({**walk, "props": [prop]})
    assert "props/0/away" in [path for path, _ in error.value.found]


@pytest.mark.long
@pytest.mark.timeout(7200)
def test_evolution_finds_what_to_say_where_there_is_a_channel() -> None:
    with_it, without = (climb(task, seed=2, budget=60)[1][-1] for task in (TASK, without_channel(TASK)))
    assert with_it > without + 0.5
