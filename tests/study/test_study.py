"""`nmes study`: runs that survive kills, reports that say what results say, and proofs that find what was changed."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pyarrow
import pyarrow.parquet
import pytest

from command_line import run
from nmes.errors import StudyError
from nmes.schemas.documents import ShippedDocuments, canonical_hash
from nmes.study import Results, Study, run_study, verify_study
from nmes.study.claims import evaluate
from nmes.study.document import PlannedRun
from processes import NMES
from studies import DISCUSSION, STUDY, edit, make_study


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small study, run in one go."""
    folder = make_study(tmp_path_factory.mktemp("studies") / "whole")
    result = run("study", "run", folder, "--jobs", "2")
    assert result.exit_code == 0, result.output
    assert result.output == f"farther: holds\nopen: undecided at this budget\nwrote {folder / 'small'}\n"
    return folder


@pytest.fixture
def copied(whole: Path, tmp_path: Path) -> Path:
    """A copy of the study with its results, to be changed."""
    shutil.copytree(whole, tmp_path / "whole", ignore=shutil.ignore_patterns("work"))
    return tmp_path / "whole"


def rows(folder: Path) -> list[dict[str, object]]:
    return list(Results.read(Study.load(folder).plan("small")).rows)


def verify(folder: Path, *options: str) -> tuple[int, str]:
    result = run("study", "verify", folder, *options)
    return result.exit_code, result.output


def nothing(done: int, total: int) -> None:
    pass


# -- results and report -----------------------------------------------------------------------------------------------


def test_results_have_a_row_for_each_arm_and_seed_with_what_the_commands_print(whole: Path) -> None:
    found = rows(whole)
    assert [(row["arm"], row["seed"]) for row in found] == [
        (arm, seed) for arm in ("swinging", "still") for seed in (1, 2, 3)
    ]
    printed = json.loads(
        run("eval", whole / "swinging.json", "--task", whole / "slide.json", "--seeds", "2", "--json").stdout
    )
    assert (found[1]["score"], found[1]["hash"]) == (printed[0]["score"], printed[0]["genome_hash"])


def test_a_report_has_verdicts_numbers_and_the_discussion(whole: Path) -> None:
    text = (whole / "small" / "REPORT.md").read_text()
    assert "> It gets farther.\n>\n> (nowhere)\n\nVerdict: **holds**" in text
    assert "> It is hard to tell.\n>\n> (nowhere)\n\nVerdict: **undecided at this budget**" in text
    scores = sorted(float(str(row["score"])) for row in rows(whole)[:3])
    assert f"Who swings gets {sum(scores) / 3:.4g} m ({scores[0]:.4g} to {scores[2]:.4g}): `farther` holds." in text
    assert "`alike`: part of the runs in which `hash` is the same in swinging as in still | 0 | exact | 3 | 3 |" in text
    assert (whole / "small" / "scores.svg").read_text().count('class="dots"') == 6


def test_a_study_that_is_as_it_was_holds(whole: Path) -> None:
    status, output = verify(whole, "--sample", "2", "--seed", "7")
    assert status == 0
    told = "holds: 2 of 6 runs done again, drawn by --seed 7\n"
    assert f"farther: holds\nopen: undecided at this budget\n{told}" in output


def test_the_runs_that_are_done_again_are_drawn_from_all_arms_and_otherwise_each_time(
    whole: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, found = Study.load(whole).plan("small"), rows(whole)
    chosen: list[tuple[object, int]] = []

    def perform(study: Study, run: PlannedRun, *others: object) -> dict[str, object]:
        chosen.append((run.arm["name"], run.seed))
        return {name: found[run.number][name] for name in study.document["columns"]}

    monkeypatch.setattr("nmes.study.run.perform", perform)
    draws = set()
    for seed in range(20):
        chosen.clear()
        assert verify_study(plan, 2, 1, nothing, seed).verdict == "holds"
        assert [arm for arm, _ in sorted(chosen, reverse=True)] == ["swinging", "still"]
        draws.add(tuple(sorted(chosen)))
    assert len(draws) > 5
    told = {json.loads(run("study", "verify", whole, "--sample", "0", "--json").stdout)["seed"] for _ in range(2)}
    assert len(told) == 2


# -- what a proof finds -----------------------------------------------------------------------------------------------


def change_number(small: Path) -> None:
    edit(small / "REPORT.md", "| 0 | exact", "| 1 | exact")


def change_verdict(small: Path) -> None:
    edit(small / "REPORT.md", "Verdict: **undecided at this budget**", "Verdict: **holds**")


def change_figure(small: Path) -> None:
    edit(small / "scores.svg", 'class="dots"', 'class="f1"')


def add_figure(small: Path) -> None:
    (small / "better.svg").write_text("<svg/>")


@pytest.mark.parametrize(
    ("change", "finding"),
    [
        (change_number, "REPORT.md, line "),
        (change_verdict, "REPORT.md, line "),
        (change_figure, "scores.svg, line "),
        (add_figure, "better.svg: no such figure comes of the results"),
        (lambda small: (small / "REPORT.md").unlink(), "REPORT.md cannot be read"),
    ],
)
def test_a_report_that_the_results_do_not_support_is_broken(
    change: Callable[[Path], None], finding: str, copied: Path
) -> None:
    assert verify(copied, "--sample", "0")[0] == 0
    change(copied / "small")
    status, output = verify(copied, "--sample", "0")
    assert status == 1 and finding in output and "broken: 0 of 6" in output


def forge(folder: Path, digest: bool) -> None:
    """Gives the first row another score; with a digest that fits, if asked."""
    path = folder / "small" / "results.parquet"
    table = pyarrow.parquet.read_table(path)
    found = table.to_pylist()
    found[0]["score"] += 1.0
    about = json.loads(table.schema.metadata[b"nmes.study"])
    if digest:
        about["digest"] = canonical_hash({"asked": about["asked"], "rows": found})[:32]
    schema = table.schema.with_metadata({b"nmes.study": json.dumps(about).encode()})
    pyarrow.parquet.write_table(pyarrow.Table.from_pylist(found, schema=schema), path)


def test_a_changed_row_is_found_by_the_digest_of_all_rows(copied: Path) -> None:
    forge(copied, digest=False)
    status, output = verify(copied, "--sample", "0")
    assert status == 1 and "the rows do not have the digest that the file names" in output
    assert run("study", "report", copied).exit_code == 1


@pytest.mark.parametrize(
    ("letters", "count", "packed", "words"),
    [
        (12_000_000, 6, "snappy", "its texts have over 67,108,864 characters"),
        (200_000, 6, "zstd", "it is packed in another way than results are"),
        (1, 500_000, "snappy", "it has 500,000 rows, and the study plans 6"),
    ],
)
def test_results_in_which_little_stands_for_much_are_not_unpacked(
    copied: Path, letters: int, count: int, packed: str, words: str
) -> None:
    path = copied / "small" / "results.parquet"
    about = pyarrow.parquet.read_schema(path).metadata
    text = pyarrow.DictionaryArray.from_arrays(pyarrow.array([0] * count, pyarrow.int32()), ["x" * letters])
    table = pyarrow.table({"hash": text}).cast(pyarrow.schema([("hash", pyarrow.string())], metadata=about))
    pyarrow.parquet.write_table(table, path, compression=packed)
    assert path.stat().st_size < 700_000
    status, output = verify(copied, "--sample", "0")
    assert status == 1 and words in output


def test_a_row_that_was_forged_with_all_that_follows_is_found_where_its_run_is_done_again(copied: Path) -> None:
    forge(copied, digest=True)
    assert run("study", "report", copied).exit_code == 0
    assert verify(copied, "--sample", "0")[0] == 0
    found = verify_study(Study.load(copied).plan("small"), None, 2, nothing)
    assert found.verdict == "broken" and len(found.findings) == 1
    assert found.findings[0].startswith("run 0 (arm swinging, seed 1): score is ")


def test_what_would_count_cannot_be_changed_after_the_run(copied: Path) -> None:
    edit(copied / "study.toml", "gain > 2", "gain > 0.1")
    status, output = verify(copied, "--sample", "0")
    assert status == 1 and "study.toml, or a document beside it, is not what these results answer" in output


def test_a_document_beside_cannot_be_changed_after_the_run(copied: Path) -> None:
    edit(copied / "slide.json", "Slide.", "Slide")
    assert verify(copied, "--sample", "0")[0] == 1


@pytest.mark.parametrize(
    ("discussion", "words"),
    [
        ("It gets 3 m.", "line 1: it has the digit 3"),
        ("Words.\nIt is {{better}}.", "line 2: there is no value better"),
    ],
)
def test_a_discussion_has_no_numbers_but_those_of_the_results(discussion: str, words: str, copied: Path) -> None:
    (copied / "small/discussion.md").write_text(discussion)
    for command in (("report",), ("verify", "--sample", "0")):
        result = run("study", command[0], copied, *command[1:])
        assert result.exit_code == 1 and words in result.output


def test_how_long_it_may_take_can_be_told_anew_after_the_run(copied: Path) -> None:
    edit(copied / "study.toml", "minutes = 0.1", "minutes = 0.2")
    assert verify(copied, "--sample", "1")[0] == 0


def test_a_discussion_may_change_after_the_run(copied: Path) -> None:
    (copied / "small/discussion.md").write_text(DISCUSSION + "More words, and `seeds = [1, 2, 3]`.\n")
    assert verify(copied, "--sample", "0")[0] == 1
    assert run("study", "report", copied).exit_code == 0
    assert verify(copied, "--sample", "0")[0] == 0
    (copied / "small/discussion.md").write_text(DISCUSSION + "More words, and `66 %` of the runs.\n")
    result = run("study", "report", copied)
    assert result.exit_code == 1 and "line 2: it has the digit 6" in result.output


def test_that_a_criterion_was_changed_can_be_told_after_the_run_and_is_in_the_report(copied: Path) -> None:
    edit(copied / "study.toml", "partly = 'gain < -1'", "partly = 'gain < -1'\nchanged = \"It asked for less.\"")
    status, output = verify(copied, "--sample", "0")
    assert status == 1 and "REPORT.md, line " in output
    assert run("study", "report", copied).exit_code == 0
    assert "  - in part: `gain < -1`\n  - changed: It asked for less.\n" in (copied / "small/REPORT.md").read_text()
    assert verify(copied, "--sample", "0")[0] == 0


def test_a_hidden_file_is_no_document_of_a_study(copied: Path) -> None:
    (copied / ".DS_Store").write_bytes(b"\0")
    assert verify(copied, "--sample", "0")[0] == 0
    (copied / "other.json").write_text("{}")
    assert verify(copied, "--sample", "0")[0] == 1


def test_a_study_with_a_folder_is_refused_since_no_change_in_it_would_be_noticed(copied: Path) -> None:
    (copied / ".hidden").mkdir()
    assert verify(copied, "--sample", "0")[0] == 0
    (copied / "genomes").mkdir()
    for command in ("run", "verify", "report"):
        result = run("study", command, copied)
        assert result.exit_code == 2
        assert f"{copied / 'genomes'} is a folder: documents of a study lie beside its study.toml" in result.output


def test_a_document_whose_name_is_no_text_is_refused(copied: Path) -> None:
    Path(os.fsdecode(os.fsencode(copied) + b"/\xff.json")).write_text("{}")
    result = run("study", "verify", copied, "--sample", "0")
    assert result.exit_code == 2 and "is not in UTF-8" in result.output


def test_a_study_that_is_too_large_is_refused(copied: Path) -> None:
    os.truncate(copied / "slide.json", (64 << 20) + 1)
    result = run("study", "verify", copied, "--sample", "0")
    assert result.exit_code == 2 and "slide.json: it has over 67,108,864 bytes" in result.output
    os.truncate(copied / "study.toml", (1 << 20) + 1)
    result = run("study", "verify", copied, "--sample", "0")
    assert result.exit_code == 2 and "study.toml: it has over 1,048,576 bytes" in result.output


def test_a_pipe_is_no_study(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "study.toml")
    result = run("study", "report", tmp_path)
    assert result.exit_code == 2 and "study.toml: it is no regular file" in result.output


def test_a_discussion_that_is_too_long_is_refused_and_not_cut(copied: Path) -> None:
    (copied / "small/discussion.md").write_text("Words. " * 150_000)
    for command in (("report",), ("verify", "--sample", "0")):
        result = run("study", command[0], copied, *command[1:])
        assert result.exit_code == 1 and "discussion.md: it has over 1,048,576 bytes" in result.output


def test_a_report_that_is_a_pipe_or_has_no_end_is_not_read(copied: Path) -> None:
    report = copied / "small/REPORT.md"
    os.truncate(report, (64 << 20) + 1)
    status, output = verify(copied, "--sample", "0")
    assert status == 1 and "REPORT.md cannot be read: it has over 67,108,864 bytes" in output
    report.unlink()
    os.mkfifo(report)
    status, output = verify(copied, "--sample", "0")
    assert status == 1 and "REPORT.md cannot be read: it is no regular file" in output


# -- kills ------------------------------------------------------------------------------------------------------------


def test_kills_and_ctrl_c_leave_what_is_done_and_do_not_show(whole: Path, tmp_path: Path) -> None:
    folder = make_study(tmp_path / "killed")

    def done() -> int:
        return len(list(folder.glob("work/*/done/*.json")))

    for number in (signal.SIGINT, signal.SIGKILL):
        before = done()
        arguments = [NMES, "study", "run", str(folder), "--jobs", "1"]
        with subprocess.Popen(arguments, stdout=-1, stderr=-1, text=True) as child:
            while done() == before and child.poll() is None:
                time.sleep(0.005)
            child.send_signal(number)
            _, told = child.communicate(timeout=60)
        assert 0 < before + 1 <= done() < 6
        if number == signal.SIGINT:
            assert child.returncode == 1
            assert told == f"stopped: {done()} of 6 runs done\ngo on with: nmes study run {folder} --budget small\n"
            assert not list(folder.glob("work/*/under-way/*"))
    kept = {path: path.stat().st_mtime_ns for path in folder.glob("work/*/done/*.json")}
    outcome = run("study", "run", folder, "--jobs", "2")
    assert outcome.exit_code == 0, outcome.output
    assert {path: path.stat().st_mtime_ns for path in kept} == kept  # not done again
    assert rows(folder) == rows(whole)
    for name in ("REPORT.md", "scores.svg"):
        text = (folder / "small" / name).read_text()
        assert text.replace("verify killed", "verify whole") == (whole / "small" / name).read_text()


def test_what_was_done_where_other_numbers_come_out_or_with_other_tasks_is_done_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = make_study(tmp_path / "moved")
    monkeypatch.setattr("nmes.study.run.fingerprint", lambda backend: {"probe": "another"})
    done: list[int] = []

    def perform(study: Study, run: PlannedRun, *others: object) -> dict[str, object]:
        done.append(run.number)
        return {"score": float(len(done)), "hash": ""}

    monkeypatch.setattr("nmes.study.run.perform", perform)
    plan = Study.load(folder).plan("small")
    assert [row["score"] for row in run_study(plan, 1, nothing).rows] == [1, 2, 3, 4, 5, 6]
    assert len(run_study(plan, 1, nothing).rows) == len(done) == 6  # what is kept is not done again
    monkeypatch.setattr("nmes.study.run.fingerprint", lambda backend: {"probe": "this one"})
    assert [row["score"] for row in run_study(plan, 1, nothing).rows] == [7, 8, 9, 10, 11, 12]
    read = ShippedDocuments.shipped
    with monkeypatch.context() as changed:
        changed.setattr(ShippedDocuments, "shipped", lambda place, name: b"{}" if name == "walk" else read(place, name))
        assert [row["score"] for row in run_study(plan, 1, nothing).rows] == [13, 14, 15, 16, 17, 18]
    assert [row["score"] for row in run_study(plan, 1, nothing).rows] == [7, 8, 9, 10, 11, 12]
    (kept, *_) = sorted(folder.glob("work/*/done/*.json"))
    for content in (b"{}", b"[]", b"{", kept.read_bytes().replace(b'"score":', b'"points":')):
        for path in folder.glob("work/*/done/000000.json"):
            path.write_bytes(content)
        with pytest.raises(StudyError, match="that run is done again"):
            run_study(plan, 1, nothing)


# -- what is measured -------------------------------------------------------------------------------------------------


def with_clocks(folder: Path, measured: str) -> Path:
    """Returns the small study with a column of times, which is said to be measured or is not."""
    make_study(folder)
    for old, new in (
        ('title = "A small study"', f'title = "A small study"\n{measured}'),
        ('hash = "score /0/genome_hash"', 'hash = "score /0/genome_hash"\nwall = "score /0/wall_seconds"'),
    ):
        edit(folder / "study.toml", old, new)
    return folder


@pytest.fixture(scope="module")
def timed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study that measures, and claims that it takes ages; run in one go."""
    folder = with_clocks(tmp_path_factory.mktemp("studies") / "timed", 'measured = ["wall"]')
    for old, new in (
        ("[values]", '[values]\nwall = { statistic = "iqm", column = "wall", arm = "still" }'),
        ("holds = 'gain > 2'", "holds = 'wall > 1000'"),
        (
            '{ statistic = "equal", column = "hash", arm = "swinging", over = "still" }',
            '{ statistic = "equal", arm = "swinging", over = "swinging" }',
        ),
    ):
        edit(folder / "study.toml", old, new)
    assert run("study", "run", folder).exit_code == 0
    return folder


def test_measured_columns_are_results_that_need_not_come_out_again(timed: Path, tmp_path: Path) -> None:
    assert all(float(str(row["wall"])) > 0 for row in rows(timed))
    status, output = verify(timed, "--all")
    assert status == 0 and "holds: 6 of 6 runs done again\n" in output
    assert "not judged: columns in which clocks have a part (wall)\n" in output
    assert (
        "Measured, so that another run comes to other numbers: `wall`." in (timed / "small" / "REPORT.md").read_text()
    )
    folder = tmp_path / "forged"
    shutil.copytree(timed, folder, ignore=shutil.ignore_patterns("work"))
    forge(folder, digest=True)  # of a column that is not measured
    assert run("study", "report", folder).exit_code == 0
    status, output = verify(folder, "--all")
    assert status == 1 and "run 0 (arm swinging, seed 1): score is " in output and "wall is " not in output


def test_what_is_measured_is_judged_anew_where_all_is_done_again(timed: Path, tmp_path: Path) -> None:
    folder = tmp_path / "slow"
    shutil.copytree(timed, folder, ignore=shutil.ignore_patterns("work"))
    plan = Study.load(folder).plan("small")
    Results.here(plan, [{**row, "wall": 2000.0} for row in rows(folder)]).write(plan)
    assert run("study", "report", folder).exit_code == 0
    assert verify(folder, "--sample", "1")[0] == 0
    status, output = verify(folder, "--all")
    assert status == 3
    assert "claim open: undecided at this budget here, where the results say holds\n" in output


def test_what_two_arms_have_alike_leaves_measured_columns_out(timed: Path) -> None:
    document = Study.load(timed)
    plan = document.plan("small")
    assert evaluate(plan, Results.read(plan))["alike"].value == 1.0
    document.document["measured"] = []
    found = [dict(row) for row in Results.read(plan).rows]
    found[0]["wall"] = None  # of which even a row is not the same as itself
    assert evaluate(plan, Results.here(plan, found))["alike"].value < 1.0


def test_a_column_of_clocks_that_is_not_said_to_be_measured_is_found(tmp_path: Path) -> None:
    folder = with_clocks(tmp_path / "timed", "measured = []")
    assert run("study", "run", folder).exit_code == 0
    status, output = verify(folder, "--all")
    assert status == 1 and "(arm swinging, seed 1): wall is " in output


@pytest.mark.parametrize(("measured", "most"), [('measured = ["wall"]', 1), ("measured = []", 2)])
def test_runs_of_a_study_that_measures_are_done_one_at_a_time(
    measured: str, most: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lock, under_way, seen = threading.Lock(), 0, 0

    def perform(*arguments: object) -> dict[str, object]:
        nonlocal under_way, seen
        with lock:
            under_way += 1
            seen = max(seen, under_way)
        time.sleep(0.2)
        with lock:
            under_way -= 1
        return {"score": 1.0, "hash": "", "wall": 1.0}

    monkeypatch.setattr("nmes.study.run.perform", perform)
    plan = Study.load(with_clocks(tmp_path / "timed", measured)).plan("small")
    assert len(run_study(plan, 2, nothing).rows) == 6
    assert seen == most


# -- what a run may need ----------------------------------------------------------------------------------------------


def test_commands_see_what_runs_beside_them_and_what_was_printed_before(tmp_path: Path) -> None:
    folder = tmp_path / "beside"
    folder.mkdir()
    head = STUDY[: STUDY.index("[settings]")]
    for old, new in (('low("gain") > 0.5', "same == 1"), ('high("gain") < 0.5', "same < 1"), ("gain >", "same >")):
        head = head.replace(old, new)
    (folder / "study.toml").write_text(
        head.replace("gain <", "same <")
        + """
[commands]
worlds = "nmes worlds {host.host}:{host.port} --password {host.password} --json"
again = "nmes worlds {host.host}:{worlds/0/port} --password {host.password} --world {worlds/0/world} --json"
failing = "nmes genome diff walker {words} --json"

[columns]
world = "again /0/world"
port = "worlds /world=green/port"
status = "failing status"

[[arms]]
name = "hosted"
about = "Beside a host."
measured = true
settings = { words = ["roller"] }
beside = { host = "nmes serve --backend ballistic --worlds red,green --port 0 --no-record --json" }

[values]
same = { statistic = "equal", column = "world", arm = "hosted", over = "hosted" }
status = { statistic = "max", column = "status", arm = "hosted" }

[budgets.small]
seeds = [1, 2, 3]
minutes = 0.1
"""
    )
    result = run("study", "run", folder, "--jobs", "2")
    assert result.exit_code == 0, result.output
    assert [(row["world"], row["status"], row["measured"]) for row in rows(folder)] == [("red", 1.0, True)] * 3
    assert all(isinstance(row["port"], float) for row in rows(folder))
    edit(folder / "study.toml", "/world=green/port", "/world=blue/port")
    result = run("study", "run", folder)
    assert result.exit_code == 1 and "printed nothing at /world=blue/port" in result.output
    edit(folder / "study.toml", "/world=blue/port", "/world=green/port")
    status, output = verify(folder)
    assert status == 0 and "holds: 0 of 3 runs done again\nnot judged: 3 runs in which clocks have a part\n" in output
    status, output = verify(folder, "--all")
    assert status == 0 and "holds: 3 of 3 runs done again\nnot judged: 3 runs in which clocks have a part\n" in output


def test_a_command_that_fails_is_told_with_what_it_said(tmp_path: Path) -> None:
    folder = make_study(tmp_path / "failing")
    edit(folder / "study.toml", '{ genome = "still" }', '{ genome = "nobody" }')
    result = run("study", "run", folder, "--jobs", "1")
    assert result.exit_code == 1
    assert "run 3 (arm still, seed 1): nmes eval " in result.output and "ended with status " in result.output
    assert "nobody.json" in result.output


def test_an_arm_may_be_run_in_some_cells_alone_and_is_compared_where_both_are(tmp_path: Path) -> None:
    folder = make_study(tmp_path / "fewer")
    edit(folder / "study.toml", "[settings]", "[factors]\nsize = [1, 2]\n\n[settings]")
    edit(folder / "study.toml", '{ genome = "still" }', '{ genome = "still" }\nfactors = { size = [2] }')
    result = run("study", "run", folder)
    told = "arms swinging and still have not the same cells with budget small: say `where` both have"
    assert result.exit_code == 2 and f"values/gain: {told}" in result.output and "values/alike" in result.output
    text = (folder / "study.toml").read_text().replace('over = "still" }', 'over = "still", where = { size = 2 } }')
    (folder / "study.toml").write_text(text)
    runs = Study.load(folder).plan("small").runs
    cells = [("swinging", {"size": 1}), ("swinging", {"size": 2}), ("still", {"size": 2})]
    assert [(each.arm["name"], each.cell, each.seed) for each in runs] == [
        (*cell, seed) for cell in cells for seed in (1, 2, 3)
    ]
    assert [each.number for each in runs] == list(range(9))
    (folder / "study.toml").write_text(text.replace("size = [2]", "size = [3]"))
    refused = run("study", "run", folder).output
    assert "arms/1/factors/size: there is no value 3" in refused
    (folder / "study.toml").write_text(text.replace('unit = "m"', 'unit = "m"\nwhere = { size = 3 }'))
    assert "figures/0/where/size: there is no value 3" in run("study", "run", folder).output
    assert "budgets/small: arm still has no runs" in refused


def test_zeros_of_both_signs_are_one_number(timed: Path) -> None:
    document = Study.load(timed)
    plan = document.plan("small")
    for statistic in ("min", "max", "median", "iqm", "mean"):
        document.document["values"][statistic] = {"statistic": statistic, "column": "score", "arm": "swinging"}
        for zeros in ((-0.0, 0.0, -0.0), (0.0, -0.0, -0.0), (-0.0, -0.0, -0.0)):
            scores = iter(zeros * 2)
            found = evaluate(plan, Results.here(plan, [{**row, "score": next(scores)} for row in rows(timed)]))
            assert repr(found[statistic].value) == repr(found[statistic].low) == "0.0"
