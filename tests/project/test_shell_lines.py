"""The lines that README.md and the tutorial show are typed as they stand, one after the other, in an empty folder.

Left out are the three at the top of README.md, by which its picture was made: they take all cores for minutes.
"""

from __future__ import annotations

import errno
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from layout import ROOT
from processes import NMES
from servers import PATIENCE

# What prepares, or is no command of ours: make (tests/project/test_examples.py runs the demo), the shell's own, and the
# conversation over a socket (tests/project/test_docs.py has it).
OTHERS = ("make ", "source ", "nc ", "pip ", "uv ")
QUICK = ("Drive a world", "Reproduce")


@dataclass
class Step:
    """What is typed: a shell's line with the output that is shown of it, or a program in Python."""

    section: str
    language: str
    text: str
    shown: list[str]


def steps(document: str) -> Iterator[Step]:
    """Yields what a document shows, in its order."""
    for part in re.split(r"^## ", (ROOT / document).read_text(), flags=re.MULTILINE)[1:]:
        section = part.partition("\n")[0]
        for language, block in re.findall(r"^```(\w+)\n(.*?)^```", part, flags=re.DOTALL | re.MULTILINE):
            if language == "python":
                yield Step(section, language, block, [])
            elif language == "console":
                for line in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
                    typed, *shown = line.splitlines()
                    yield Step(section, language, typed, shown)


@contextmanager
def typed_in_background(line: str, folder: Path) -> Iterator[None]:
    """Runs a host in a terminal of its own, until Ctrl-C ends it."""
    with subprocess.Popen(line, shell=True, cwd=folder, env=variables(), stdout=subprocess.PIPE, text=True) as host:
        assert host.stdout is not None
        for output in host.stdout:
            if output.startswith("Ctrl-C"):
                break
        else:
            raise AssertionError(f"{line}: it ended, see standard error")
        yield
        host.send_signal(signal.SIGINT)
        assert host.wait(PATIENCE) == 0


def variables() -> dict[str, str]:
    inherited = {name: value for name, value in os.environ.items() if name != "NMES_PASSWORD"}
    return {**inherited, "PATH": f"{Path(NMES).parent}{os.pathsep}{os.environ['PATH']}"}


def type_all(chosen: list[Step], folder: Path) -> int:
    """Types all steps; a host runs until its section ends. Returns how many lines of the shell they were."""
    lines, section = 0, ""
    with ExitStack() as running:
        for step in chosen:
            if step.section != section:
                running.close()
                section = step.section
            if step.text.startswith("nmes serve"):
                running.enter_context(typed_in_background(f"exec {step.text}", folder))
            elif step.language == "python":
                type_program(step.text, folder)
            elif not step.text.startswith(OTHERS):
                type_line(step, folder)
            lines += step.language == "console"
    return lines


def type_line(step: Step, folder: Path) -> None:
    result = subprocess.run(step.text, shell=True, cwd=folder, env=variables(), capture_output=True, text=True)
    assert result.returncode == 0, f"{step.text}\n{result.stdout}{result.stderr}"
    for shown in step.shown:
        word = shown.split()[0].rstrip(".") if shown.strip() else ""
        assert word in result.stdout, f"{step.text} is shown to print {shown!r}, and printed\n{result.stdout}"


def type_program(code: str, folder: Path) -> None:
    result = subprocess.run([sys.executable, "-c", code], cwd=folder, env=variables(), capture_output=True, text=True)
    assert result.returncode == 0, result.stderr


@pytest.fixture
def usual_port() -> Iterator[None]:
    """Port 14000, which hosts take where nothing else is said: one test at a time may, whoever runs it.

    A file as a lock would be the first user's.
    """
    with socket.socket() as lock:
        while True:
            try:
                lock.bind(("127.0.0.1", 13_999))
                break
            except OSError as error:
                assert error.errno == errno.EADDRINUSE, error
                time.sleep(0.1)
        yield


@pytest.mark.usefixtures("usual_port")
def test_a_sample_of_the_readme_runs_as_written(tmp_path: Path) -> None:
    chosen = [step for step in steps("README.md") if step.section in QUICK]
    assert {step.section for step in chosen} == set(QUICK)
    assert type_all(chosen, tmp_path) >= 7
    assert (tmp_path / "states.csv").stat().st_size > 1000


@pytest.mark.long
@pytest.mark.usefixtures("usual_port")
@pytest.mark.parametrize(("document", "least"), [("README.md", 19), ("docs/tutorial.md", 14)])
def test_all_lines_run_as_written(document: str, least: int, tmp_path: Path) -> None:
    assert type_all(list(steps(document)), tmp_path) >= least


def test_a_line_that_fails_or_prints_something_else_is_noticed(tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match="No such command 'fly'"):
        type_line(Step("", "console", "nmes fly", []), tmp_path)
    with pytest.raises(AssertionError, match="is shown to print 'sound"):
        type_line(Step("", "console", "nmes --version", ["sound: 3 records"]), tmp_path)


def test_what_is_not_typed_is_little() -> None:
    left = [step.text for document in ("README.md", "docs/tutorial.md") for step in steps(document)]
    assert [line for line in left if line.startswith(OTHERS)] == [
        *("make demo     # five example worlds: served, driven over TCP, recorded, reproduced, and a picture",),
        *("nc 127.0.0.1 14000", "make demo", "source .venv/bin/activate"),
    ]
