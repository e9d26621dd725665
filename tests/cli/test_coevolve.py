"""`nmes evolve` with a task that has roles: populations, their champions and the proofs of these, as a person would."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import orjson
import pytest
from click.testing import CliRunner, Result

from coevolution_runs import DUEL_RUN, MOMENT
from duels import push
from nmes.cli import main
from nmes.evaluation import play, prove_match
from nmes.evolution.run import Run
from opengl import with_opengl
from runs import forge

ROLES = ("red", "blue")
SVG = "{http://www.w3.org/2000/svg}"
OPTIONS = [word for name, value in DUEL_RUN["options"].items() for word in ("--set", f"{name}={value}")]


def nmes(*arguments: str | Path) -> Result:
    result = CliRunner().invoke(main, ["evolve", *map(str, arguments)])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a task, the same with roles that are alike, and two carts."""
    folder = tmp_path_factory.mktemp("duel")
    documents = {"duel": MOMENT, "alike": {**MOMENT, "interchangeable": True}, "slow": push(), "fast": push(3.0)}
    for name, document in documents.items():
        (folder / f"{name}.json").write_bytes(orjson.dumps(document))
    return folder


@pytest.fixture(scope="module")
def whole(place: Path) -> Path:
    """The folder of a finished run."""
    begin: tuple[str | Path, ...] = (
        "--task",
        place / "duel.json",
        "--populations",
        "red,blue",
        "--budget",
        "20",
        "--seed",
        "3",
        *OPTIONS,
    )
    result = nmes(place / "slow.json", place / "fast.json", *begin, "-o", place / "run", "--jobs", "1")
    assert result.exit_code == 0, result.output
    return place / "run"


def test_a_run_is_that_of_its_settings_and_ends_with_its_champions(whole: Path, tmp_path: Path) -> None:
    (tmp_path / "settings.json").write_bytes(orjson.dumps({**DUEL_RUN, "budget": 4}))
    other = nmes("--settings", tmp_path / "settings.json", "-o", tmp_path / "run", "--jobs", "1", "--json")
    assert json.loads(other.stdout)["digest"] == Run.open(whole).records[3].digest
    ended, told = nmes("resume", whole), json.loads(nmes("resume", whole, "--json").stdout)
    assert f"digest: {told['digest']}" in ended.stdout and told["best"] is None
    assert list(told["champions"]) == ["red", "blue"] and told["figures"] == {"eras": 2}
    for role, champion in told["champions"].items():
        assert f"champion of {role}: candidate {champion['index']} (cart), {champion['score']:.6g}" in ended.stdout
    verdict = nmes("verify", whole, "--sample", "0", "--jobs", "1")
    assert verdict.exit_code == 0 and "holds: 20 of 20" in verdict.stdout


def test_what_a_run_begins_with_is_for_each_population_or_all_for_the_only_one(place: Path, tmp_path: Path) -> None:
    slow, fast = place / "slow.json", place / "fast.json"
    cases: dict[str, tuple[tuple[str | Path, ...], list[tuple[str, int]]]] = {
        "each": (
            ("random", fast, "--task", place / "duel.json", "--populations", "blue, red"),
            [("blue", 0), ("red", 1)],
        ),
        "alone": ((slow, fast, "--task", place / "alike.json"), [("red", 2)]),
    }
    for name, (arguments, populations) in cases.items():
        settings: tuple[str | Path, ...] = ("--budget", "1", *OPTIONS, "-o", tmp_path / name, "--jobs", "1")
        assert nmes(*arguments, *settings).exit_code == 0, name
        document = orjson.loads((tmp_path / name / "run.json").read_bytes())
        assert [(each["role"], len(each["starts"])) for each in document["populations"]] == populations, name


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("random", "--task", "walk", "--populations", "red"), "walk has no roles"),
        (("random", "--task", "sumo", "--populations", "rad"), "did you mean red"),
        (("random", "--task", "sumo", "--populations", "red,,blue"), "with commas"),
        (("random", "walker", "roller", "--task", "sumo", "--populations", "red,blue"), "once for each of red, blue"),
        (("random", "walker", "--task", "sumo"), "either"),
        (("random", "--task", "sumo", "--algorithm", "map-elites"), "scores of long ago"),
        (("random", "--task", "sumo", "--objective", "distance"), "no use for objectives"),
        (("random", "--task", "sumo", "--set", "latest=0"), "latest"),
        (("--settings", "SETTINGS", "--populations", "red"), "--settings"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else value,
)
def test_wrong_usage_is_told_and_makes_nothing(
    arguments: tuple[str, ...], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("SETTINGS").write_bytes(orjson.dumps(DUEL_RUN))
    result = nmes(*arguments)
    assert result.exit_code == 2 and words in " ".join(result.output.split()), result.output
    assert [path.name for path in tmp_path.iterdir()] == ["SETTINGS"]


def test_the_best_of_a_run_are_its_champions_with_their_matches(whole: Path, tmp_path: Path) -> None:
    result = nmes("best", whole, "-o", tmp_path / "best", "--json")
    written: list[dict[str, Any]] = json.loads(result.stdout)
    run = Run.open(whole)
    assert [each["index"] for each in written] == [champion.index for champion in run.champions().values()]
    for role, each in zip(("red", "blue"), written, strict=True):
        proofs = [prove_match(path, brain=True) for path in each["recordings"]]
        hashes = {proof.genomes[role].hash for proof in proofs}
        assert hashes == {run.records[each["index"]].genome_hash} and len(proofs) == 2
        assert sum(proof.results[role].score or 0.0 for proof in proofs) / 2 == each["score"]
        assert {path.suffix for path in (tmp_path / "best" / role).iterdir()} == {".mcap", ".json"}
    one = json.loads(nmes("best", whole, "--index", "0", "-o", tmp_path / "first", "--json").stdout)
    assert one["index"] == 0 and (tmp_path / "first" / "genome.json").is_file()


def test_the_best_of_a_forged_run_leaves_nothing(whole: Path, tmp_path: Path) -> None:
    shutil.copytree(whole, tmp_path / "run")

    def raise_score(records: list[dict[str, Any]]) -> None:
        records[14]["score"] = 9.0
        for result in records[14]["results"]:
            result["score"] = 9.0

    forge(tmp_path / "run", raise_score)
    result = nmes("best", tmp_path / "run", "-o", tmp_path / "best")
    assert result.exit_code == 1 and "candidate 14" in result.output
    assert [path for path in (tmp_path / "best").rglob("*") if path.is_file()] == []


# -- pictures ---------------------------------------------------------------------------------------------------------


def test_a_run_is_shown_with_its_champions(whole: Path) -> None:
    result, told = nmes("show", whole), json.loads(nmes("show", whole, "--json").stdout)
    champions = Run.open(whole).champions()
    assert told["best"] is None and len(told["settings"]["populations"]) == 2
    assert told["champions"] == {role: {"index": each.index, "score": each.score} for role, each in champions.items()}
    for role, each in champions.items():
        assert f"champion of {role}  " in result.stdout and f"(candidate {each.index}: " in result.stdout
    assert [row["index"] for row in told["top"]] == list(Run.open(whole).elites())


def titles(picture: Path) -> list[str]:
    """The words that a picture's parts have."""
    return [element.text or "" for element in ElementTree.parse(picture).iter(f"{SVG}title")][1:]


def test_champions_of_all_eras_are_drawn_against_each_other(whole: Path, tmp_path: Path) -> None:
    assert nmes("show", whole, "-o", tmp_path / "pictures").exit_code == 0
    names = ["eras", "eras-blue", "eras-red", "index", "lineage-blue", "lineage-red"]
    assert sorted({path.stem for path in (tmp_path / "pictures").iterdir()}) == names
    run = Run.open(whole)
    halls = {role: [row for row in map(run.records.__getitem__, run.elites()) if row.group == role] for role in ROLES}
    assert [len(hall) for hall in halls.values()] == [2, 2]
    fields = {role: titles(tmp_path / "pictures" / f"eras-{role}.svg") for role in ROLES}
    for red in halls["red"]:
        for blue in halls["blue"]:
            players = {"red": run.genome(red.index), "blue": run.genome(blue.index)}
            (match,) = play(MOMENT, players, seeds=run.settings.seeds[:1])
            for one, other in ((red, blue), (blue, red)):
                score = match.results[one.group].score
                told = f"candidate {one.index} of era {one.index // 8} against candidate {other.index} of era "
                assert f"{told}{other.index // 8}: {score:.4g}" in fields[one.group]
    assert all(len(each) == 4 for each in fields.values())
    circles = list(ElementTree.parse(tmp_path / "pictures" / "eras.svg").iter(f"{SVG}circle"))
    assert len(circles) == 4  # a champion of each population in each era


@with_opengl
def test_a_film_shows_the_champions_of_an_era_against_each_other(whole: Path, tmp_path: Path) -> None:
    result = nmes("film", whole, "-o", tmp_path / "film.png", "--seconds", "0.2", "--size", "160x80")
    run = Run.open(whole)
    eldest = list(run.elites())[::-1]
    shown = [eldest[1], eldest[0], eldest[3], eldest[2]]
    assert result.exit_code == 0 and f"candidates {', '.join(map(str, shown))}" in result.stdout, result.output
    assert (tmp_path / "film.png").stat().st_size > 1000


def test_a_population_without_a_score_is_neither_drawn_nor_filmed(whole: Path, tmp_path: Path) -> None:
    shutil.copytree(whole, tmp_path / "run")

    def fail(records: list[dict[str, Any]]) -> None:
        for record in records[1::2]:
            record.update(score=None, results=[], error="it would not")

    forge(tmp_path / "run", fail)
    shown = nmes("show", tmp_path / "run", "-o", tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert shown.exit_code == 0 and "Where the champion of red comes from" in page and "champion of blue" not in page
    assert "Champions of red against" not in page
    film = nmes("film", tmp_path / "run", "-o", tmp_path / "film.png")
    assert film.exit_code == 1 and "nobody to film" in film.output and not (tmp_path / "film.png").exists()
