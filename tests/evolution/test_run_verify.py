"""What somebody changes in a run, however well the log's chain is mended afterwards, is found."""

from __future__ import annotations

import json
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import orjson
import pytest
from click.testing import CliRunner, Result

from modelled import modelled
from nmes.cli import main
from nmes.errors import RunError
from nmes.evaluation import Evaluation
from nmes.evaluation.contest import Rivals
from nmes.evaluation.parallel import Here, Workers
from nmes.evaluation.queue import EvaluationQueue
from nmes.evolution.rerun import record_candidate
from nmes.evolution.run import Run
from nmes.evolution.run_verify import verify_run
from nmes.genome import Genome
from runs import begin, finish, forge
from vectors import vector_genome

Records = list[dict[str, Any]]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole") / "run"
    finish(begin(folder, budget=20))
    return folder


@pytest.fixture
def run(whole: Path, tmp_path: Path) -> Path:
    shutil.copytree(whole, tmp_path / "run")
    return tmp_path / "run"


def verify(folder: Path, *options: str) -> Result:
    result = CliRunner().invoke(main, ["evolve", "verify", str(folder), "--jobs", "1", *options])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


def verdict(folder: Path, *options: str) -> dict[str, Any]:
    result = verify(folder, "--json", *options)
    found: dict[str, Any] = json.loads(result.stdout)
    assert result.exit_code == {"holds": 0, "broken": 1, "not_comparable": 3}[found["verdict"]]
    return found


def test_a_run_that_is_as_it_came_out_holds(whole: Path) -> None:
    result = verify(whole, "--all")
    assert result.exit_code == 0 and "20 of 20 candidates asked for again, 20 evaluated again" in result.stdout
    before = {path.name: path.read_bytes() for path in whole.iterdir()}
    found = verdict(whole, "--sample", "2")
    assert (found["verdict"], found["asked"], found["findings"]) == ("holds", 20, [])
    assert 2 < found["evaluated"] < 20
    assert {path.name: path.read_bytes() for path in whole.iterdir()} == before


def test_a_run_without_its_index_and_one_that_is_not_finished_hold_too(run: Path) -> None:
    forge(run, lambda records: records.__delitem__(slice(15, None)))
    found = verdict(run, "--sample", "0")
    assert (found["verdict"], found["asked"]) == ("holds", 15)


def scored(records: Records) -> dict[str, Any]:
    """One of the records that have a score and have moved."""
    return next(each for each in records[16:18] if each["score"] is not None and each["results"][0]["energy"] > 0.0)


def raise_score(records: Records) -> None:
    scored(records)["score"] += 1.0


def raise_score_and_result(records: Records) -> None:
    scored(records)["score"] += 1.0
    scored(records)["results"][0]["score"] += 1.0


def lower_energy(records: Records) -> None:
    scored(records)["results"][0]["energy"] *= 1.0 - 1e-15


def hide_failure(records: Records) -> None:
    records[17]["error"] = "it would not"
    records[17]["results"] = []
    records[17]["score"] = None


def drop_result(records: Records) -> None:
    records[17]["results"] = []


def give_objectives(records: Records) -> None:
    records[17]["objectives"] = [1.0]


def swap_genome(records: Records) -> None:
    records[17]["genome"], records[17]["genome_hash"] = records[3]["genome"], records[3]["genome_hash"]


def swap_genome_alone(records: Records) -> None:
    records[17]["genome"] = records[3]["genome"]


def swap_genomes_and_scores(records: Records) -> None:
    for name in ("genome", "genome_hash", "results", "score", "error"):
        records[17][name], records[3][name] = records[3][name], records[17][name]


def turn_a_number(records: Records) -> None:
    records[17]["genome"]["body"] = json.loads(json.dumps(records[17]["genome"]["body"]))
    part = (records[17]["genome"]["body"].get("cubes") or records[17]["genome"]["body"]["graph"]["parts"])[0]
    part["size"][0] *= 1.0 + 1e-15


def rename_operator(records: Records) -> None:
    records[17]["operator"] = "magic"


def change_parents(records: Records) -> None:
    records[17]["parents"] = [0]


def change_group(records: Records) -> None:
    records[17]["group"] = "others"


def change_generation(records: Records) -> None:
    records[17]["generation"] += 1


def remove(records: Records) -> None:
    del records[17]


def remove_and_count_anew(records: Records) -> None:
    del records[17]
    for index, record in enumerate(records):
        record["index"] = index


def reorder(records: Records) -> None:
    records[16], records[17] = records[17], records[16]


def reorder_and_count_anew(records: Records) -> None:
    reorder(records)
    records[16]["index"], records[17]["index"] = 16, 17


def no_genome(records: Records) -> None:
    records[17]["genome"]["body"] = {}


def other_shape(records: Records) -> None:
    records[17]["score"] = "much"


@pytest.mark.parametrize(
    "change",
    [
        raise_score,
        raise_score_and_result,
        lower_energy,
        hide_failure,
        drop_result,
        give_objectives,
        swap_genome,
        swap_genome_alone,
        swap_genomes_and_scores,
        turn_a_number,
        rename_operator,
        change_parents,
        change_group,
        change_generation,
        remove,
        remove_and_count_anew,
        reorder,
        reorder_and_count_anew,
        no_genome,
        other_shape,
    ],
)
def test_a_falsehood_is_found(run: Path, change: Callable[[Records], None]) -> None:
    forge(run, change)
    found = verdict(run, "--all")
    assert found["verdict"] == "broken" and 0 < len(found["findings"]) <= 20
    told = "\n".join(found["findings"])
    assert any(f"candidate {index}:" in told or f"line {index + 1}:" in told for index in (3, 16, 17)), told


def test_a_line_that_was_changed_without_its_digest_is_named(run: Path) -> None:
    text = (run / "log.jsonl").read_bytes()
    (run / "log.jsonl").write_bytes(text.replace(b'"index":17', b'"index":71'))
    found = verdict(run)
    assert found["verdict"] == "broken" and "line 18" in found["findings"][0]


def test_an_index_that_says_otherwise_than_the_log_is_found(run: Path) -> None:
    with sqlite3.connect(run / "index.sqlite") as db:
        db.execute('UPDATE records SET score = 99.0 WHERE "index" = 5')
    db.close()
    found = verdict(run)
    assert found["verdict"] == "broken" and "candidate 5: the index" in found["findings"][0]


@pytest.mark.parametrize(("what", "value"), [("elites", "[3]"), ("elites", "[]"), ("figures", '{"cells": 9}')])
def test_an_index_that_says_otherwise_than_the_algorithm_is_found(run: Path, what: str, value: str) -> None:
    with sqlite3.connect(run / "index.sqlite") as db:
        db.execute(f"UPDATE state SET {what} = ?", [value])
    db.close()
    found = verdict(run, "--sample", "0")
    assert found["verdict"] == "broken" and f"the index has other {what}" in found["findings"][0]


@pytest.mark.parametrize("told", [0, 1, 7])
def test_what_the_index_of_a_run_that_goes_on_says_is_compared_whenever_it_was(run: Path, told: int) -> None:
    document = orjson.loads((run / "run.json").read_bytes())
    (run / "run.json").write_bytes(orjson.dumps({**document, "budget": document["budget"] + 1}))
    assert verdict(run, "--sample", "0")["verdict"] == "holds"
    with sqlite3.connect(run / "index.sqlite") as db:
        db.execute("UPDATE state SET told = ?, elites = '[]', figures = ?", [told, '{"cells": 9999}'])
    db.close()
    found = verdict(run, "--sample", "0")
    assert found["verdict"] == "broken" and f"after {told} candidates: the index has other" in found["findings"][0]


def test_settings_that_were_changed_are_found(run: Path) -> None:
    document = orjson.loads((run / "run.json").read_bytes())
    (run / "run.json").write_bytes(orjson.dumps({**document, "seed": 4}))
    assert verdict(run)["verdict"] == "broken"
    forge(run, lambda records: None)  # as if the log had been of these settings
    assert verdict(run)["verdict"] == "broken"


def test_what_does_not_come_out_elsewhere_is_not_comparable_and_what_does_holds(run: Path) -> None:
    document = orjson.loads((run / "run.json").read_bytes())
    elsewhere = {**document["fingerprint"], "probe": "of another machine"}
    (run / "run.json").write_bytes(orjson.dumps({**document, "fingerprint": elsewhere}))
    assert verdict(run)["verdict"] == "holds"
    forge(run, lower_energy)
    assert verdict(run, "--all")["verdict"] == "not_comparable"


def test_the_candidates_that_are_done_again_are_others_each_time_and_have_the_best(
    whole: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    chosen: list[tuple[int, ...]] = []

    def again(_: Any, numbers: list[int], __: Any) -> list[Any]:
        chosen.append(tuple(numbers))
        return []

    monkeypatch.setattr("nmes.evolution.run_verify._Verification.evaluate_again", again)
    best = Run.open(whole).best
    seeds = [verdict(whole, "--sample", "3")["seed"] for _ in range(8)]
    assert best is not None and all(best.index in numbers for numbers in chosen)
    assert len(set(seeds)) == 8 and len(set(chosen)) > 4
    told = verify(whole, "--sample", "3", "--seed", str(seeds[0])).stdout
    assert chosen[-1] == chosen[0] and f"evaluated again, drawn by --seed {seeds[0]}\n" in told


def test_what_a_model_rounds_otherwise_is_not_comparable(tmp_path: Path) -> None:
    folder = tmp_path / "models"
    finish(begin(folder, starts=[modelled()], budget=10, options={"founders": 4, "population": 4, "window": 2}))
    forge(folder, lambda records: records[2]["results"][0].update(energy=7.0))
    found = verdict(folder, "--all")
    assert found["verdict"] == "not_comparable" and "it has an ONNX brain" in found["findings"][0]
    with pytest.raises(RunError, match="it has an ONNX brain") as error:
        record_candidate(Run.open(folder), 2, tmp_path, [1])
    assert error.value.code == "not_comparable"
    forge(folder, lambda records: records[3].update(operator="magic"))  # which no model has a part in
    assert verdict(folder, "--all")["verdict"] == "broken"


def test_few_candidates_of_a_long_run_are_in_memory_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    under_way = [0]

    class Counted(EvaluationQueue):
        def put(self, number: int, genome: Genome, rivals: Rivals | None = None) -> None:
            under_way.append(under_way[-1] + 1)
            super().put(number, genome, rivals)

        def take(self) -> list[tuple[int, Evaluation]]:
            taken = super().take()
            under_way.append(under_way[-1] - len(taken))
            return taken

    start = vector_genome([1.0] * 4).document
    finish(begin(tmp_path / "run", algorithm="es", options={"population": 10}, starts=[start], budget=300))
    monkeypatch.setattr("nmes.evolution.run_verify.EvaluationQueue", Counted)
    verdict = verify_run(tmp_path / "run", Here(), None, lambda doing, done, total: None, seed=1)
    assert (verdict.verdict, verdict.evaluated) == ("holds", 300)
    assert under_way[-1] == 0 and max(under_way) == 256
    with Workers(3) as workers:  # of more processes each has enough to do
        assert verify_run(tmp_path / "run", workers, None, lambda doing, done, total: None, seed=1) == verdict
    assert under_way[-1] == 0 and 256 < max(under_way) <= 3 * 2 * 64


def come_from_later(records: Records) -> None:
    records[17]["parents"] = [18]


@pytest.mark.parametrize("change", [come_from_later, give_objectives])
def test_what_no_run_could_have_written_is_no_record(run: Path, change: Callable[[Records], None]) -> None:
    forge(run, change)
    with pytest.raises(RunError, match="line 18"):
        Run.open(run)
