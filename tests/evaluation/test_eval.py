"""`nmes eval`: tables, files, processes, interruptions."""

from __future__ import annotations

import csv
import io
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from click.testing import CliRunner, Result
from PIL import Image
from test_evaluation import DASH

from creatures import cpg, exploding, mlp, snake
from nmes.cli import main
from nmes.evaluation import Evaluation, Evaluator, Job, scores_so_far
from nmes.evaluation import Result as EpisodeResult
from nmes.evaluation.judge import Judge
from nmes.genome import Genome
from nmes.recording import Recording
from nmes.world import World
from recordings import record, send

NMES = str(Path(sys.executable).parent / "nmes")
PATIENCE = 60


def run(*arguments: str | Path | int) -> Result:
    return CliRunner().invoke(main, ["eval", *map(str, arguments)])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a task and, in `zoo`, three creatures and something that is none."""
    (tmp_path / "dash.json").write_text(json.dumps(DASH))
    zoo = tmp_path / "zoo"
    zoo.mkdir()
    for name, brain in {"a-wave": None, "b-cpg": cpg(4), "c-net": mlp(4)}.items():
        (zoo / f"{name}.json").write_text(json.dumps(snake(brain, name=name) if brain else snake(name=name)))
    (zoo / "d-ill.json").write_text(json.dumps(snake(name="ill", body={"cubes": []})))
    return tmp_path


def timeless(evaluations: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [
        {key: value for key, value in each.items() if key not in ("wall_seconds", "recordings")} for each in evaluations
    ]


def test_results_do_not_depend_on_processes_order_or_recording(folder: Path) -> None:
    task = ("--task", folder / "dash.json", "--json")
    whole = run(folder / "zoo", *task, "--jobs", 2)
    assert whole.exit_code == 1  # of the one that is ill
    evaluations = json.loads(whole.stdout)
    assert [each["genome"] for each in evaluations] == ["a-wave", "b-cpg", "c-net", "d-ill"]
    assert "cubes" in evaluations[3]["error"] and evaluations[3]["score"] is None
    alone = run(folder / "zoo" / "c-net.json", folder / "zoo" / "b*.json", *task, "--jobs", 1, "--record", folder / "r")
    assert alone.exit_code == 0
    assert timeless(json.loads(alone.stdout)) == timeless([evaluations[2], evaluations[1]])
    # In a fresh process, from nothing but the recordings.
    recordings = [path for each in json.loads(alone.stdout) for path in each["recordings"]]
    command = [NMES, "eval", "--json", "--from-recording", *reversed(recordings)]
    again = subprocess.run(command, capture_output=True, timeout=PATIENCE)
    assert again.returncode == 0, again.stderr
    assert timeless(json.loads(again.stdout)) == timeless([evaluations[1], evaluations[2]])


def test_results_are_printed_as_a_table_and_written_as_csv(folder: Path) -> None:
    (folder / "bang.json").write_text(json.dumps(exploding()))
    table = run(
        folder / "bang.json",
        folder / "zoo" / "a-wave.json",
        folder / "zoo" / "d-ill.json",
        "--task",
        folder / "dash.json",
        "--seeds",
        4,
        "--jobs",
        1,
    )
    assert table.exit_code == 1
    assert "a-wave" in table.stdout and "dash" in table.stdout and "d-ill: body/cubes" in table.stdout
    assert "bang, seed 4, tick" in table.stdout and "diverged: the engine diverged" in table.stdout
    rows = run(folder / "zoo" / "a-wave.json", "--task", folder / "dash.json", "--csv", "--seeds", "4,7-9", "--jobs", 1)
    (row,) = csv.DictReader(io.StringIO(rows.stdout))
    assert row["genome"] == "a-wave" and float(row["score"]) > -1.0 and row["faults"] == "0"


def test_a_table_fits_80_columns_and_tells_namesakes_apart(folder: Path) -> None:
    for i in range(2):
        (folder / f"{i}.json").write_text(json.dumps(snake(name="sidewinder", author=f"author {i}")))
    table = run(folder / "0.json", folder / "1.json", "--task", "walk", "--seeds", "4-6,9", "--jobs", 1).stdout
    lines = [line.split() for line in table.splitlines()]
    rows = [place for place, words in enumerate(lines) if words[:1] == ["sidewinder"]]
    assert [lines[row][1:3] for row in rows] == [["walk", "4-6,9"]] * 2 and all(len(lines[row]) == 9 for row in rows)
    hashes = [lines[row + 1] for row in rows]
    assert hashes == [[Genome.load(folder / f"{i}.json").hash[:16]] for i in range(2)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "name a genome"),
        (["nobody"], "there is no file nobody"),
        (["x.json", "--seeds", "1,x"], "no list of seeds"),
        (["x.json", "--seeds", "1,1"], "each once"),
        (["x.json", "--seeds", str(2**63)], "a seed is at most 9223372036854775807"),
        (["x.json", "--json", "--csv"], "either --json or --csv"),
        (["x.json", "--jobs", "2", "--ray", "auto"], "either --jobs or --ray"),
        (["--task", "walk", "--from-recording", __file__], "only --json, --csv and --plot go with it"),
        (["--seeds", "1", "--from-recording", __file__], "only --json, --csv and --plot go with it"),
        ([str(Path(__file__).parent)], "no .json file"),
    ],
)
def test_wrong_usage_is_explained(arguments: list[str], message: str) -> None:
    result = run(*arguments)
    assert result.exit_code == 2 and message in result.stderr


def test_the_largest_seed_is_one(folder: Path) -> None:
    genome, task, lines = folder / "zoo" / "a-wave.json", folder / "dash.json", folder / "lines"
    result = run(genome, "--task", task, "--seeds", 2**63 - 1, "--resume", lines, "--jobs", 1, "--json")
    assert result.exit_code == 0 and json.loads(result.stdout)[0]["results"][0]["seed"] == 2**63 - 1
    before = lines.read_bytes()
    assert run(genome, "--task", task, "--seeds", 2**63, "--resume", lines, "--jobs", 1).exit_code == 2
    assert lines.read_bytes() == before


def test_an_invalid_task_or_recording_is_an_error(folder: Path) -> None:
    result = run(folder / "zoo", "--task", "wlak")
    assert result.exit_code == 2 and "did you mean walk?" in result.stderr
    result = run("--from-recording", folder / "dash.json")
    assert result.exit_code == 1 and "dash.json" in result.stderr


def test_ctrl_c_keeps_finished_results_and_the_same_command_resumes(folder: Path) -> None:
    many = folder / "many"
    many.mkdir()
    for i in range(200):  # more than are done before anybody can press a key
        (many / f"{i:03}.json").write_text(json.dumps(snake(mlp(4, seed=i), name=f"n{i}")))
    results = folder / "kept.jsonl"
    command = [NMES, "eval", str(many), "--task", str(folder / "dash.json"), "--jobs", "2", "--json"]
    with subprocess.Popen(
        [*command, "--resume", str(results)], stderr=subprocess.PIPE, stdout=subprocess.PIPE
    ) as running:
        deadline = time.monotonic() + PATIENCE
        while not (results.exists() and results.read_bytes().count(b"\n") >= 3):
            assert time.monotonic() < deadline and running.poll() is None
            time.sleep(0.01)
        running.send_signal(signal.SIGINT)
        stdout, stderr = running.communicate(timeout=PATIENCE)
    done = results.read_bytes().count(b"\n")
    assert running.returncode == 1 and 3 <= done < 200
    assert b"of 200 done" in stderr and b"the same command goes on" in stderr and b"Traceback" not in stderr
    assert len(json.loads(stdout)) == done
    with results.open("ab") as file:  # as a run that was killed in the midst of a line leaves it
        file.write(b'{"key":"')
    name = json.loads(results.read_bytes().splitlines()[0])["genome"]
    one_done = many / f"{int(name[1:]):03}.json"
    some = (one_done, many / "199.json", "--task", folder / "dash.json", "--json", "--jobs", 1)
    rest = run(*some, "--resume", results)
    assert rest.exit_code == 0 and results.read_bytes().count(b"\n") == done + 1
    assert timeless(json.loads(rest.stdout)) == timeless(json.loads(run(*some).stdout))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_leaves_a_file_to_resume_from_if_none_is_named(folder: Path, number: signal.Signals) -> None:
    for i in range(200):  # as above
        (folder / "zoo" / f"x{i:03}.json").write_text(json.dumps(snake(mlp(4, seed=i))))
    command = [NMES, "eval", str(folder / "zoo"), "--task", str(folder / "dash.json"), "--jobs", "1", "--record", "r"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, cwd=folder) as running:
        deadline = time.monotonic() + PATIENCE
        while not (folder / "r").is_dir() or len(list((folder / "r").glob("*.mcap"))) < 4:
            assert time.monotonic() < deadline and running.poll() is None
            time.sleep(0.01)
        running.send_signal(number)
        stdout, stderr = running.communicate(timeout=PATIENCE)
    assert running.returncode == 1, stderr
    files = list(folder.glob("eval-*.jsonl"))
    assert len(files) == 1, stderr
    (file,) = files
    assert f"--resume {file.name}" in stderr.decode() and b"a-wave" in stdout
    assert len(file.read_bytes().splitlines()) >= 1
    # What has the name of a recording is one.
    assert all(path.stat().st_size > 10_000 for path in (folder / "r").glob("*.mcap"))


@pytest.mark.long
def test_a_ray_cluster_gives_the_same_results(folder: Path) -> None:
    pytest.importorskip("ray")
    command = [NMES, "eval", str(folder / "zoo"), "--task", str(folder / "dash.json"), "--json"]
    quiet = {**os.environ, "RAY_AUTH_MODE": "disabled", "RAY_USAGE_STATS_ENABLED": "0"}
    cluster, here = (
        subprocess.run([*command, *more], capture_output=True, timeout=300, env=quiet)
        for more in (("--ray", "local"), ("--jobs", "1"))
    )
    assert cluster.returncode == here.returncode == 1, cluster.stderr
    assert timeless(json.loads(cluster.stdout)) == timeless(json.loads(here.stdout))


SVG = "{http://www.w3.org/2000/svg}"


def drawn(path: Path, title: str) -> list[list[tuple[float, float]]]:
    """The curves of a panel of a plot, as points of the picture."""
    curves: dict[str, list[list[tuple[float, float]]]] = {}
    panel = ""
    for element in ElementTree.parse(path).getroot().iter():
        if element.get("font-weight") == "bold":
            panel = element.text or ""
        elif element.tag == f"{SVG}polyline":
            points = [tuple(map(float, point.split(","))) for point in (element.get("points") or "").split()]
            curves.setdefault(panel, []).append([(x, y) for x, y in points])
    return curves[title]


def test_plots_show_score_height_energy_and_gait(folder: Path) -> None:
    task = ("--task", folder / "dash.json", "--seeds", "1,2", "--json")
    invocation = run(folder / "zoo" / "b-cpg.json", *task, "--record", folder / "r", "--plot", folder / "made.svg")
    assert invocation.exit_code == 0, invocation.output
    (evaluation,) = json.loads(invocation.stdout)
    for title in ("score so far", "height of the middle (m)", "speed of the middle (m/s)", "work of the motors (J)"):
        assert len(drawn(folder / "made.svg", title)) == 2
    for line in drawn(folder / "made.svg", "work of the motors (J)"):
        assert all(later[1] <= earlier[1] for earlier, later in pairwise(line)), (
            "work only grows; up is less in a picture"
        )
    again = run("--from-recording", *evaluation["recordings"], "--plot", folder / "again.svg")
    assert again.exit_code == 0, again.output
    assert (folder / "again.svg").read_bytes() == (folder / "made.svg").read_bytes()
    picture = ElementTree.parse(folder / "made.svg").getroot()
    bars = [element for element in picture.iter(f"{SVG}rect") if element.get("x") is not None]
    assert bars, "a snake lies on the ground"
    assert run(folder / "zoo" / "b-cpg.json", *task, "--plot", folder / "none.svg").exit_code == 2


def test_a_plot_may_be_pixels_which_show_the_same(folder: Path) -> None:
    made = run(folder / "zoo" / "b-cpg.json", "--task", folder / "dash.json", "--seeds", "1", "--record", folder / "r")
    assert made.exit_code == 0, made.output
    (recording,) = (folder / "r").glob("*.mcap")
    for name in ("x.svg", "x.png"):
        assert run("--from-recording", recording, "--plot", folder / name).exit_code == 0
    with Image.open(folder / "x.png") as file:
        image = np.asarray(file.convert("RGB")).astype(int)
    picture = ElementTree.parse(folder / "x.svg").getroot()
    wide, high = map(float, picture.attrib["viewBox"].split()[2:])
    assert image.shape == (2 * high, 2 * wide, 3)
    (line,) = drawn(folder / "x.svg", "score so far")
    for x, y in line[:: len(line) // 7]:
        spot = image[round(2 * y) - 2 : round(2 * y) + 3, round(2 * x) - 2 : round(2 * x) + 3]
        assert (spot[..., 2] - spot[..., 0]).max() > 120, "the curve is blue"
    words = [element for element in picture.iter(f"{SVG}text") if element.get("font-weight") == "bold"]
    for word in words:
        x, y = 2 * int(float(word.attrib["x"])), 2 * int(float(word.attrib["y"]))
        assert image[y - 20 : y, x : x + 60].min() < 90, "there are letters"
    assert (image[:20] == 255).all()


def test_what_has_nothing_to_plot_says_so_and_writes_nothing(tmp_path: Path) -> None:
    path = record(tmp_path / "empty.mcap", lambda world, client: send(world, client, type="step", ticks=30))
    result = CliRunner().invoke(main, ["info", str(path), "--plot", str(tmp_path / "x.svg")])
    assert result.exit_code == 0 and "world" in result.stdout
    assert result.stderr.startswith("nothing to plot: there is no height of the middle (m), speed of the middle (m/s)")
    assert "x.svg was not written" in result.stderr and not (tmp_path / "x.svg").exists()


def test_the_score_so_far_ends_at_the_score(folder: Path) -> None:
    invocation = run(folder / "zoo" / "b-cpg.json", "--task", folder / "dash.json", "--json", "--record", folder / "r")
    (evaluation,) = json.loads(invocation.stdout)
    for path, result in zip(evaluation["recordings"], evaluation["results"], strict=True):
        scores = scores_so_far(Recording(path))
        assert scores[-1, 1] == result["score"]
        assert len(scores) == result["ticks"] + 1
        assert scores[0, 0] == pytest.approx(scores[-1, 0] - result["ticks"] / 60)


def test_nmes_info_plots_any_recording(tmp_path: Path) -> None:
    def hop(world: World, client: int) -> None:
        send(world, client, type="spawn_cube", cube_name="hopper", position=[0, 0.5, 0])
        send(world, client, type="step", ticks=10)
        send(world, client, type="apply_physics", impulse=[0, 3, 0])
        send(world, client, type="step", ticks=110)

    path = record(tmp_path / "hop.mcap", hop)
    result = CliRunner().invoke(main, ["info", str(path), "--plot", str(tmp_path / "hop.svg")])
    assert result.exit_code == 0, result.output
    (line,) = drawn(tmp_path / "hop.svg", "height of the middle (m)")
    top = min(line, key=lambda point: point[1])
    assert line[0][0] < top[0] < line[-1][0] and top[1] < line[0][1] - 10
    picture = ElementTree.parse(tmp_path / "hop.svg").getroot()
    assert len([bar for bar in picture.iter(f"{SVG}rect") if bar.get("x") is not None]) == 2, (
        "before the hop, and after"
    )


def test_the_best_of_many_are_run_again_alone_and_recorded(folder: Path) -> None:
    options = ("--task", folder / "dash.json", "--jobs", 1, "--json")
    plain = json.loads(run(folder / "zoo", *options).stdout)
    result = run(folder / "zoo", *options, "--record", folder / "best", "--record-best", 2)
    evaluations = json.loads(result.stdout)
    assert result.exit_code == 1 and timeless(evaluations) == timeless(plain)  # one of them is ill
    scores = sorted((each["score"] for each in plain if each["score"] is not None), reverse=True)
    recorded = [each for each in evaluations if each["recordings"]]
    assert sorted((each["score"] for each in recorded), reverse=True) == scores[:2]
    paths = [path for each in recorded for path in each["recordings"]]
    assert sorted(paths) == sorted(map(str, (folder / "best").iterdir())) and len(paths) == 4
    proved = json.loads(run("--from-recording", *paths, "--json").stdout)
    assert {each["score"] for each in proved} == set(scores[:2])


@pytest.mark.parametrize("named", [True, False])
def test_ctrl_c_while_the_best_are_recorded_keeps_all_results(
    folder: Path, monkeypatch: pytest.MonkeyPatch, named: bool
) -> None:
    monkeypatch.chdir(folder)
    options = (folder / "zoo", "--task", folder / "dash.json", "--jobs", 1, "--json")
    best = ("--record", folder / "best", "--record-best", 2)
    plain = json.loads(run(*options).stdout)
    evaluate, done = Evaluator.run, []

    def count(self: Evaluator, work: list[Job], **more: Any) -> Iterator[tuple[int, Evaluation]]:
        for place, evaluation in evaluate(self, work, **more):
            done.append(work[place].name)
            yield place, evaluation

    def stop(self: Evaluator, work: list[Job], **more: Any) -> Iterator[tuple[int, Evaluation]]:
        """The second is recorded before the first, and then somebody presses Ctrl-C."""
        if work[0].record is None:
            yield from evaluate(self, work, **more)
            return
        for _, evaluation in evaluate(self, work[1:], **more):
            yield 1, evaluation
        raise KeyboardInterrupt

    monkeypatch.setattr(Evaluator, "run", stop)
    resume: list[str | Path] = ["--resume", folder / "kept.jsonl"] if named else []
    stopped = run(*options, *best, *resume)
    evaluations = json.loads(stopped.stdout)
    assert stopped.exit_code == 1 and timeless(evaluations) == timeless(plain)
    assert "stopped: 1 of 2 done" in stopped.stderr and "Error" not in stopped.stderr
    assert sum(bool(each["recordings"]) for each in evaluations) == 1
    (lines,) = folder.glob("*.jsonl")
    monkeypatch.setattr(Evaluator, "run", count)
    rest = run(*options, *best, "--resume", lines)
    evaluations = json.loads(rest.stdout)
    assert timeless(evaluations) == timeless(plain) and len(done) == 1
    assert sum(bool(each["recordings"]) for each in evaluations) == 2
    assert {path.parent.name for path in folder.rglob("*.mcap")} == {"best"}


def test_a_creature_that_scores_otherwise_alone_is_an_error(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = Judge.result

    def spoiled(self: Judge, ended: str | None, fault: str | None) -> EpisodeResult:
        return replace(kept(self, ended, fault), energy=0.0)

    lines = folder / "lines"
    options = ("--task", folder / "dash.json", "--jobs", 1, "--record", folder / "best", "--record-best", 1)
    monkeypatch.setattr(Judge, "result", spoiled)
    assert run(folder / "zoo" / "a-wave.json", *options[:4], "--resume", lines).exit_code == 0
    monkeypatch.setattr(Judge, "result", kept)
    result = run(folder / "zoo" / "a-wave.json", *options, "--resume", lines)
    assert result.exit_code == 1 and "wave came out otherwise alone" in result.output
    result = run(folder / "zoo" / "a-wave.json", *options, "--resume", lines)
    assert result.exit_code == 2 and "line 2: a-wave came out otherwise" in result.output


def test_results_are_not_kept_in_a_link_or_a_pipe(folder: Path) -> None:
    (notes := folder / "notes").write_bytes(b"")
    (linked := folder / "linked").symlink_to(notes)
    os.mkfifo(piped := folder / "piped")
    for lines, said in ((linked, "it is a link"), (piped, "it is no regular file")):
        result = run(folder / "zoo" / "a-wave.json", "--task", folder / "dash.json", "--jobs", 1, "--resume", lines)
        assert result.exit_code == 2 and said in result.output
    assert notes.read_bytes() == b""


def test_how_many_are_recorded_needs_a_place(folder: Path) -> None:
    result = run(folder / "zoo", "--record-best", 2)
    assert result.exit_code == 2 and "--record" in result.output
