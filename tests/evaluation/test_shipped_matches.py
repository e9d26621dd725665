"""The tasks with roles that ship: what they are worth to creatures that ship, and that no side has an advantage."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from math import fsum
from statistics import stdev
from typing import Any

import pytest

from layout import ROOT
from nmes.evaluation import MatchTask, Task, evaluate, play
from nmes.genome import Genome
from nmes.genome.genome import GenomeLike

STILL: dict[str, Any] = {
    "format": "nmes-genome/1",
    "name": "block",
    "body": {"cubes": [{"id": "root", "size": [0.4, 0.4, 0.4], "mass": 10, "position": [0, 0.2, 0]}]},
}
NAMES = ["chase", "foraging", "interference", "interference-alone", "relay", "scout", "sumo"]


def scores(name: str, genomes: Mapping[str, GenomeLike], seed: int = 1) -> dict[str, float | None]:
    """The scores of one match, as far as they are needed."""
    (match,) = play(name, genomes, seeds=[seed])
    return {role: result.score for role, result in match.results.items()}


def test_seven_matches_come_with_the_package_and_the_page_lists_them() -> None:
    assert list(MatchTask.names()) == NAMES
    page = (ROOT / "docs" / "matches.md").read_text()
    for name in NAMES:
        task = MatchTask.load(name)
        assert f"| `{name}` | {', '.join(task.roles)} | {task.duration:g} s | {task.description} |\n" in page
    (example,) = re.findall(r"^```json\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    assert list(MatchTask(json.loads(example)).roles) == ["hunter", "prey"]


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("sumo", {"red": 0.0, "blue": 0.0}),
        ("chase", {"hunter": 0.0, "prey": 1.0}),
        ("foraging", {"red": 0.0, "blue": 0.0}),
        ("relay", {"first": 0.0, "second": 0.0}),
        ("interference", {"robot": 0.0, "interferer": 0.0}),
        ("interference-alone", {"robot": 0.0}),
        ("scout", {"scout": 0.0, "runner": 0.0}),
    ],
)
def test_creatures_that_do_nothing_have_nothing(name: str, expected: dict[str, float]) -> None:
    assert scores(name, dict.fromkeys(expected, STILL)) == pytest.approx(expected, abs=0.01)


def test_in_sumo_who_is_pushed_off_or_drives_off_has_lost() -> None:
    off = play("sumo", {"red": "roller", "blue": "seeker"}, seeds=[1])[0].results
    assert {role: (result.score, result.ended) for role, result in off.items()} == {
        "red": (2.0, "out"), "blue": (-2.0, "out"),
    }  # fmt: skip


def test_in_a_chase_who_sees_its_prey_catches_it_and_who_does_not_does_not() -> None:
    caught = scores("chase", {"hunter": "seeker", "prey": "roller"})
    assert caught["hunter"] is not None and 1.0 < caught["hunter"] < 2.0
    assert caught["hunter"] + (caught["prey"] or 0.0) == pytest.approx(2.0)
    assert scores("chase", {"hunter": "roller", "prey": "walker"})["prey"] == 1.0


def test_in_foraging_who_sees_food_has_it() -> None:
    assert scores("foraging", {"red": "seeker", "blue": STILL}) == {"red": 1.0, "blue": 0.0}
    assert scores("foraging", {"red": STILL, "blue": "seeker"}) == {"red": 0.0, "blue": 1.0}


def test_a_relay_counts_what_the_second_goes_and_not_what_it_is_pushed() -> None:
    pushed = scores("relay", {"first": "roller", "second": STILL})["second"]
    assert pushed is not None and pushed < 1.5
    assert (scores("relay", {"first": "seeker", "second": "walker"}, seed=2)["second"] or 0.0) > 5.0


def test_an_interferer_takes_from_the_robot_what_it_has_alone() -> None:
    alone, met = (
        scores("interference-alone", {"robot": "walker"}),
        scores("interference", {"robot": "walker", "interferer": "seeker"}),
    )
    assert alone["robot"] is not None and met["robot"] is not None
    assert alone["robot"] > 20.0 and met["robot"] < 5.0 and met["interferer"] == -met["robot"]


def test_alone_in_a_role_a_creature_does_what_it_does_in_a_task() -> None:
    document = MatchTask.load("interference-alone").document
    common = {name: value for name, value in document.items() if name != "roles"}
    task = Task({**common, "name": "interference-alone", "objective": "displacement.x - 2 * max.reach", "duration": 5})
    (match,) = play({**document, "duration": 5}, {"robot": "inchworm"}, seeds=[1])
    (result,) = evaluate("inchworm", task, seeds=[1]).results
    assert match.results["robot"].score == pytest.approx(result.score, abs=2e-3) and (result.score or 0.0) > 0.1
    assert match.results["robot"].ticks == result.ticks


# -- sides -----------------------------------------------------------------------------------------------------------


def differences(name: str, seeds: range) -> list[float]:
    """By how much red beats blue in sumo, where both are the same creature."""
    found = []
    for match in play("sumo", {"red": name, "blue": name}, seeds=seeds):
        red, blue = (match.results[role].score for role in ("red", "blue"))
        assert red is not None and blue is not None
        found.append(red - blue)
    return found


def test_a_creature_against_itself_has_the_same_in_both_places_together() -> None:
    task, genome = MatchTask.load("sumo"), Genome.load("roller")
    sums = [0.0, 0.0]
    for seed in (1, 2):
        for side in task.sides(seed):
            results = play(task, {role: genome for role in task.roles}, seeds=[seed])[0].results
            for role, number in zip(task.roles, side, strict=True):
                sums[number] += results[role].score or 0.0
    assert sums[0] == sums[1]


def test_bodies_that_sense_each_other_alike_draw_to_the_last_bit_of_what_counts() -> None:
    assert max(map(abs, differences("seeker", range(4)))) <= 0.05  # the task's margin; measured: 0


@pytest.mark.long
@pytest.mark.parametrize("name", ["walker", "roller", "centipede"])
def test_no_side_has_an_advantage(name: str) -> None:
    """Three standard errors: if places are worth the same, one of 370 such samples is beyond; the seeds are fixed."""
    found = differences(name, range(40))
    assert abs(fsum(found) / len(found)) <= 3.0 * stdev(found) / len(found) ** 0.5
