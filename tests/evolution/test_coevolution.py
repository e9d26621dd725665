"""Populations that are each other's measure: whom a candidate meets, what that is worth, and that it is one history."""

from __future__ import annotations

import json
import multiprocessing
import random
import shutil
import subprocess
import time
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Any

import orjson
import pytest

from coevolution_runs import DUEL_RUN, MOMENT, begin_duel
from command_line import run as command
from duels import push
from nmes.errors import DocumentError, RunError
from nmes.evaluation import MatchTask, Workers, play
from nmes.evaluation.parallel import Here
from nmes.evolution.run import Run
from nmes.evolution.run_settings import RunSettings
from nmes.evolution.run_verify import RunVerdict, verify_run
from nmes.genome import Genome
from processes import NMES
from runs import finish, forge

ERA = DUEL_RUN["options"]["era"]
ALIKE = {**MOMENT, "interchangeable": True}
SELF = {"task": ALIKE, "populations": [{"role": "red", "starts": [push()]}]}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run that was finished in one go."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    finish(begin_duel(folder))
    return folder


def log(folder: Path) -> bytes:
    return (folder / "log.jsonl").read_bytes()


def beginning(folder: Path, count: int) -> bytes:
    """The first lines of a log, which are those of a run of a smaller budget."""
    return b"".join(log(folder).splitlines(keepends=True)[:count])


def opponents(run: Run, index: int) -> list[int]:
    return [each for lineup in run.entry(index).opponents for each in lineup]


# -- one history ------------------------------------------------------------------------------------------------------


def test_neither_workers_nor_interruptions_show_in_the_log(whole: Path, tmp_path: Path) -> None:
    with Workers(3) as workers:
        assert len(list(islice(begin_duel(tmp_path / "run", budget=20).advance(workers), 9))) == 9
    for take in (0, 1, 5, 100):
        run = Run.open(tmp_path / "run")
        with Here() as here:
            records = run.advance(here)
            assert len(list(islice(records, take))) <= take
            records.close()
    assert log(tmp_path / "run") == beginning(whole, 20)
    run = Run.open(tmp_path / "run")
    assert run.records == Run.open(whole).records[:20] and run.elites() == Run.open(whole).elites()[2:]


def advance(folder: Path) -> None:
    finish(Run.open(folder))


def lines(folder: Path) -> int:
    return log(folder).count(b"\n") if (folder / "log.jsonl").exists() else 0


def test_kills_do_not_show_in_the_log(whole: Path, tmp_path: Path) -> None:
    begin_duel(tmp_path / "run", budget=20)
    for until in (2, 7, 11):
        child = multiprocessing.get_context("fork").Process(target=advance, args=(tmp_path / "run",))
        child.start()
        while lines(tmp_path / "run") < until and child.is_alive():
            time.sleep(0.001)
        child.kill()
        child.join()
    run = Run.open(tmp_path / "run")
    assert 11 <= len(run) < 20
    assert log(finish(run).folder) == beginning(whole, 20)


@pytest.mark.long
@pytest.mark.parametrize("algorithm", ["ga", "es"])
def test_forty_kills_of_runs_with_one_two_and_four_workers_do_not_show(algorithm: str, tmp_path: Path) -> None:
    options = DUEL_RUN["options"] if algorithm == "ga" else {"population": 4, "era": 8}
    settings = {"algorithm": algorithm, "options": options, "budget": 1000}
    finish(begin_duel(tmp_path / "whole", **settings))
    file, folder = tmp_path / "settings.json", tmp_path / "killed"
    file.write_bytes(orjson.dumps({**DUEL_RUN, **settings}))
    draw = random.Random(algorithm)
    for _ in range(40):
        new = ["--settings", str(file), "-o", str(folder)]
        arguments = ["resume", str(folder)] if (folder / "run.json").exists() else new
        until = lines(folder) + draw.randrange(6)
        with subprocess.Popen([NMES, "evolve", *arguments, "--jobs", draw.choice("124")]) as running:
            while lines(folder) < until and running.poll() is None:
                time.sleep(0.001)
            assert running.poll() is None, "the run was over too early"
            running.kill()
    assert log(finish(Run.open(folder)).folder) == log(tmp_path / "whole")


def test_a_greater_budget_goes_on_as_if_it_had_been_so_from_the_beginning(whole: Path, tmp_path: Path) -> None:
    run = finish(begin_duel(tmp_path / "run", budget=5))
    run.extend(10)
    assert log(finish(run).folder) == beginning(whole, 10)


@pytest.mark.parametrize(
    "algorithm", ["es", *(pytest.param(name, marks=pytest.mark.long) for name in ("random", "cma"))]
)
def test_populations_can_be_bred_by_other_algorithms(algorithm: str, tmp_path: Path) -> None:
    options = {"era": 1, "latest": 1, "famous": 1, **({} if algorithm == "random" else {"population": 4})}
    start = {"populations": [{"role": role, "starts": [push()]} for role in ("red", "blue")]}
    settings = {"algorithm": algorithm, "options": options, "budget": 12, **start}
    run = finish(begin_duel(tmp_path / "whole", **settings))
    begin_duel(tmp_path / "run", **settings)
    with Here() as here:
        records = Run.open(tmp_path / "run").advance(here)
        assert len(list(islice(records, 5))) == 5
        records.close()
    assert finish(Run.open(tmp_path / "run")).digest == run.digest
    assert {opponents(run, 10)[0] % 2, opponents(run, 11)[0] % 2} == {0, 1}
    assert opponents(run, 10) != opponents(run, 0)
    assert run.records[2].genome_hash != run.records[3].genome_hash  # each has draws of its own


# -- whom a candidate meets -------------------------------------------------------------------------------------------


def test_candidates_of_the_populations_take_turns_and_come_from_their_own(whole: Path) -> None:
    run = Run.open(whole)
    assert [record.group for record in run.records] == ["red", "blue"] * 15
    assert any(record.parents for record in run.records)
    assert all(parent % 2 == record.index % 2 for record in run.records for parent in record.parents)
    assert Genome(push()).hash == run.records[0].genome_hash != run.records[1].genome_hash


def test_a_score_is_the_mean_over_matches_with_the_opponents_that_the_log_names(whole: Path) -> None:
    run, task = Run.open(whole), MatchTask(MOMENT)
    for index in (0, 13, 29):
        own, other = ("red", "blue") if index % 2 == 0 else ("blue", "red")
        scores = list[float]()
        for number, opponent in enumerate(opponents(run, index)):
            players = {own: run.genome(index), other: run.genome(opponent)}
            (match,) = play(task, players, seeds=[task.seeds[number % 2]])
            scores.append(match.results[own].score or 0.0)
        assert run.records[index].score == sum(scores) / len(scores), index
        assert len(scores) == 2


def test_the_first_era_meets_founders_and_later_ones_the_best_of_late_and_the_famous(whole: Path) -> None:
    run = Run.open(whole)
    scores = [record.score for record in run.records]
    assert [opponents(run, index) for index in range(8)] == [[1, 3], [0, 2]] * 4
    for index in range(8, 30):
        era = index // 2 // ERA
        # The window of 3 lets the era's first candidate begin when all of the others but two are told.
        known = [each for each in range((index + 1) % 2, 2 * (era * ERA - 2), 2) if scores[each] is not None]
        recent = [each for each in known if each // 2 >= era * ERA - 2 - ERA]
        best = max(recent, key=lambda each: (scores[each], -each))
        meets = opponents(run, index)
        assert meets[0] == best, index
        champions = {
            max(eldest, key=lambda each: (scores[each], -each))
            for past in range(era - 1)
            if (eldest := [each for each in known if each // 2 // ERA == past])
        }
        assert len(meets) == 2 and (meets[1] in champions - {best} or not champions - {best}), index
        assert meets == opponents(run, (era * ERA) * 2 + index % 2)  # the same throughout the era


def test_one_population_plays_itself_in_every_role(tmp_path: Path) -> None:
    run = finish(begin_duel(tmp_path / "run", **SELF, budget=8))
    assert {record.group for record in run.records} == {"red"}
    task = MatchTask(ALIKE)
    index = 7
    (first, *_), results = opponents(run, index), run.entry(index).content["results"]
    scores = []
    for places in task.sides(task.seeds[0]):
        cast = (run.genome(index), run.genome(first))
        roles = dict(zip(("red", "blue"), (cast[place] for place in places), strict=True))
        (match,) = play(task, roles, seeds=[task.seeds[0]])
        scores.append(match.results["red" if places[0] == 0 else "blue"].score)
    assert [result["score"] for result in results[:2]] == scores and len(results) == 4
    assert opponents(run, 0) == [0, 1] and first < index


def test_populations_of_roles_that_are_alike_meet_each_other(tmp_path: Path) -> None:
    run = finish(begin_duel(tmp_path / "run", task=ALIKE, budget=4))
    assert all(opponent % 2 != index % 2 for index in range(4) for opponent in opponents(run, index))
    assert len(run.entry(3).content["results"]) == 4


def test_who_leads_is_the_champion_of_the_last_era_that_is_over(whole: Path) -> None:
    run = Run.open(whole)
    champions = run.champions()
    assert list(champions) == ["red", "blue"]
    for place, champion in enumerate(champions.values()):
        era = [record for record in run.records[16 + place : 24 : 2] if record.score is not None]
        assert champion.score == max(record.score or 0.0 for record in era) and champion in era
    assert run.best is None
    assert run.figures() == {"eras": 3}
    eras = [index // 2 // ERA for index in run.elites()]
    assert eras == [2, 2, 1, 1, 0, 0]


def test_founders_are_met_beyond_the_budget_too(tmp_path: Path) -> None:
    run = finish(begin_duel(tmp_path / "run", budget=1))
    assert opponents(run, 0) == [1, 3]
    written = command("evolve", "best", run.folder, "-o", tmp_path / "best")
    assert written.exit_code == 0, written.output
    assert verdict(run.folder).verdict == "holds"
    forge(run.folder, lambda records: records[0].update(opponents=[[1], [9]]))
    with pytest.raises(RunError, match="nobody can have met candidate 9"):
        Run.open(run.folder).rivals(0)


# -- proof ------------------------------------------------------------------------------------------------------------


def verdict(folder: Path, sample: int | None = None) -> RunVerdict:
    with Here() as here:
        return verify_run(folder, here, sample, lambda *_: None)


def test_a_run_that_is_as_it_came_out_holds_also_where_it_is_short(whole: Path, tmp_path: Path) -> None:
    found = verdict(whole, 2)
    assert (found.verdict, found.asked, found.findings, found.evaluated) == ("holds", 30, (), 8)
    shutil.copytree(whole, tmp_path / "run")
    forge(tmp_path / "run", lambda records: records.__delitem__(slice(2, None)))  # before its opponents were told
    found = verdict(tmp_path / "run")
    assert (found.verdict, found.evaluated) == ("holds", 2)


def raise_scores(records: list[dict[str, Any]]) -> None:
    records[17]["score"] += 1.0
    for result in records[17]["results"]:
        result["score"] += 1.0


def meet_others(records: list[dict[str, Any]]) -> None:
    records[17]["opponents"] = [[2], [4]]


def change_population(records: list[dict[str, Any]]) -> None:
    records[17]["group"] = "red"


def swap_with_one_of_another_population(records: list[dict[str, Any]]) -> None:
    for name in ("genome", "genome_hash", "results", "score"):
        records[17][name], records[18][name] = records[18][name], records[17][name]


@pytest.mark.parametrize("change", [raise_scores, meet_others, change_population, swap_with_one_of_another_population])
def test_a_falsehood_is_found(whole: Path, tmp_path: Path, change: Callable[[list[dict[str, Any]]], None]) -> None:
    shutil.copytree(whole, tmp_path / "run")
    forge(tmp_path / "run", change)
    found = verdict(tmp_path / "run", None if change is raise_scores else 0)
    assert found.verdict == "broken" and any("candidate 17:" in finding for finding in found.findings), found.findings


def meet_nobody(records: list[dict[str, Any]]) -> None:
    del records[17]["opponents"]


def meet_too_many(records: list[dict[str, Any]]) -> None:
    records[17]["opponents"] = [[2, 4]]


@pytest.mark.parametrize("change", [meet_nobody, meet_too_many])
def test_what_no_run_could_have_written_is_no_record(
    whole: Path, tmp_path: Path, change: Callable[[list[dict[str, Any]]], None]
) -> None:
    shutil.copytree(whole, tmp_path / "run")
    forge(tmp_path / "run", change)
    with pytest.raises(RunError, match=r"line 18: .*opponents"):
        Run.open(tmp_path / "run")


# -- settings ---------------------------------------------------------------------------------------------------------


def test_settings_are_kept_with_all_defaults_and_begin_the_same_run_again(whole: Path, tmp_path: Path) -> None:
    document = json.loads((whole / "run.json").read_text())
    assert [population["role"] for population in document["populations"]] == ["red", "blue"]
    assert document["options"]["elites"] == 0 and document["starts"] == []
    again = Run.create(tmp_path / "run", RunSettings.read({**document, "budget": 6}))
    assert finish(again).digest == Run.open(whole).records[5].digest


def test_a_task_with_roles_has_populations_of_all_of_them_by_default() -> None:
    bare = {name: value for name, value in DUEL_RUN.items() if name != "populations"}
    assert [each.role for each in RunSettings.read(bare).populations] == ["red", "blue"]
    assert [each.role for each in RunSettings.read({**bare, "task": ALIKE}).populations] == ["red"]


def populations(*roles: str) -> dict[str, Any]:
    return {"populations": [{"role": role} for role in roles]}


@pytest.mark.parametrize(
    ("settings", "place", "words"),
    [
        (populations("red", "bleu"), "populations/1/role", "did you mean blue"),
        (populations("red", "red"), "populations/1/role", "already"),
        (populations("red"), "populations/0/role", "blue has none"),
        (populations(), "populations", "1 to 8"),
        ({"task": "walk"}, "populations", "walk has no roles"),
        ({"task": {**MOMENT, "roles": [{**MOMENT["roles"][0], "target": [0, 0, 0]}]}}, "populations/0/role", "nobody"),
        ({"starts": ["walker"]}, "starts", "populations/0/starts"),
        ({"algorithm": "nsga2"}, "algorithm", "ga"),
        ({"algorithm": "gaa"}, "algorithm", "did you mean ga"),
        ({"algorithm": "cma", **populations("red", "blue")}, "populations/0/starts", "such as walker"),
        ({"objectives": ["distance"]}, "objectives", "no use"),
        ({"objectives": ["duty"]}, "objectives", "no use"),
        ({"options": {"erra": 3}}, "options.erra", "did you mean era"),
        ({"options": {"era": 0}}, "options.era", "from 1 to"),
        ({"options": {"window": 0}}, "options.window", "from 1 to"),
        (
            {"populations": [{"role": "red", "starts": ["nobody"]}, {"role": "blue"}]},
            "populations/0/starts/0",
            "nobody",
        ),
        ({"task": {**MOMENT, "limits": {"mass": 1}}}, "populations/0/starts/0", "may not take part"),
    ],
    ids=lambda value: str(value)[:40],
)
def test_what_cannot_be_run_is_refused_in_words(settings: dict[str, Any], place: str, words: str) -> None:
    options = {} if "algorithm" in settings else DUEL_RUN["options"]
    with pytest.raises(DocumentError) as error:
        RunSettings.read({**DUEL_RUN, "options": options, **settings})
    assert error.value.problems[0][0] == place and words in error.value.message
