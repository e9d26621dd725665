"""One run of a study: its `nmes` commands, one after another, in processes of their own, and what they print.

Hides processes: how commands find what stands for their placeholders, what runs beside them, and that nothing of a run
goes on when it is over, when it is stopped half way, or when the process that does it is killed.
"""

from __future__ import annotations

import json
import os
import shlex
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, Final

from nmes.errors import StudyError, visible
from nmes.schemas.documents import JsonObject
from nmes.study.document import PLACE, PlannedRun, Setting, Study, fill, settle, tells
from nmes.study.results import GREATEST

__all__ = ["Stopped", "Stopper", "perform"]

_PATIENCE: Final = 10.0  # s that a command is given to end when it is told to
_LOOK: Final = 0.02  # s between looks at what a command beside has printed
_WATCH: Final = 1.0  # s between looks at whether all is stopped: a command may be one that measures
_PRINTED: Final = 64 << 20  # bytes of what a command prints
_LONGEST: Final = 1000  # characters of a column
_WRONG_USAGE: Final = 2  # the status of a command that could not do what it was asked
_TOLD: Final = 8  # lines of what a command that failed said
_TIED: Final = """\
import os, signal, sys, threading

def end():
    os.read(line, 1)
    os.killpg(0, signal.SIGKILL)

line = int(sys.argv.pop(1))
threading.Thread(target=end, daemon=True).start()

from nmes.cli import main
main(prog_name="nmes")
"""
"""What a command runs: `nmes`, which is killed with all that it has begun when the pipe ends that it is given."""


class Stopped(Exception):
    """A run that was stopped half way."""


class Stopper:
    """Stops all runs that are under way: from then on no process of theirs is begun, and those that are there end.

    Each process is a group with all that it begins, and ends by itself, with its group, when this process is no more.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._lines: dict[subprocess.Popen[bytes], int] = {}  # the end of a pipe, of which each process has the other
        self.stopped = False

    def begin(
        self, words: list[str], environment: Mapping[str, str], out: IO[bytes], errors: IO[bytes]
    ) -> subprocess.Popen[bytes]:
        """Begins a command of `nmes`, the one that this is.

        Args:
            words: What follows `nmes`.
            environment: Its variables.
            out: Where its standard output goes.
            errors: Where its standard error goes.

        Raises:
            Stopped: It is too late for that.
            OSError: The system cannot begin it.
            ValueError: A word has what none can have, such as a character of the code 0.
        """
        with self._lock:
            if self.stopped:
                raise Stopped
            theirs, ours = os.pipe()
            try:
                process = subprocess.Popen(
                    [sys.executable, "-P", "-c", _TIED, str(theirs), *words],
                    stdin=subprocess.DEVNULL,
                    stdout=out,
                    stderr=errors,
                    env=dict(environment),
                    pass_fds=[theirs],
                    process_group=0,
                )
            except BaseException:
                os.close(ours)
                raise
            finally:
                os.close(theirs)
            self._lines[process] = ours
        return process

    def wait(self, process: subprocess.Popen[bytes]) -> int:
        """Waits until a process has ended by itself; returns its status.

        Raises:
            Stopped: Everything was stopped before it had.
        """
        status = None
        while status is None and not self.stopped:
            with suppress(subprocess.TimeoutExpired):
                status = process.wait(_WATCH)
        if status is None or self.stopped:
            raise Stopped
        return status

    def end(self, process: subprocess.Popen[bytes]) -> None:
        """Ends a process, if it has not ended by itself."""
        process.terminate()
        try:
            process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)  # nobody else has this number: it was not waited for yet
            process.wait()
        with self._lock:
            os.close(self._lines.pop(process))

    def stop(self) -> None:
        """Stops everything."""
        with self._lock:
            self.stopped = True
            processes = list(self._lines)
        for process in processes:
            process.terminate()


def perform(study: Study, run: PlannedRun, folder: Path, stopper: Stopper) -> JsonObject:
    """Does a run, and returns its columns by name.

    Args:
        study: The study.
        run: Which one.
        folder: An empty folder for what it writes.
        stopper: Ends it half way.

    Raises:
        StudyError: A command fails, or does not print what a column asks for, or one beside ends before the others
            (`command_failed`).
        Stopped: It was stopped.
    """
    values = settle(run.values, {"run": str(folder), "study": str(study.folder)})
    environment = {name: value for name, value in os.environ.items() if name != "NMES_PASSWORD"}
    environment |= run.arm.get("environment", {})
    columns: JsonObject = dict.fromkeys(study.document["columns"])
    beside: dict[str, subprocess.Popen[bytes]] = {}
    try:
        for name, command in run.arm.get("beside", {}).items():
            words = _words(run, command, values)
            process = beside[name] = _begin(run, stopper, words, environment, folder / f"beside-{name}")
            if tells(command):
                values |= _ready(name, process, folder / f"beside-{name}.out", run, stopper)
        for name, command in study.arm_commands(run.arm).items():
            words = _words(run, command, values)
            process = _begin(run, stopper, words, environment, folder / name)
            try:
                status = stopper.wait(process)
            finally:
                stopper.end(process)
            _check_beside(run, beside, folder)  # first: what came of a command is worth nothing without them
            told = f"{run}: {shlex.join(words)}\n"
            columns |= _columns(study, name, status, folder, told)
            values |= _printed(name, study.arm_commands(run.arm).values(), folder, told)
    finally:
        for process in beside.values():
            stopper.end(process)
    return columns


def _words(run: PlannedRun, command: str, values: Mapping[str, Setting | list[Setting]]) -> list[str]:
    """Returns the words of a command of a run.

    Raises:
        StudyError: Nothing stands for a placeholder (`command_failed`).
    """
    try:
        return fill(shlex.split(command), values)
    except KeyError as error:
        missing = f"no text and no number was printed that {{{error.args[0]}}} stands for"
        raise StudyError("command_failed", f"{run}: {command}\n{missing}") from None


def _begin(
    run: PlannedRun, stopper: Stopper, words: list[str], environment: Mapping[str, str], path: Path
) -> subprocess.Popen[bytes]:
    """Begins a command; what it prints goes to files of that name.

    Raises:
        StudyError: It cannot be begun (`command_failed`).
        Stopped: It is too late for that.
    """
    with open(f"{path}.out", "wb") as out, open(f"{path}.err", "wb") as errors:
        try:
            return stopper.begin(words[1:], environment, out, errors)
        except (OSError, ValueError) as error:  # what was printed is too long for a word of it, or has a zero
            raise StudyError("command_failed", f"{run}: nmes {words[1]} cannot be begun: {error}") from error


def _ready(
    name: str, process: subprocess.Popen[bytes], path: Path, run: PlannedRun, stopper: Stopper
) -> dict[str, Setting | list[Setting]]:
    """Waits for the first line of JSON that a command beside prints; returns what placeholders stand for by it."""
    while True:
        ended = process.poll() is not None
        line, feed, _ = path.read_bytes().partition(b"\n")
        if feed:
            break
        if stopper.stopped:
            raise Stopped
        if ended:
            raise StudyError("command_failed", f"{run}: {name}, beside it, ended: {_said(path.with_suffix('.err'))}")
        time.sleep(_LOOK)
    try:
        told = json.loads(line)
    except ValueError as error:
        raise StudyError("command_failed", f"{run}: {name}, beside it, printed no line of JSON: {error}") from error
    items = told.items() if isinstance(told, dict) else ()
    return {f"{name}.{key}": value for key, value in items if isinstance(value, str | int | float)}


def _check_beside(run: PlannedRun, beside: Mapping[str, subprocess.Popen[bytes]], folder: Path) -> None:
    """Judges whether all commands beside a run still run.

    Raises:
        StudyError: One has ended, in whichever way: from then on nothing was beside the run (`command_failed`).
    """
    for name, process in beside.items():
        status = process.poll()
        if status is not None:
            told = f"{run}: {name}, beside it, did not last until the others were done: it {_end(status)}"
            raise StudyError("command_failed", f"{told}: {_said(folder / f'beside-{name}.err')}")


def _columns(study: Study, name: str, status: int, folder: Path, blame: str) -> JsonObject:
    """Returns the columns that come of a command."""
    wanted = {
        column: source.partition(" ")[2]
        for column, source in study.document["columns"].items()
        if source.partition(" ")[0] == name
    }
    if status and (status < 0 or status == _WRONG_USAGE or "status" not in wanted.values()):
        raise StudyError("command_failed", f"{blame}{_end(status)}: {_said(folder / f'{name}.err')}")
    columns: JsonObject = {column: float(status) for column, place in wanted.items() if place == "status"}
    pointers = {column: place for column, place in wanted.items() if place != "status"}
    printed = _read(folder / f"{name}.out", blame) if pointers else None
    return columns | {column: _as_double(_at(printed, pointer, blame)) for column, pointer in pointers.items()}


def _printed(name: str, commands: Iterable[str], folder: Path, blame: str) -> dict[str, Setting | list[Setting]]:
    """Returns the values of placeholders such as `{record/0/recordings/0}` of later commands."""
    names = [place for command in commands for place in PLACE.findall(command) if place.startswith(f"{name}/")]
    printed = _read(folder / f"{name}.out", blame) if names else None
    values: dict[str, Setting | list[Setting]] = {}
    for place in names:
        pointer = place.removeprefix(name)
        value = _at(printed, pointer, blame)
        if value is None:
            raise StudyError("command_failed", f"{blame}printed null at {pointer}: nothing that a command can be given")
        values[place] = value
    return values


def _read(path: Path, blame: str) -> Any:
    """Returns the JSON that a command has printed."""
    if path.stat().st_size > _PRINTED:
        raise StudyError("command_failed", f"{blame}printed over {_PRINTED >> 20} MiB")
    try:
        return json.loads(path.read_bytes())
    except ValueError as error:
        raise StudyError("command_failed", f"{blame}printed no JSON: {error}") from error


def _as_double(value: Setting | None) -> Setting | None:
    """Returns a value as columns have it: numbers as doubles."""
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else value


def _at(value: Any, pointer: str, blame: str) -> Setting | None:
    """Returns the value at a place of a command's output: a single value, as it was printed."""
    for key in pointer.split("/")[1:]:
        try:
            value = _in_list(value, key) if isinstance(value, list) else value[key]
        except (LookupError, TypeError, ValueError):
            raise StudyError("command_failed", f"{blame}printed nothing at {pointer}") from None
    number = isinstance(value, int | float) and abs(value) <= GREATEST  # which NaN is not
    if number or value is None or (isinstance(value, str) and len(value) <= _LONGEST):
        found: Setting | None = value
        return found
    raise StudyError("command_failed", f"{blame}printed no text and no number up to {GREATEST:g} at {pointer}")


def _in_list(values: list[Any], key: str) -> Any:
    """Returns the value at a place, or the first object that has a member of this value: `genome=walker`.

    Raises:
        LookupError, ValueError: There is none.
    """
    name, equals, wanted = key.partition("=")
    if not equals:
        return values[int(key)]
    named = [each for each in values if isinstance(each, dict) and str(each.get(name)) == wanted]
    return named[0]


def _end(status: int) -> str:
    """Returns how a command has ended, in words."""
    return f"was killed by signal {-status}" if status < 0 else f"ended with status {status}"


def _said(path: Path) -> str:
    """Returns the last lines that a command has told on standard error."""
    lines = path.read_text("utf-8", "replace").strip().splitlines()
    return visible("\n".join(lines[-_TOLD:]), keep="\n") or "it said nothing"
