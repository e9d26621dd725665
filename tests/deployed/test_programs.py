"""Programs in Go, with the habits of the original server's clients, do here what they are for.

They are served by `nmes serve --dialect original`, a world for each, on ports 3 apart. Each judges its own outcome;
here it is seen what the recordings tell: no error, no field that was not understood, and a replay that is exact. Where
Go is not installed, these tests are skipped and say so.
"""

from __future__ import annotations

import json
import math
import os
import random
import shutil
import signal
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from layout import ROOT
from nmes.cli import main
from processes import process
from servers import PASSWORD, PATIENCE

GO = shutil.which("go", path=os.pathsep.join([os.environ.get("PATH", os.defpath), "/usr/local/go/bin"]))
SOURCE = ROOT / "tests" / "deployed" / "programs"
RUN = ROOT / "tests" / "support" / "original-run.csv"
WITHOUT_EFFECT = {"bias", "limit_bias", "limit_softness", "limit_relaxation", "softness", "relaxation"}
WITHOUT_EFFECT |= {"linear_limit_softness", "linear_limit_restitution", "linear_limit_damping"}
WITHOUT_EFFECT |= {"damping", "impulse_clamp"}  # all that docs/deployed-clients.md names, of what the programs say
BUILDING = 300.0  # s; the first build compiles the standard library
RUNNING = 600.0  # s; a program takes a few, but for the heap of 600 cubes
# No network is needed, and nothing of the user's is touched.
ENVIRONMENT = {**os.environ, "GOTOOLCHAIN": "local", "GOFLAGS": "-mod=readonly", "GOPROXY": "off"}

Figures = dict[str, Any]

pytestmark = pytest.mark.skipif(GO is None, reason="Go is not installed: the programs were not built and not run")


@pytest.fixture(scope="session")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Builds the programs, which are one file."""
    assert GO is not None
    built = tmp_path_factory.mktemp("deployed") / "deployed"
    subprocess.run([GO, "vet", "."], cwd=SOURCE, env=ENVIRONMENT, timeout=BUILDING, check=True)
    subprocess.run([GO, "build", "-o", built, "."], cwd=SOURCE, env=ENVIRONMENT, timeout=BUILDING, check=True)
    return built


@contextmanager
def _original(worlds: int, directory: Path, *options: str) -> Iterator[int]:
    """Serves worlds as the original's, on ports 3 apart; yields the first port, and closes the recordings."""
    while True:
        first = random.SystemRandom().randrange(15_000, 30_000)  # below those that the system gives to clients
        where = [
            "--port",
            str(first),
            "--worlds",
            str(worlds),
            "--port-step",
            "3",
            "--record",
            str(directory),
            "--json",
        ]
        with process("serve", "--dialect", "original", *where, *options, NMES_PASSWORD=PASSWORD) as server:
            assert server.stdout is not None and server.stderr is not None
            if server.stdout.readline():
                yield first
                server.send_signal(signal.SIGTERM)
                assert server.wait(PATIENCE) == 0, server.stderr.read()
                return
            assert "in use" in server.stderr.read()


def _run(program: Path, first: int, *commands: str) -> list[Figures]:
    """Runs programs side by side, each in a world of its own; returns what they found."""
    environment = {**ENVIRONMENT, "NMES_PASSWORD": PASSWORD}
    with ExitStack() as running:
        started = []
        for number, command in enumerate(commands):
            arguments = [str(program), "-port", str(first + 3 * number), *command.split()]
            started.append(subprocess.Popen(arguments, env=environment, stdout=subprocess.PIPE, text=True))
            running.enter_context(started[-1])
            running.callback(started[-1].kill)
        outputs = [each.communicate(timeout=RUNNING)[0] for each in started]
    failed = [(command, out) for command, each, out in zip(commands, started, outputs, strict=True) if each.returncode]
    assert failed == []
    return [json.loads(output) for output in outputs]


def _nmes(*arguments: str | Path) -> Any:
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    return json.loads(result.output)


def _check_recordings(directory: Path, count: int) -> None:
    """Sees that all that was said was understood and done, and that it can be done again."""
    recordings = sorted(directory.iterdir())
    assert len(recordings) == count
    for recording in recordings:
        about = _nmes("info", "--json", recording)
        assert (about["errors"], about["refused"], about["faults"], about["complete"]) == (0, 0, 0, True)
        assert about["ignored"] == {}
        assert {name.split()[1] for name in about["without_effect"]} <= WITHOUT_EFFECT
        assert _nmes("replay", "--json", recording)["verdict"] == "reproduced"


def test_habits_get_what_they_expect(program: Path, tmp_path: Path) -> None:
    programs = ["blind_builder", "waiting_builder", "caller", "mute_motors", "repeater", "joint_maker", "planet_reader"]
    programs.append("-count 20 heap")
    with _original(len(programs), tmp_path, "--mode", "lockstep") as first:
        built, waited, called, turned, repeated, made, planets, heap = _run(
            program, first, *(f"-lockstep {name}" for name in programs)
        )
    assert built["speed"] == pytest.approx(5, abs=0.1)
    assert waited == {"silences": 7, "along": pytest.approx(3, abs=0.1), "across": pytest.approx(4, abs=0.1)}
    assert called["slowest"] == pytest.approx(4, abs=0.2)
    assert turned["turned"] > 0.5
    assert repeated["joints"] == ["joint_hinge_upper_lower", "joint_hinge_upper_lower_2"]
    assert made == {limited: pytest.approx(0.5, abs=0.05) for limited in ("turned", "slid", "swung")}
    assert planets == {"planets": 27, "seeds": 27}
    assert heap["cubes"] == 20 and heap["lowest"] > 0.4
    _check_recordings(tmp_path, len(programs))


def test_habits_get_what_they_expect_by_the_clock(program: Path, tmp_path: Path) -> None:
    programs = ["waiting_builder", "caller", "mute_motors", "repeater"]
    with _original(len(programs), tmp_path) as first:
        _run(program, first, *programs)
        assert _run(program, first, f"-count {len(programs)} scanner") == [{"worlds": len(programs)}]
    _check_recordings(tmp_path, len(programs))


def test_a_controller_gets_to_its_target_and_the_saved_run_goes_as_it_went(program: Path, tmp_path: Path) -> None:
    with _original(2, tmp_path, "--mode", "lockstep") as first:
        reached, followed = _run(program, first, "-lockstep controller", f"-lockstep -run {RUN} trajectory")
    assert reached["nearest"] < 5 and reached["after"] < 9
    assert followed["steps"] >= 25 and followed["off"] < 0.02 and followed["faster"] < 0.02
    assert followed["fell"] == 9
    _check_recordings(tmp_path, 2)


def test_bodies_hold_together_and_move_as_they_are_made_to(program: Path, tmp_path: Path) -> None:
    programs = ["pole", "slider_snake", "chain", "body", "bones"]
    with _original(len(programs), tmp_path, "--mode", "lockstep") as first:
        pole, snake, chain, body, bones = _run(program, first, *(f"-lockstep {name}" for name in programs))
    assert pole["sunk"] < 0.1
    assert 1.6 < snake["longest"] < 2.2
    assert chain["longest"] < 1.2 and chain["moved"] > 3
    assert body["longest"] < 1.12 and body["moved"] > 3
    assert bones["swung"] == pytest.approx(math.pi / 4, abs=0.05)
    _check_recordings(tmp_path, len(programs))


@pytest.mark.long
def test_a_heap_of_600_cubes_is_answered_by_the_clock(program: Path, tmp_path: Path) -> None:
    with _original(1, tmp_path) as first:
        (heap,) = _run(program, first, "-count 600 heap")
    assert heap["cubes"] == 600
    _check_recordings(tmp_path, 1)


@pytest.mark.long
def test_programs_do_what_they_are_for_by_the_clock(program: Path, tmp_path: Path) -> None:
    programs = ["blind_builder", "joint_maker", "controller", "pole", "slider_snake", "chain", "body", "bones"]
    with _original(len(programs), tmp_path) as first:
        _run(program, first, *programs)
    _check_recordings(tmp_path, len(programs))
