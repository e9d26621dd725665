"""Corpora: what is added, that one holds, and that whatever is wrong in one is found."""

from __future__ import annotations

import fcntl
import gc
import json
import os
import re
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import zstandard

import corpus as tool
from command_line import run
from disks import full_disk
from modelled import modelled
from nmes.errors import MachineError, MissingPackage, NmesError
from nmes.evaluation.identity import creature_hash
from nmes.evaluation.task import Task
from nmes.evolution.corpus import Corpus, mean_score
from nmes.evolution.corpus_add import add_runs
from nmes.evolution.corpus_verify import Work, run_episodes, verify_corpus
from nmes.evolution.run import Run
from nmes.genome import Genome
from nmes.playback import replay
from nmes.recording import Recording
from nmes.schemas import load
from nmes.world import World
from processes import NMES
from runs import begin, finish, forge

Rows = list[dict[str, Any]]


def packed(rows: Rows, path: Path) -> Path:
    """Writes rows as a corpus, whatever they say."""
    text = "".join(json.dumps(row, separators=(",", ":")) + "\n" for row in rows)
    path.write_bytes(zstandard.ZstdCompressor().compress(text.encode()))
    return path


def rows_of(path: Path) -> Rows:
    return [json.loads(line) for line in zstandard.ZstdDecompressor().decompress(path.read_bytes()).splitlines()]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of evolution on a task whose episodes are short."""
    target = tmp_path_factory.mktemp("runs") / "run"
    finish(begin(target, task="jump-far", starts=["leaper", "jumper"], budget=60))
    return target


@pytest.fixture(scope="module")
def small(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A corpus of three creatures of that run."""
    path = tmp_path_factory.mktemp("corpus") / "small.jsonl.zst"
    result = run("corpus", "add", str(path), str(folder), "--best", "3", "--jobs", "1")
    assert result.exit_code == 0, result.output
    assert result.output == f"{path}: 3 new, 3 creatures in all\n"
    return path


def verify(path: Path, *options: str) -> tuple[int, dict[str, Any]]:
    result = run("corpus", "verify", str(path), "--all", "--jobs", "1", "--json", *options)
    return result.exit_code, json.loads(result.output)


# -- the corpus of the repository --------------------------------------------------------------------------------------


def test_the_corpus_of_the_repository_holds_in_a_drawn_sample() -> None:
    result = run("corpus", "verify", str(tool.CORPUS), "--sample", "2", "--jobs", "1", "--json")
    found = json.loads(result.output)
    assert result.exit_code == 0, found["findings"]
    assert found["verdict"] == "holds" and found["again"] == 12 and found["episodes"] >= 36  # there are ten tasks


@pytest.mark.long
def test_the_corpus_of_the_repository_holds() -> None:
    result = run("corpus", "verify", str(tool.CORPUS), "--all", "--json")
    found = json.loads(result.output)
    assert result.exit_code == 0, found["findings"]
    assert found["again"] == found["creatures"]


def test_it_has_a_thousand_creatures_of_ten_tasks_in_ten_megabytes() -> None:
    corpus = Corpus.read(tool.CORPUS)
    assert len(corpus.creatures) >= 1000
    counts = {known.task.name: 0 for known in corpus.tasks.values()}
    for each in corpus.creatures:
        counts[corpus.tasks[each.task].task.name] += 1
    assert len(counts) == 10 and min(counts.values()) >= 20, counts
    assert tool.CORPUS.stat().st_size < 10_000_000


def test_it_is_of_the_runs_that_the_tool_makes() -> None:
    corpus = Corpus.read(tool.CORPUS)
    made = [(known.settings["task"], known.settings["seed"], known.settings["budget"]) for known in corpus.runs]
    asked = [(option(words, "--task"), int(option(words, "--seed")), int(option(words, "--budget")))
             for words in tool.RUNS.values()]  # fmt: skip
    assert made == asked


def option(words: tuple[str, ...], name: str) -> str:
    return words[words.index(name) + 1]


def test_the_gallery_is_that_of_the_corpus(tmp_path: Path) -> None:
    page = tmp_path / "gallery.html"
    assert run("corpus", "page", str(tool.CORPUS), "-o", str(page)).exit_code == 0
    pictures = r'src="data:image/png;base64,[^"]+"'  # whose bytes depend on a library; whose they are, the name says
    written, made = (re.subn(pictures, "", path.read_text("utf-8")) for path in (tool.GALLERY, page))
    assert written == made, "out of date: .venv/bin/python tools/corpus.py --gallery"
    assert made[1] == 100 and tool.GALLERY.stat().st_size < 1_000_000


def test_the_page_of_the_corpus_tells_its_size() -> None:
    corpus = Corpus.read(tool.CORPUS)
    text = (tool.ROOT / "docs" / "corpus.md").read_text("utf-8")
    assert f"has {len(corpus.creatures):,} creatures" in text
    assert f"{len(corpus.creatures):,} creatures of {len(corpus.runs)} runs" in text


# -- what is added -----------------------------------------------------------------------------------------------------


def test_the_same_runs_give_the_same_bytes_and_twice_is_once(small: Path, folder: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.jsonl.zst"
    for _ in range(2):
        assert run("corpus", "add", str(again), str(folder), "--best", "3", "--jobs", "2").exit_code == 0
        assert again.read_bytes() == small.read_bytes()


def test_what_is_added_was_varied_and_scores(small: Path, folder: Path) -> None:
    evolution, creatures = Run.open(folder), Corpus.read(small).creatures
    assert len({each.creature for each in creatures}) == 3
    for each in creatures:
        record = evolution.records[each.candidate]
        assert record.parents and each.generation >= 1 and each.score == record.score and each.score > 0
        assert each.operator == record.operator and each.genome_hash == record.genome_hash
    best = max(record.score or 0.0 for record in evolution.records if record.parents)
    assert max(each.score for each in creatures) == best


def test_a_run_without_evolved_creatures_is_refused(tmp_path: Path) -> None:
    finish(begin(tmp_path / "run", algorithm="random", options={}, budget=2))
    result = run("corpus", "add", str(tmp_path / "new.zst"), str(tmp_path / "run"), "--jobs", "1")
    assert result.exit_code == 1 and "no candidate with a score above 0 that was varied" in result.output
    assert not (tmp_path / "new.zst").exists()


def test_two_processes_do_not_add_at_once(small: Path, folder: Path, tmp_path: Path) -> None:
    (path := tmp_path / "mine.zst").write_bytes(small.read_bytes())
    held = os.open(tmp_path, os.O_RDONLY)
    try:
        fcntl.flock(held, fcntl.LOCK_EX)
        result = run("corpus", "add", str(path), str(folder), "--jobs", "1")
    finally:
        os.close(held)
    assert result.exit_code == 1 and "another process adds to a corpus in this folder" in result.output
    assert path.read_bytes() == small.read_bytes()


# -- what is shown and taken out ---------------------------------------------------------------------------------------


def test_creatures_are_shown_and_exported(small: Path, tmp_path: Path) -> None:
    corpus = Corpus.read(small)
    best = corpus.creatures[0]
    name, output = corpus.name_of(best), tmp_path / "best.json"
    lines = run("corpus", "show", str(small), "--task", "jump-far", "--top", "1").output.splitlines()
    assert lines[1].split()[0] == name and lines[2] == "1 of 3 creatures of 1 runs"
    (told,) = json.loads(run("corpus", "show", str(small), "--top", "1", "--json").output)
    assert told["name"] == name and told["run"]["algorithm"] == "ga" and told["run"]["starts"] == ["leaper", "jumper"]
    assert run("corpus", "export", name[:-4], str(small), "-o", str(output)).exit_code == 0
    assert json.loads(output.read_text()) == best.genome
    evaluated = json.loads(run("eval", str(output), "--task", "jump-far", "--json").output)
    assert evaluated[0]["score"] == best.score and evaluated[0]["genome_hash"] == best.genome_hash
    result = run("corpus", "export", "jump-far", str(small), "-o", str(output))
    assert result.exit_code == 1 and "3 creatures have names that begin so" in result.output
    assert run("corpus", "export", "walk-0", str(small), "-o", str(output)).exit_code == 1


def test_recordings_are_made_again_and_end_with_the_digests(small: Path, tmp_path: Path) -> None:
    code, found = verify(small, "--record", str(tmp_path))
    assert (code, found["verdict"], found["episodes"]) == (0, "holds", 9)
    recordings = sorted(tmp_path.glob("*.mcap"))
    assert len(recordings) == 9
    ends = {digest_at_the_end(path) for path in recordings}
    assert len(ends) == 9 and ends == {
        episode.digest for each in Corpus.read(small).creatures for episode in each.episodes
    }
    assert run("eval", "--from-recording", str(recordings[0])).exit_code == 0


def digest_at_the_end(path: Path) -> str:
    """Returns the digest of a recording's world after its last input, all of which come out as recorded."""
    digests = [""]

    def note(world: World, _: object) -> None:
        digests[0] = world.digest().hex()

    assert replay(Recording(path), watch=note).verdict == "reproduced"
    return digests[0]


# -- what is wrong is found --------------------------------------------------------------------------------------------


def score(rows: Rows) -> None:
    rows[1]["score"] += 1e-9


def episode_score(rows: Rows) -> None:
    for row in rows[1:2]:
        for episode in row["episodes"]:
            episode["score"] += 1.0
        row["score"] = sum(episode["score"] for episode in row["episodes"]) / 3


def energy(rows: Rows) -> None:
    rows[2]["episodes"][1]["energy"] *= 1.0000001


def digest(rows: Rows) -> None:
    rows[3]["episodes"][2]["digest"] = "0" * 32


def genome(rows: Rows) -> None:
    rows[1]["genome"]["description"] = "another"


def body(rows: Rows) -> None:
    rows[1]["genome"]["body"]["graph"]["parts"][0]["density"] *= 1.1


def no_genome(rows: Rows) -> None:
    rows[1]["genome"] = {"name": "none"}


def task_hash(rows: Rows) -> None:
    rows[1]["task"] = "0" * 64


def head_hash(rows: Rows) -> None:
    for row in (*rows[0]["tasks"], *rows[1:]):
        row["hash" if "hash" in row else "task"] = "f" * 64


def easier_task(rows: Rows) -> None:
    rows[0]["tasks"][0]["task"]["objective"] = "100"


def twice(rows: Rows) -> None:
    rows.insert(2, rows[1])


def order(rows: Rows) -> None:
    rows[1], rows[3] = rows[3], rows[1]


def seeds(rows: Rows) -> None:
    rows[1]["episodes"] = rows[1]["episodes"][:1] * 3


def no_run(rows: Rows) -> None:
    rows[1]["run"] = 7


def no_candidate(rows: Rows) -> None:
    rows[1]["candidate"] = 60


@pytest.mark.parametrize(
    ("defect", "words"),
    [
        (score, "score is "),
        (episode_score, "seed 1: score is "),
        (energy, "seed 2: energy is "),
        (digest, "seed 3: digest is '0000"),
        (genome, "genome_hash is "),
        (body, "creature is "),
        (no_genome, "body: is missing"),
        (task_hash, "the corpus has no task with the hash 0000"),
        (head_hash, "the task jump-far has the hash "),
        (easier_task, "the task jump-far has the hash "),
        (twice, "the creature is there twice"),
        (order, "the creatures are not in order"),
        (seeds, "not one for each of the task's seeds"),
        (no_run, "the corpus has no run 7"),
        (no_candidate, "its run has no candidate 60"),
    ],
)
def test_what_is_not_true_is_found(defect: Callable[[Rows], None], words: str, small: Path, tmp_path: Path) -> None:
    rows = rows_of(small)
    defect(rows)
    code, found = verify(packed(rows, tmp_path / "changed.zst"))
    assert (code, found["verdict"]) == (1, "broken")
    assert any(re.search(words, each["reason"]) and each["verdict"] == "broken" for each in found["findings"])


def test_the_best_is_among_those_that_are_run_again_and_the_others_are_drawn_each_time(
    small: Path, tmp_path: Path
) -> None:
    rows = rows_of(small)
    episode_score(rows)
    sampled = ("corpus", "verify", "--sample", "0", "--jobs", "1", str(packed(rows, tmp_path / "forged.zst")))
    result = run(*sampled)
    assert result.exit_code == 1 and "broken: 1 of 3 creatures run again" in result.output
    one, other = (run("corpus", "verify", str(small), "--sample", "1", "--jobs", "1", "--json") for _ in range(2))
    told, again = json.loads(one.output), json.loads(other.output)
    assert told["again"] == 2 and told["seed"] != again["seed"]
    result = run("corpus", "verify", str(small), "--sample", "1", "--jobs", "1", "--seed", str(told["seed"]))
    assert f"2 of 3 creatures run again, in 6 episodes, drawn by --seed {told['seed']}\n" in result.output


def test_which_creatures_are_run_again_follows_from_the_seed(monkeypatch: pytest.MonkeyPatch) -> None:
    chosen: list[list[Any]] = []

    def nothing(_: Any, work: list[Any], __: int) -> list[Any]:
        chosen.append([each.genome["name"] for each in work])
        return []

    monkeypatch.setattr("nmes.evolution.corpus_verify.in_processes", nothing)
    monkeypatch.setattr(
        "nmes.evolution.corpus_verify._Verification.judge_lines", lambda self, _: self._corpus.creatures
    )
    corpus = Corpus.read(tool.CORPUS)
    for seed in (1, 2, 1, None, None):
        assert verify_corpus(corpus, sample=5, seed=seed).again == 15
    assert chosen[0] == chosen[2] and len({*map(tuple, chosen)}) == 4


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_a_full_disk_of_who_verifies_is_not_the_creatures_fault(jobs: str, small: Path, tmp_path: Path) -> None:
    arguments = [NMES, "corpus", "verify", str(small), "--all", "--record", str(tmp_path), "--jobs", jobs, "-q"]
    with full_disk(4096), subprocess.Popen(arguments, stdout=-1, text=True) as child:
        output = child.communicate(timeout=200)[0]
    assert child.returncode == 3, output
    assert output.count("could not be judged here: jump-far-") == 3 and "File too large" in output


def test_a_creature_that_cannot_take_part_is_broken_in_other_processes_too(small: Path, tmp_path: Path) -> None:
    rows = rows_of(small)
    task = rows[0]["tasks"][0]
    task["task"]["limits"] = {**task["task"].get("limits", {}), "cubes": 1}
    task["hash"] = Task(task["task"]).hash
    for row in rows[1:]:
        row["task"] = task["hash"]
    path = packed(rows, tmp_path / "narrow.zst")
    found = json.loads(run("corpus", "verify", str(path), "--all", "--jobs", "2", "--json").output)
    assert found["verdict"] == "broken" and sum("cubes" in each["reason"] for each in found["findings"]) == 3


def test_what_a_model_rounds_otherwise_is_not_judged(small: Path, tmp_path: Path) -> None:
    rows = rows_of(small)
    genome = Genome(modelled())
    episodes = run_episodes(Work(genome.document, rows[0]["tasks"][0]["task"]))
    assert not isinstance(episodes, NmesError)
    told = [episode.to_json() for episode in episodes]
    hashes = {"genome": genome.document, "genome_hash": genome.hash, "creature": creature_hash(genome)}
    row = {**rows[1], **hashes, "episodes": told, "score": mean_score(episodes)}
    path = packed([rows[0], row], tmp_path / "model.zst")
    assert verify(path)[1]["verdict"] == "holds"
    told[0]["energy"] += 1.0
    code, found = verify(packed([rows[0], row], path))
    assert (code, found["verdict"]) == (3, "not_judged")
    assert found["findings"][0]["reason"].endswith(
        "it has an ONNX brain, which may round otherwise on another processor"
    )


def test_what_was_computed_elsewhere_is_not_judged(small: Path, tmp_path: Path) -> None:
    rows = rows_of(small)
    rows[0]["tasks"][0]["fingerprint"]["probe"] = "another"
    path = packed(rows, tmp_path / "elsewhere.zst")
    assert verify(path)[0] == 0  # it holds all the same
    digest(rows)
    code, found = verify(packed(rows, path))
    assert (code, found["verdict"]) == (3, "not_judged")
    assert "computed with another probe" in found["findings"][0]["reason"]


def test_a_corpus_of_elsewhere_is_not_added_to(small: Path, folder: Path, tmp_path: Path) -> None:
    rows = rows_of(small)
    rows[0]["tasks"][0]["fingerprint"]["probe"] = "another"
    rows[0]["runs"][0]["digest"] = "0" * 32
    path = packed(rows, tmp_path / "elsewhere.zst")
    before = path.read_bytes()
    result = run("corpus", "add", str(path), str(folder), "--jobs", "1")
    assert "begin a new corpus" in result.output and result.exit_code == 3 and path.read_bytes() == before


def test_a_run_that_comes_out_otherwise_is_only_comparable_where_it_was_begun(tmp_path: Path) -> None:
    def lower_energy(records: Rows) -> None:
        for record in records:
            record["results"][0].update(energy=0.0)

    finish(begin(other := tmp_path / "run"))
    forge(other, lower_energy)
    refused = run("corpus", "add", str(tmp_path / "new.zst"), str(other), "--jobs", "1", "--best", "1")
    assert refused.exit_code == 1 and "its log has" in refused.output and "other numbers" not in refused.output
    document = json.loads((other / "run.json").read_bytes())
    document["fingerprint"]["probe"] = "of another machine"
    (other / "run.json").write_text(json.dumps(document))
    refused = run("corpus", "add", str(tmp_path / "new.zst"), str(other), "--jobs", "1", "--best", "1")
    assert refused.exit_code == 3 and "the run was begun where other numbers come out" in refused.output


def test_what_the_machine_lacks_is_no_divergence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def lacking(*_: object) -> None:
        raise MissingPackage("the package onnxruntime is not installed")

    finish(begin(folder := tmp_path / "run"))
    monkeypatch.setattr("nmes.evolution.corpus_verify.admit", lacking)
    with pytest.raises(MachineError, match=r"candidate \d+: the package onnxruntime is not"):
        add_runs(Corpus({}, (), ()), [folder], best=1)


def test_a_corpus_without_creatures_holds(small: Path, tmp_path: Path) -> None:
    assert verify(packed(rows_of(small)[:1], tmp_path / "none.zst"))[0] == 0


# -- what is no corpus -------------------------------------------------------------------------------------------------


def bomb() -> bytes:
    """A small file that holds more than is read."""
    return zstandard.ZstdCompressor().compress(b"\n" * ((256 << 20) + 1))


def unsized() -> bytes:
    """A frame that does not say how much it holds."""
    return zstandard.ZstdCompressor(write_content_size=False).compress(b"{}\n")


def packed_text(text: str) -> bytes:
    return zstandard.ZstdCompressor().compress(text.encode())


HEAD = '{"format":"nmes-corpus/1","tasks":[],"runs":[]}\n'


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "it cannot be unpacked"),
        (b"no zstd", "it cannot be unpacked"),
        (packed_text(HEAD)[:-3], "it cannot be unpacked"),
        (packed_text(HEAD) + b"more", "it cannot be unpacked"),
        (bomb(), "it says that it holds 268,435,457 bytes"),
        (packed_text(HEAD + "{}\n" * 3_000_000), "9,000,048 unpacked: such files are not read"),
        (packed_text(f'{{"format":"{"x" * (16 << 20)}"}}\n'), "unpacked: such files are not read"),
        (unsized(), "it says that it holds"),
        (packed_text(HEAD[:-1]), "its last line is cut"),
        (packed_text("[" * 100_000 + "\n"), "line 1"),
        (packed_text('{"format":"nmes-corpus/2","tasks":[],"runs":[]}\n'), "line 1: format: expected"),
        (packed_text(HEAD + "{}\n"), "line 2: task: is missing"),
        (packed_text(HEAD + "\n" * 100_001), "it has over 100,000 creatures"),
        (packed_text(HEAD.replace('"tasks":[]', '"tasks":[{"task":{},"hash":"' + "0" * 64 + '","fingerprint":{}}]')),
         "line 1"),
        (packed_text(HEAD.replace('"runs":[]', '"runs":[{"settings":{"budget":"x"},"digest":"' + "0" * 32 + '"}]')),
         "line 1"),
    ],
)  # fmt: skip
def test_what_is_no_corpus_is_wrong_usage(content: bytes, words: str, tmp_path: Path) -> None:
    path = tmp_path / "hostile.zst"
    path.write_bytes(content)
    for command in (["verify", str(path)], ["show", str(path)], ["page", str(path), "-o", str(tmp_path / "x.html")]):
        result = run("corpus", *command)
        assert result.exit_code == 2 and words in result.output and "Traceback" not in result.output, result.output
    assert [*tmp_path.iterdir()] == [path]


def test_genomes_of_a_corpus_wait_as_text(tmp_path: Path) -> None:
    row = {**load("corpus_creature.json")["examples"][0], "genome": {"name": "much", "x": [[] for _ in range(60_000)]}}
    path = packed([json.loads(HEAD), *[row] * 5], tmp_path / "hostile.zst")
    gc.collect()
    before = len(gc.get_objects())
    creatures = Corpus.read(path).creatures
    assert len(gc.get_objects()) - before < 60_000
    assert [each.name for each in creatures] == ["much"] * 5


def test_names_of_strangers_are_text_on_the_page_and_in_the_table(small: Path, tmp_path: Path) -> None:
    rows = rows_of(small)
    for row in rows[1:]:
        row["genome"]["name"] = "<script>x</script>"
    path, page = packed(rows, tmp_path / "strange.zst"), tmp_path / "page.html"
    assert run("corpus", "page", str(path), "-o", str(page)).exit_code == 0
    assert "<script>" not in page.read_text() and "&lt;script&gt;" in page.read_text()
    for row in rows[1:]:
        row["genome"]["name"] = "\x1b[2J"  # which makes it no genome: it is shown all the same
    shown = run("corpus", "show", str(packed(rows, path)))
    assert shown.exit_code == 0 and "\\x1b[2J" in shown.output and "\x1b" not in shown.output
    assert run("corpus", "page", str(path), "-o", str(page)).exit_code == 1
