"""The tests' own settings: a test that hangs is ended, and property tests draw the same examples for everybody."""

from __future__ import annotations

import importlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from disks import full_disk
from layout import ROOT

HANGING = """
import asyncio, threading, time
import pytest

def test_main_thread():
    time.sleep(1000)

def test_other_thread():
    thread = threading.Thread(target=threading.Event().wait, daemon=True)
    thread.start()
    thread.join()

async def test_event_loop():
    await asyncio.Event().wait()

def test_fixture(endless):
    pass

@pytest.fixture
def endless():
    while True:
        pass

@pytest.mark.long
def test_long():
    time.sleep(3)

def test_short():
    pass
"""

DRAWING = """
from pathlib import Path
from hypothesis import given, settings, strategies as st

@settings(max_examples=50)
@given(st.integers() | st.floats() | st.text() | st.lists(st.integers()))
def test_draw(value):
    with Path(__file__).with_suffix(".drawn").open("a") as file:
        print(ascii(value), file=file)
"""

FAILING = """
from hypothesis import given, strategies as st

@given(st.integers())
def test_fails(number):
    assert number < 1000
"""


def run(folder: Path, test: str, *options: str, **environment: str) -> str:
    """Runs tests in a process of their own with this project's settings; returns what pytest printed."""
    shutil.copy(ROOT / "tests" / "conftest.py", folder)
    (folder / "test_it.py").write_text(test)
    command = [sys.executable, "-m", "pytest", "-c", str(ROOT / "pyproject.toml"), "-p", "no:cacheprovider"]
    result = subprocess.run(
        [*command, *options, str(folder / "test_it.py")],
        cwd=folder,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=240,
    )
    return result.stderr + result.stdout


@pytest.mark.parametrize("workers", ["0", "2"])
def test_a_test_that_hangs_fails_and_the_others_run(tmp_path: Path, workers: str) -> None:
    output = run(tmp_path, HANGING, "-n", workers, "-o", "timeout=2")
    lines = output.splitlines()
    failures = sorted(
        line.partition("::")[2].partition(" ")[0] for line in lines if line.startswith(("FAILED", "ERROR"))
    )
    assert failures == ["test_event_loop", "test_fixture", "test_main_thread", "test_other_thread"], output
    assert output.count("Failed: Timeout (>2.0s)") >= 4
    assert "2 passed" in lines[-1]


def test_a_test_that_no_signal_interrupts_ends_its_worker(tmp_path: Path) -> None:
    test = """
import signal

def test_blocked():
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGALRM])
    signal.pause()

def test_next():
    pass
"""
    output = run(tmp_path, test, "-n", "1", "-o", "timeout=1", "-o", "faulthandler_timeout=3")
    assert "crashed while running" in output and "test_blocked" in output
    assert "1 failed, 1 passed" in output.splitlines()[-1]


def drawn(folder: Path, test: str = DRAWING, *options: str, **environment: str) -> list[str]:
    """Runs a property test; returns all examples that it drew."""
    folder.mkdir()
    output = run(folder, test, *options, **environment)
    assert "1 passed" in output, output
    return (folder / "test_it.drawn").read_text().splitlines()


def test_property_tests_draw_the_same_examples_in_every_process(tmp_path: Path) -> None:
    examples = drawn(tmp_path / "first", PYTHONHASHSEED="1", CI="")
    assert len(set(examples)) > 40
    assert drawn(tmp_path / "again", DRAWING, "-n", "1", PYTHONHASHSEED="2", CI="true") == examples
    # Hypothesis would draw constants of these modules, if they are imported.
    imports = "import nmes.server, nmes.view, nmes.playback, nmes.backends.mujoco3d\n"
    assert drawn(tmp_path / "imports", imports + DRAWING) == examples


@pytest.mark.long
def test_the_search_draws_other_examples_each_time(tmp_path: Path) -> None:
    options = ["-n", "1", "--hypothesis-profile=search"]
    assert drawn(tmp_path / "first", DRAWING, *options, CI="") != drawn(tmp_path / "again", DRAWING, *options, CI="1")


def test_a_failed_property_test_prints_its_example_and_how_to_repeat_it(tmp_path: Path) -> None:
    output = run(tmp_path, FAILING)
    assert "number=1000," in output
    assert "@reproduce_failure(" in output
    assert not (tmp_path / ".hypothesis" / "examples").exists()


def test_a_test_with_a_full_disk_keeps_no_module_that_was_cut_short(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    for name in ("loaded_here", "loaded_there"):
        (tmp_path / f"{name}.py").write_text(f"text = {'x' * 1000!r}")
    monkeypatch.syspath_prepend(tmp_path)
    with full_disk(100):
        importlib.import_module("loaded_here")
        subprocess.run([sys.executable, "-c", "import loaded_there"], cwd=tmp_path, check=True)
    assert not (tmp_path / "__pycache__").exists()
