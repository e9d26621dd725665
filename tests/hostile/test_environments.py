"""Equal arithmetic in every environment: what processors, libraries and settings may change, and what they must not."""

from __future__ import annotations

import ast
import json
import math
import os
import re
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from layout import ROOT
from nmes.backend import load_backend
from nmes.backend.fingerprint import fingerprint
from nmes.backend.probe import probe
from nmes.evaluation import Job
from nmes.recording import Recording
from nmes.world import World
from processes import NMES
from recordings import rewrite

# -- what no module may call ------------------------------------------------------------------------------------------

# Whose bits follow from what the processor has: products by BLAS, and functions with a variant for each set of vector
# instructions. What adds, multiplies, divides or takes square roots element by element, and sums by `add.reduce` or by
# numpy's own `c_einsum` (which `einsum` leaves for BLAS when it optimizes), is the same everywhere.
FORBIDDEN = {
    *("dot", "vdot", "vecdot", "matvec", "vecmat", "matmul", "inner", "tensordot", "einsum", "linalg", "convolve"),
    *("sin", "cos", "tan", "arcsin", "arccos", "arctan", "arctan2", "sinh", "cosh", "tanh", "arcsinh", "arccosh"),
    *("arctanh", "exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "power", "float_power", "cbrt", "hypot"),
    *("logaddexp", "sinc", "interp", "unwrap", "polyfit", "polyval", "fft", "corrcoef", "cov"),
}
# What `sum` may add up: whole numbers, and estimates of times. From Python 3.12 on it has other bits for floats.
WHOLE = re.compile(r"len\(|len,|size\(|\.file_size|\.episodes|ticks|steps|!=|is not None|i \* i|command_cost")
JUDGED = (
    *("nmes/backend", "nmes/brain", "nmes/world", "nmes/genome", "nmes/objective", "nmes/evaluation", "nmes/evolution"),
    *("nmes/learning/learners", "nmes/variation", "backends"),
)
EXCEPTIONS = {
    "nmes/genome/preview.py": "draws a picture",
    "backends/mujoco3d/rendering.py": "draws a picture",
    "nmes/backend/contract": "judges an engine; no world rests on it",
}


def judged() -> list[str]:
    files = (path for folder in JUDGED for path in sorted((ROOT / folder).rglob("*.py")))
    names = [str(path.relative_to(ROOT)) for path in files]
    return [name for name in names if not name.startswith(tuple(EXCEPTIONS))]


def hazards(source: str) -> Iterator[tuple[int, str]]:
    """Yields the lines of a module, with what is called there, whose bits depend on the processor."""
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.BinOp(op=ast.MatMult()) | ast.AugAssign(op=ast.MatMult()):
                yield node.lineno, "@"
            case ast.Attribute(value=ast.Name(id="np" | "numpy"), attr=name) if name in FORBIDDEN:
                yield node.lineno, f"np.{name}"
            case ast.Call(func=ast.Name(id="sum"), args=[terms]) if not WHOLE.search(
                ast.unparse(getattr(terms, "elt", terms))
            ):
                yield node.lineno, "sum"
            case ast.ImportFrom(module="numpy" | "numpy.linalg", names=names):
                yield from ((node.lineno, alias.name) for alias in names if alias.name in FORBIDDEN)
            case ast.ImportFrom(module=str(module), names=names) if module.startswith("numpy._core"):
                yield from ((node.lineno, alias.name) for alias in names if alias.name != "c_einsum")


@pytest.mark.parametrize("name", judged())
def test_no_number_that_reaches_a_world_or_a_score_depends_on_the_processor(name: str) -> None:
    assert list(hazards((ROOT / name).read_text())) == []


def test_the_hazards_are_found_where_there_are_some() -> None:
    source = "a @ b\na @= b\nnp.sin(x)\nnp.linalg.norm(x)\nfrom numpy import exp, add\nnp.einsum(s, x, y)\n"
    source += "from numpy._core.multiarray import c_einsum, dot\nnp.add(x, y)\n"
    source += "sum(a * b for a, b in pairs)\nsum(values)\nsum(len(x) for x in y)\n"
    assert sorted(line for line, _ in hazards(source)) == [1, 2, 3, 4, 5, 6, 7, 9, 10]
    for name in EXCEPTIONS:
        assert Path(ROOT / name).exists()
        assert any(list(hazards(path.read_text())) for path in _python(ROOT / name)), f"{name} needs no exception"


def _python(path: Path) -> list[Path]:
    return sorted(path.rglob("*.py")) if path.is_dir() else [path]


# -- the same bits in every environment -------------------------------------------------------------------------------

# Of each kind of brain a creature or two: how each comes out after two seconds, and whether recordings are reproduced.
TASK = {
    **{"format": "nmes-task/1", "name": "go", "description": "Go.", "duration": 2, "settle": 0, "seeds": [1]},
    "objective": "displacement.x + velocity.y + energy",
}
PROGRAM = """
import json, sys
from nmes.backend import load_backend
from nmes.backend.fingerprint import fingerprint
from nmes.evaluation import Task, evaluate
from nmes.evolution.algorithm import Measure, Problem, Score
from nmes.evolution.algorithms import load_algorithm
from nmes.genome import Genome
from nmes.playback import replay

def run(name, options, measures):
    # Scores that are all others if one bit of a candidate is another.
    problem = Problem(task, 1, (Genome.load("inchworm"),), measures=tuple(Measure(*measure) for measure in measures))
    algorithm, hashes = load_algorithm(name, problem, options), []
    for index in range(24):
        candidate = algorithm.ask(index)
        hashes.append(candidate.genome.hash)
        number = int(hashes[-1][:8], 16)
        measured = (number % 101, number % 103)[: len(measures)]
        algorithm.tell(index, candidate, Score(float(number), (), tuple(map(float, measured))))
    return [*hashes, algorithm.probe()]

asked = json.load(sys.stdin)
task = Task(asked["task"])
scores = {}
for path in asked["genomes"]:
    with open(path, "rb") as file:
        evaluation = evaluate(Genome.parse(file.read()), task)
    scores[path] = [evaluation.error, *(repr(result) for result in evaluation.results)]
print(json.dumps({
    "scores": scores,
    "verdicts": {path: replay(path).verdict for path in asked["recordings"]},
    "runs": {run_of[0]: run(*run_of) for run_of in asked["runs"]},
    "probes": {name: fingerprint(load_backend(name))["probe"] for name in asked["engines"]},
}))
"""

CREATURES = ("biped", "inchworm", "juggler", "lurcher", "roller", "walker")
ENGINES = ("mujoco", "pymunk", "ballistic")
MEASURES = [("mass", 0, 101, 7), ("length", 0, 103, 7)]
RUNS = [
    ("cma", {"population": 6}, []),
    ("es", {"population": 6}, []),
    ("map-elites", {"initial": 8, "window": 1}, MEASURES),
    ("cma-me", {"emitters": 2, "batch": 4}, MEASURES),
]
"""Algorithms, each with options with which it moves several times in a short run."""


def _numpy(*kept: str) -> dict[str, str]:
    """Returns the setting that takes from numpy all sets of instructions that it could choose but those."""
    found = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
    there = [name for name in found if name not in kept]
    return {"NPY_DISABLE_CPU_FEATURES": " ".join(there)} if there else {}


_AVX512 = ",".join(f"-AVX512{part}" for part in ("F", "VL", "BW", "DQ", "CD", "ER"))

ALIKE: dict[str, dict[str, str]] = {
    "numpy without AVX-512": _numpy("X86_V3"),
    "numpy without any set": _numpy(),
    "BLAS for Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "BLAS for Skylake": {"OPENBLAS_CORETYPE": "SkylakeX"},
    "BLAS for Nehalem, one thread": {"OPENBLAS_CORETYPE": "Nehalem", "OPENBLAS_NUM_THREADS": "1"},
    "x86-64-v3": {
        **_numpy("X86_V3"),
        "OPENBLAS_CORETYPE": "Haswell",
        "GLIBC_TUNABLES": f"glibc.cpu.hwcaps={_AVX512}",
    },
    "memory, hashes, place and time": {
        **{"PYTHONMALLOC": "malloc", "MALLOC_PERTURB_": "165", "MALLOC_ARENA_MAX": "1", "PYTHONHASHSEED": "77"},
        **{"LC_ALL": "C", "TZ": "Asia/Tokyo", "OMP_NUM_THREADS": "1"},
    },
}
UNLIKE = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4"}
"""Without fused multiply-add, the C library has other sines."""


def outcome(environment: dict[str, str], recordings: tuple[str, ...]) -> dict[str, Any]:
    genomes = [str(ROOT / f"nmes/genome/shipped/{name}.json") for name in CREATURES]
    asked = {"task": TASK, "genomes": genomes, "recordings": recordings, "engines": ENGINES, "runs": RUNS}
    process = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        input=json.dumps(asked),
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
    )
    assert process.returncode == 0, process.stderr
    outcome = json.loads(process.stdout)
    assert isinstance(outcome, dict)
    return outcome


def goldens(*names: str) -> tuple[str, ...]:
    """Returns the files of some recordings of the corpus, of all if none is named."""
    return tuple(str(path) for path in sorted((ROOT / "replays").glob("*.mcap")) if not names or path.stem in names)


SOME = goldens("mujoco-keyframes", "mujoco-landscape", "pymunk-pole")


@cache
def here(recordings: tuple[str, ...]) -> dict[str, Any]:
    return outcome({}, recordings)


@pytest.mark.parametrize("name", ALIKE)
def test_creatures_recordings_runs_and_probes_come_out_the_same_to_the_last_bit(name: str) -> None:
    assert outcome(ALIKE[name], SOME) == here(SOME)
    assert set(here(SOME)["verdicts"].values()) == {"reproduced"}


@pytest.mark.long
@pytest.mark.parametrize("name", ALIKE)
def test_the_whole_corpus_is_reproduced(name: str) -> None:
    assert set(outcome(ALIKE[name], goldens())["verdicts"].values()) == {"reproduced"}


# -- where the C library computes otherwise ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def elsewhere() -> dict[str, Any]:
    """What comes out where the C library has other variants of its functions."""
    other = outcome(UNLIKE, SOME)
    if other["probes"] == here(SOME)["probes"]:
        pytest.skip("the C library of this machine has only one variant of its functions")
    return other


def test_what_differs_beside_another_probe_is_never_called_divergence(elsewhere: dict[str, Any]) -> None:
    probes = here(SOME)["probes"]
    assert all(elsewhere["probes"][engine] != probes[engine] for engine in ENGINES)
    verdicts = elsewhere["verdicts"]
    assert set(verdicts.values()) == {"reproduced", "not_comparable"}
    code, output = nmes("replay", next(path for path in verdicts if verdicts[path] == "not_comparable"), **UNLIKE)
    assert code == 3 and output.startswith("not comparable: it was recorded with another\n  ") and "  probe: " in output
    code, output = nmes("replay", next(path for path in verdicts if verdicts[path] == "reproduced"), **UNLIKE)
    assert code == 0 and output.startswith("reproduced, on another machine: ")


@pytest.mark.usefixtures("elsewhere")
def test_a_proof_that_comes_out_otherwise_beside_another_probe_is_not_comparable(tmp_path: Path) -> None:
    task = tmp_path / "task.json"
    task.write_text(json.dumps({**TASK, "duration": 4, "world": {"backend": "pymunk"}}))
    assert nmes("eval", "inchworm", "--task", str(task), "--record", str(tmp_path))[0] == 0
    (proof,) = tmp_path.glob("*.mcap")
    assert nmes("eval", "--from-recording", str(proof))[0] == 0
    code, output = nmes("eval", "--from-recording", str(proof), **UNLIKE)
    assert code == 3 and "recorded with another probe" in output
    code, output = nmes("leaderboard", "add", str(tmp_path / "board"), str(proof), **UNLIKE)
    assert code != 0 and "diverge" not in output


@pytest.mark.usefixtures("elsewhere")
def test_a_proof_whose_scene_is_set_otherwise_beside_another_probe_is_not_comparable(tmp_path: Path) -> None:
    # The seed is one whose target lies elsewhere by a last bit where the C library has another sine.
    assert nmes("eval", "seeker", "--task", "reach", "--seeds", "47", "--record", str(tmp_path))[0] == 0
    (proof,) = map(str, tmp_path.glob("*.mcap"))
    assert nmes("eval", "--from-recording", proof)[0] == 0
    code, output = nmes("eval", "--from-recording", proof, **UNLIKE)
    assert code == 3 and "frame 0 it has the command spawn_creature" in output


def test_a_board_lists_what_comes_out_the_same_beside_another_probe(tmp_path: Path) -> None:
    (task := tmp_path / "task.json").write_text(json.dumps({**TASK, "world": {"backend": "pymunk"}}))
    assert nmes("eval", "inchworm", "--task", str(task), "--record", str(tmp_path))[0] == 0
    (proof,) = tmp_path.glob("*.mcap")
    about = {"nmes.fingerprint": {**Recording(proof).fingerprint, "probe": "0" * 32, "nmes": "9.9"}}
    closed = "2026-01-01T00:00:00+00:00"
    afar = str(rewrite(proof, tmp_path / "afar.mcap", lambda messages: messages, about=about, closed=closed))
    code, output = nmes("replay", afar)
    assert code == 0 and output.startswith("reproduced, on another machine: ")
    assert nmes("eval", "--from-recording", afar)[0] == 0
    board = str(tmp_path / "board")
    assert nmes("leaderboard", "tasks", board, "--allow", str(task))[0] == 0
    code, output = nmes("leaderboard", "add", board, afar)
    assert code == 0 and output.startswith("listed: inchworm ")
    assert nmes("leaderboard", "verify", board) == (0, "1 of 1 entries hold\n")
    # As where the expression has another last bit; then as a forger would have it.
    for change, status, said in ((1 + 4e-16, 3, "recorded with another probe: score: listed"), (1.001, 1, "broken")):
        with closing(sqlite3.connect(board)) as database, database:
            database.execute("UPDATE entries SET score = score * ?", (change,))
        code, output = nmes("leaderboard", "verify", board, "--write")
        assert code == status and said in output
        assert ("inchworm" in nmes("leaderboard", "show", board)[1]) is (status == 3)


def test_a_landscape_with_zeros_of_both_signs_is_the_same_on_every_processor() -> None:
    # numpy's `min` takes the zero of either sign, by how many numbers its vectors have.
    program = "from nmes.world import World\n"
    program += "heights = [[-0.0, 0.0, 0.1] + [0.0] * 6] + [[0.0, -0.0, 0.0] * 3 for _ in range(8)]\n"
    program += "scene = {'type': 'heightfield', 'heightfield': {'size': [4, 4], 'heights': heights}}\n"
    program += "world = World({'mode': 'lockstep', 'seed': 1, 'scene': scene})\n"
    program += "world.execute(world.join(), {'type': 'step', 'ticks': 1})\nprint(world.digest().hex())"
    found = set()
    for environment in ({}, *ALIKE.values()):
        process = subprocess.run(
            [sys.executable, "-c", program], env={**os.environ, **environment}, capture_output=True, text=True
        )
        assert process.returncode == 0, process.stderr
        found.add(process.stdout)
    assert len(found) == 1


def test_a_program_that_raises_where_numbers_underflow_has_the_same_probe() -> None:
    program = "import numpy; from nmes.backend import load_backend; from nmes.backend.probe import probe\n"
    program += f"numpy.seterr(all='raise')\nprint(*(probe(load_backend(name)) for name in {ENGINES!r}))"
    process = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert process.stdout.split() == [probe(load_backend(name)) for name in ENGINES], process.stderr


def rewards() -> list[Any]:
    """What cubes are rewarded for their ways along some axes."""
    world = World({"backend": "ballistic", "mode": "lockstep"})
    client = world.join()
    world.execute(client, {"type": "spawn_cube", "cube_name": "a", "linear_velocity": [0.1, 0.7, 0.3]})
    world.execute(client, {"type": "step", "ticks": 20})
    axes = [[0.1 * x, 0.7, 0.3 * x] for x in range(1, 40)]
    asked = {"type": "compute_reward", "cube_name": "a", "metric": "displacement"}
    return [world.execute(client, {**asked, "axis": axis}) for axis in axes]


def test_numbers_are_added_up_in_newer_pythons_as_in_older_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    before, add_up = rewards(), sum
    assert all(reward["type"] == "reward" for reward in before)

    def precise(values: Any, start: Any = 0) -> Any:
        values = list(values)
        return math.fsum(values) if values and {*map(type, values)} == {float} else add_up(values, start)

    monkeypatch.setattr("builtins.sum", precise)  # about what that of Python 3.12 does
    assert rewards() == before


def test_a_result_is_found_again_where_the_same_is_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    job = Job("walker", (ROOT / "nmes/genome/shipped/walker.json").read_bytes(), json.dumps(TASK).encode())
    key = job.key
    for item, same in (("cpu", True), ("simd", True), ("libc", True), ("probe", False), ("engine.version", False)):
        here = fingerprint(load_backend("mujoco")) | {item: "another"}
        with monkeypatch.context() as patch:
            patch.setattr("nmes.evaluation.evaluator.fingerprint", lambda backend, here=here: here)
            assert (job.key == key) is same, item


def nmes(*arguments: str, **environment: str) -> tuple[int, str]:
    """Runs the program; returns its exit status and what it prints."""
    process = subprocess.run([NMES, *arguments], env={**os.environ, **environment}, capture_output=True, text=True)
    return process.returncode, process.stdout + process.stderr
