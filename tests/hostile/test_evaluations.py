"""Evaluations under attack: files that are not theirs, runs that meet in one folder, episodes that fail."""

from __future__ import annotations

import fcntl
import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from boards import DASH
from creatures import SINE, cpg, snake
from nmes.cli import main
from nmes.errors import RecordingError
from nmes.evaluation import Episode, Evaluator, Job, Task, evaluate, evaluator, prove
from nmes.evaluation.kept_lines import sealed, unsealed
from nmes.genome import Genome
from nmes.recording import Recorder


def run(*arguments: str | Path) -> Result:
    """Runs `nmes eval`; a traceback is a failure."""
    result = CliRunner().invoke(main, ["eval", *map(str, arguments)])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


@pytest.fixture
def dash(tmp_path: Path) -> Path:
    path = tmp_path / "dash.json"
    path.write_text(json.dumps(DASH))
    return path


@pytest.fixture
def wave(tmp_path: Path) -> Path:
    path = tmp_path / "wave.json"
    path.write_text(json.dumps(snake(SINE, name="wave")))
    return path


@pytest.fixture(scope="module")
def proofs(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Recordings of one creature, an episode a seed."""
    return list(evaluate(Genome(snake()), Task(DASH), record=tmp_path_factory.mktemp("proofs")).recordings)


# -- rescoring --------------------------------------------------------------------------------------------------------


def test_one_proof_is_not_averaged_with_itself(proofs: list[str], tmp_path: Path) -> None:
    copied = shutil.copy(proofs[0], tmp_path / "copy.mcap")
    (tmp_path / "again").mkdir()
    again = evaluate(Genome(snake()), Task(DASH), seeds=[3], record=tmp_path / "again").recordings
    for twice in (proofs[0], copied, *again):
        result = run("--from-recording", proofs[0], twice, proofs[1])
        assert result.exit_code == 2 and "seed 3" in result.stderr and Path(twice).name in result.stderr
        assert result.stdout == ""
    whole = run("--from-recording", *proofs)
    assert whole.exit_code == 0 and whole.stderr == ""


def test_seeds_that_are_not_the_tasks_own_are_told(proofs: list[str]) -> None:
    result = run("--from-recording", proofs[1], "--json")
    assert result.exit_code == 0 and [row["seed"] for row in json.loads(result.stdout)[0]["results"]] == [4]
    assert "seeds of dash are 3-4" in result.stderr


def test_metadata_that_are_none_prove_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    genome, task = Genome(snake()), Task(DASH)
    good = {"task": json.dumps(task.document), "genome": genome.hash, "seed": "3"}
    hostile = [
        {"task": "{"}, {"task": "[" * 5000}, {"task": "null"}, {"task": "1e999"}, {"task": '{"name": 1, "name": 2}'},
        {"seed": ""}, {"seed": "x"}, {"seed": "-1"}, {"seed": "3.0"}, {"seed": "1_0"}, {"seed": "9" * 5000},
    ]  # fmt: skip
    for number, harm in enumerate(hostile):
        false = {"nmes.evaluation": {**good, **harm}}

        def damaged(*given: Any, false: Any = false, **named: Any) -> Any:
            return Recorder(*given, **{**named, "about": false})

        monkeypatch.setattr(evaluator, "Recorder", damaged)
        (made,) = evaluate(genome, task, seeds=[3], record=tmp_path).recordings
        result = run("--from-recording", made)
        assert result.exit_code == 1 and result.stdout == "" and len(result.stderr) < 2000, number


# -- files ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "content",
    [
        b"my notes, on one line",
        b'{"key": 1}',
        b'{"ke',
        b"{",
        b"one\ntwo",
        b"one\ntwo\n",
        b"\x00" * 100,
        b'{"key":"' + b"0" * 64 + b'","genome":"a"}\n',
        b"[]\n",
        b'"key"\n',
        b"\xff\xfe",
    ],
)
def test_a_file_that_is_not_of_an_evaluation_stays_as_it_is(wave: Path, dash: Path, content: bytes) -> None:
    file = wave.with_name("notes.txt")
    file.write_bytes(content)
    result = run(wave, "--task", dash, "--jobs", "1", "--resume", file)
    assert result.exit_code == 2 and "notes.txt" in result.stderr
    assert file.read_bytes() == content


@pytest.mark.parametrize(
    "change",
    [
        {"results": [{"seed": "x"}]}, {"results": 3}, {"genome": 4}, {"task": []}, {"error": 5}, {"wall_seconds": "x"},
        {"results": [{"seed": 1, "score": "9", "energy": 0.0, "distance": 0.0, "ticks": 1}]}, {"recordings": [1]},
        {"results": [{"seed": [], "score": 1.0, "energy": 0.0, "distance": 0.0, "ticks": 1}]},
    ],
)  # fmt: skip
def test_results_that_were_edited_are_refused(wave: Path, dash: Path, change: dict[str, Any]) -> None:
    file = wave.with_name("kept.jsonl")
    arguments = (wave, "--task", dash, "--jobs", "1", "--resume", file)
    assert run(*arguments).exit_code == 0
    changed = {**unsealed(file.read_bytes()), **change}
    for line in (sealed(changed), json.dumps(changed).encode() + b"\n"):
        file.write_bytes(line)
        result = run(*arguments)
        assert result.exit_code == 2 and "line 1" in result.stderr and file.read_bytes() == line


def test_a_score_that_was_edited_is_not_taken_for_one_that_came_out(wave: Path, dash: Path, tmp_path: Path) -> None:
    kept, cup = tmp_path / "kept.jsonl", tmp_path / "cup"
    commands: dict[Path, list[str | Path]] = {
        kept: ["eval", wave, "--task", dash, "--resume", kept],
        cup / "matches.jsonl": ["tournament", "walker", "roller", "--task", "sumo", "--seeds", "1", "-o", cup],
    }
    for file, command in commands.items():
        words = [*map(str, command), "--jobs", "1"]
        assert CliRunner().invoke(main, words).exit_code == 0
        edited = re.sub(rb'"score":[-0-9.e]+', b'"score":999.5', file.read_bytes())
        file.write_bytes(edited)
        result = CliRunner().invoke(main, words)
        assert result.exit_code in (1, 2) and f"{file}, line 1: not as `nmes" in result.output
        assert file.read_bytes() == edited


@pytest.mark.parametrize("cut", [1, 5, 30, 80, 200])
def test_a_line_that_was_cut_off_is_done_again(wave: Path, dash: Path, cut: int) -> None:
    other = wave.with_name("other.json")
    other.write_text(json.dumps(snake(cpg(4), name="other")))
    file = wave.with_name("kept.jsonl")
    arguments = (wave, other, "--task", dash, "--jobs", "1", "--resume", file, "--csv")
    first = run(*arguments).stdout
    lines = file.read_bytes().splitlines(keepends=True)
    file.write_bytes(lines[0] + lines[1][:cut])
    assert [row.split(",")[:-1] for row in run(*arguments).stdout.splitlines()] == [
        row.split(",")[:-1] for row in first.splitlines()
    ]
    assert len(file.read_bytes().splitlines()) == 2


def test_what_is_done_is_done_again_where_it_has_no_recording(wave: Path, dash: Path) -> None:
    file, folder = wave.with_name("kept.jsonl"), wave.with_name("r")
    arguments = (wave, "--task", dash, "--jobs", "1", "--resume", file)
    scores = json.loads(run(*arguments, "--json").stdout)[0]["results"]

    def recorded() -> list[int]:
        (told,) = json.loads(run(*arguments, "--record", folder, "--json").stdout)
        assert told["results"] == scores and told["recordings"] == sorted(map(str, folder.iterdir()))
        return [path.stat().st_mtime_ns for path in map(Path, told["recordings"])]

    first = recorded()
    assert len(first) == 2 and recorded() == first
    next(folder.iterdir()).unlink()
    assert len(recorded()) == 2
    big = wave.with_name("big.json")
    dash.write_text(json.dumps({**DASH, "limits": {"cubes": 1}}))
    big.write_text(json.dumps(snake(SINE, name="big")))
    for _ in range(2):  # what cannot take part has none
        assert run(big, "--task", dash, "--jobs", "1", "--resume", file, "--record", folder).exit_code == 1
    assert len(file.read_bytes().splitlines()) == 4


def test_two_evaluations_do_not_share_a_file_of_results(wave: Path, dash: Path) -> None:
    file = wave.with_name("kept.jsonl")
    arguments = (wave, "--task", dash, "--jobs", "1", "--resume", file)
    with file.open("ab") as held:  # as another process has it while it runs
        fcntl.flock(held, fcntl.LOCK_EX)
        second = run(*arguments)
        assert second.exit_code == 2 and "another nmes eval" in second.stderr and file.read_bytes() == b""
    assert run(*arguments).exit_code == 0 and file.read_bytes().count(b"\n") == 1


def test_two_evaluations_of_equal_content_may_record_into_one_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    genome, task, meetings = Genome(snake()), Task(DASH), 0
    episode = Episode.run

    def meet(self: Episode) -> Any:
        """Lets another evaluation of the same begin and end while this one runs."""
        nonlocal meetings
        meetings += 1
        if meetings == 1:
            assert evaluate(genome, task, record=tmp_path).error is None
        return episode(self)

    monkeypatch.setattr(Episode, "run", meet)
    evaluation = evaluate(genome, task, record=tmp_path)
    assert evaluation.error is None and meetings == 4
    assert [prove(path).result for path in evaluation.recordings] == list(evaluation.results)
    assert sorted(map(str, tmp_path.iterdir())) == sorted(evaluation.recordings)


def test_recordings_of_tasks_and_genomes_of_one_name_do_not_replace_each_other(tmp_path: Path) -> None:
    tasks = [Task(DASH), Task({**DASH, "objective": "10.0 + displacement.horizontal"})]
    genomes = [Genome(snake()), Genome(snake(cpg(4)))]
    made = [evaluate(genome, task, record=tmp_path) for genome in genomes for task in tasks]
    paths = [path for evaluation in made for path in evaluation.recordings]
    assert len(set(paths)) == 8 == len(list(tmp_path.iterdir()))
    for path in paths:
        proof = prove(path)
        assert proof.genome.hash[:16] in path and proof.task.hash[:16] in path


def test_a_plot_does_not_take_the_place_of_what_is_read(
    proofs: list[str], tmp_path: Path, wave: Path, dash: Path
) -> None:
    path = Path(shutil.copy(proofs[0], tmp_path / "a.mcap"))
    before = path.read_bytes()
    result = run("--from-recording", path, "--plot", path)
    assert result.exit_code == 2 and path.read_bytes() == before
    for read in (wave, dash):
        result = run(wave, "--task", dash, "--record", tmp_path / "r", "--plot", read)
        assert result.exit_code == 2 and json.loads(read.read_bytes())["name"] == read.stem


@pytest.mark.parametrize("command", ["show", "expand"])
def test_a_genome_is_not_replaced_by_what_is_made_of_it(wave: Path, command: str) -> None:
    before = wave.read_bytes()
    link = wave.with_name("link.json")
    link.symlink_to(wave)
    for output in (wave, link):
        result = CliRunner().invoke(main, ["genome", command, str(wave), "-o", str(output)])
        assert result.exit_code == 2 and "wave.json" in result.stderr and wave.read_bytes() == before
    whole = CliRunner().invoke(main, ["genome", "expand", str(wave), str(link), "-o", str(wave.parent)])
    assert whole.exit_code == 2 and wave.read_bytes() == before


# -- episodes ---------------------------------------------------------------------------------------------------------


def test_an_episode_that_fails_has_no_score_and_stops_no_other(
    wave: Path, dash: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps = Episode.steps

    def fail(self: Episode) -> Any:
        if self._seed == 3:
            raise ValueError("ordering is undefined:\nNaN")
        return steps(self)

    monkeypatch.setattr(Episode, "steps", fail)
    folder = wave.with_name("r")
    for options in ((), ("--record", folder)):
        result = run(wave, "--task", dash, "--jobs", "1", "--json", *options)
        (evaluation,) = json.loads(result.stdout)
        assert result.exit_code == 1 and evaluation["score"] is None and evaluation["faults"] == 1
        bad, good = evaluation["results"]
        assert bad["fault"] == "failed: ValueError: ordering is undefined:\nNaN" and bad["score"] is None
        assert good["fault"] is None and good["score"] is not None
    assert [path.suffix for path in folder.iterdir()] == [".mcap"]
    assert "wave, seed 3" in run(wave, "--task", dash, "--jobs", "1").stdout


def test_an_objective_without_a_value_is_a_fault_or_a_number(wave: Path, dash: Path) -> None:
    for objective in ("height < sqrt(position.x) ? 1.0 : 2.0", "sqrt(-1.0 - energy)", "1.0 / (energy - energy)"):
        dash.write_text(json.dumps({**DASH, "objective": objective}))
        result = run(wave, "--task", dash, "--jobs", "1", "--json")
        (evaluation,) = json.loads(result.stdout)
        assert result.exit_code == (1 if evaluation["faults"] else 0)
        for each in evaluation["results"]:
            assert (each["score"] is None) == (each["fault"] is not None)


def test_a_recording_that_cannot_be_written_is_an_error_in_every_process(wave: Path, dash: Path) -> None:
    task = json.dumps(DASH).encode()
    folder = str(wave)  # a file
    for jobs in (1, 2):
        work = [Job(f"{i}", json.dumps(snake(name=f"n{i}")).encode(), task, None, folder) for i in range(2)]
        with pytest.raises(RecordingError), Evaluator(jobs) as workers:
            list(workers.run(work))


def test_a_genome_that_breaks_the_reader_is_an_error_of_its_own(
    wave: Path, dash: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def overflow(text: bytes) -> Genome:
        raise OverflowError("math range error")

    monkeypatch.setattr(Genome, "parse", overflow)
    result = run(wave, "--task", dash, "--jobs", "1")
    assert result.exit_code == 1 and "wave: OverflowError: math range error" in result.stdout
