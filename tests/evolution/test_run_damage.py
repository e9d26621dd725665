"""Folders of runs that a power cut, a disk or a stranger left otherwise than a run leaves them."""

from __future__ import annotations

import errno
import fcntl
import random
import shutil
from pathlib import Path

import pytest

from nmes.errors import RunError
from nmes.evolution.run import Run
from runs import begin, finish


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a finished run."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    finish(begin(folder))
    return folder


def copied(run: Path, folder: Path) -> Path:
    shutil.copytree(run, folder / "run")
    return folder / "run"


def log(folder: Path) -> bytes:
    return (folder / "log.jsonl").read_bytes()


# -- what a power cut leaves ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(6))
def test_a_log_whose_last_bytes_became_zeros_is_gone_on_with(whole: Path, tmp_path: Path, seed: int) -> None:
    folder, text, draw = copied(whole, tmp_path), log(whole), random.Random(seed)
    end = draw.choice([0, *(index + 1 for index, byte in enumerate(text[:-1]) if byte == ord("\n"))])
    cut = end + draw.choice([0, draw.randrange(1, 12), draw.randrange(12, 400)])
    zeros = draw.choice([1, draw.randrange(1, 40), 4096, 3 << 20])
    (folder / "log.jsonl").write_bytes(text[:cut] + bytes(zeros))
    run = Run.open(folder)
    assert len(run) == text[:cut].count(b"\n")
    assert finish(run).digest == Run.open(whole).digest
    assert log(folder) == text


@pytest.mark.parametrize(
    "tail", [b"\0\0x", b'{"ind\0\0e', b'{"indez', bytes(2 << 20) + b"x", b"\0\n"], ids=lambda tail: repr(tail[:9])
)
def test_what_no_power_cut_leaves_is_not_cut_off(whole: Path, tmp_path: Path, tail: bytes) -> None:
    folder, text = copied(whole, tmp_path), log(whole) + tail
    (folder / "log.jsonl").write_bytes(text)
    with pytest.raises(RunError) as error:
        run = Run.open(folder)
        run.extend(25)
        finish(run)
    assert error.value.code == "log_damaged" and log(folder) == text


def test_who_has_a_damaged_log_hears_what_of_it_can_be_kept(whole: Path, tmp_path: Path) -> None:
    folder, lines = copied(whole, tmp_path), log(whole).splitlines(keepends=True)
    for number in (3, 11):
        lines[number] = lines[number].replace(b'"score"', b'"scoer"')
    (folder / "log.jsonl").write_bytes(b"".join(lines))
    with pytest.raises(RunError, match=r"line 12: .*head -n 3\)"):
        Run.open(folder).genome(11)  # by the index, which knows nothing of what is before
    (folder / "index.sqlite").unlink()
    with pytest.raises(RunError, match=r"line 4: .*head -n 3\)"):
        Run.open(folder)
    (folder / "log.jsonl").write_bytes(b"".join(lines[:3]))
    assert finish(Run.open(folder)).digest == Run.open(whole).digest


def test_who_has_a_foreign_end_of_a_log_hears_what_is_before_it(whole: Path, tmp_path: Path) -> None:
    folder, size = copied(whole, tmp_path), len(log(whole))
    (folder / "log.jsonl").write_bytes(log(whole) + b"what")
    run = Run.open(folder)
    run.extend(25)
    with pytest.raises(RunError, match=rf"head -c {size}\)"):
        finish(run)


# -- disks ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("number", "code"),
    [(errno.ENOLCK, "cannot_write"), (errno.ENOTSUP, "cannot_write"), (errno.EAGAIN, "run_busy")],
)
def test_a_log_that_cannot_be_locked_is_not_told_as_another_process(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, code: str
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(number, "said so")

    monkeypatch.setattr(fcntl, "flock", refuse)
    run = Run.open(copied(whole, tmp_path))
    run.extend(25)
    with pytest.raises(RunError) as error:
        finish(run)
    assert error.value.code == code
    assert ("said so" in error.value.message) == (code == "cannot_write")
