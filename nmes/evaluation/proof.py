"""Proof of a score: a recorded episode, run again and scored from its log alone.

Invariant: what `prove` returns was reproduced tick by tick, in the very world of the task, and nothing but the
creature's own motors was touched.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping, Set
from dataclasses import dataclass
from datetime import UTC, datetime
from hashlib import file_digest
from itertools import chain, islice
from typing import Final, Generic, Protocol, TypeVar

import numpy as np

from nmes import protocol
from nmes.backend import Array
from nmes.errors import ProofError, RecordingError, WorldError
from nmes.evaluation.again import MODEL, has_model
from nmes.evaluation.episode import METADATA, Episode, brain_of
from nmes.evaluation.judge import Result
from nmes.evaluation.match_task import METADATA as MATCH
from nmes.evaluation.steps import ANY_CONTROLS, Drive, Step
from nmes.evaluation.task import CREATURE, Task
from nmes.genome import Genome
from nmes.playback import replay
from nmes.playback.report import fingerprint_differences
from nmes.protocol import Request
from nmes.recording import Kind, Recording
from nmes.schemas.documents import JsonObject, parse_document
from nmes.world import World

__all__ = [
    "Course",
    "Proof",
    "closed",
    "digest",
    "follow",
    "prove",
    "recorded_episode",
    "retrace",
    "scores_so_far",
]


class Steps(Protocol):
    """What a recording may be of: an episode, a match."""

    def steps(self) -> Iterator[Step]:
        """Yields the steps; each must be done before the next is asked for."""


R = TypeVar("R", bound=Steps)
# What else a command says, such as the layout that it is for, may have had the world refuse it.
_DRIVE: Final = {"type", "creature", "controls"}
_MOST = 2**26  # numbers of a course that is kept: half a gigabyte


@dataclass(frozen=True, slots=True)
class Proof:
    """What a recording proves: how one episode came out.

    Attributes:
        genome: The creature.
        task: The task.
        result: The episode's, computed from the log.
        path: The recording.
        recording_hash: SHA-256 of the file, hexadecimal.
        fingerprint: What the last bits depend on.
        recorded: When the recording was closed by the clock of who made it: UTC, ISO 8601, to the second.
    """

    genome: Genome
    task: Task
    result: Result
    path: str
    recording_hash: str
    fingerprint: Mapping[str, str]
    recorded: str


def prove(recording: str | os.PathLike[str], *, brain: bool = False) -> Proof:
    """Runs a recorded episode again and scores it, from its log alone.

    The commands must be those that set up the task's world with this creature in it, and then only drive its motors.

    Args:
        recording: The file.
        brain: Compare the controls too with what the genome's brain gives; else they may come from anywhere.

    Raises:
        RecordingError: It cannot be read.
        ProofError: It proves nothing: it is no recorded episode (`not_an_evaluation`), ends too early (`damaged`), or
            something in it comes out otherwise, or was done otherwise, than recorded (`diverged`, or `not_comparable`
            where that may be for the machine or the versions); the message has the frame. Or it cannot be run again
            at all: the code is that of the RecordingError or WorldError that says why, such as `recording_damaged`.
        DocumentError: Its task or its genome is not as it must be, or with `brain` its brain.
        MissingPackage: The brain, which is to be compared, needs a package that is not installed.
    """
    source = Recording(recording)
    episode, task, genome = _check(source, brain)
    return Proof(genome, task, episode.result(), str(recording), digest(recording), source.fingerprint, closed(source))


def digest(recording: str | os.PathLike[str]) -> str:
    """Returns the SHA-256 of a file, hexadecimal."""
    with open(recording, "rb") as file:
        return file_digest(file, "sha256").hexdigest()


def closed(source: Recording) -> str:
    """Returns when a recording was closed by the clock of who made it: UTC, ISO 8601, to the second.

    Raises:
        ProofError: It does not say so (`not_an_evaluation`).
    """
    try:
        time = datetime.fromisoformat(source.end["closed"])
        if time.tzinfo is None:
            raise ValueError("it depends on where it is read")
        return time.astimezone(UTC).isoformat(timespec="seconds")
    except (KeyError, ValueError, OverflowError) as error:
        raise ProofError("not_an_evaluation", f"{source.path} does not say when it was closed") from error


def scores_so_far(recording: Recording) -> Array:
    """Returns the score that an episode would have had at each of its ticks, had it ended there.

    Args:
        recording: The episode's. It is run again as by `prove`.

    Returns:
        Array (n, 2) of times since the recording began, s, and of values; where there is none, NaN.

    Raises:
        RecordingError, ProofError, DocumentError: As by `prove`.
    """
    episode, _task, _genome = _check(recording, False)
    return episode.scores_so_far()


@dataclass(frozen=True, eq=False, slots=True)
class Course:
    """What an episode was for its creature, tick by tick.

    Attributes:
        genome: The creature.
        task: The task.
        result: How the episode came out.
        sensed: Array (ticks + 1, sensors): what the sensors read before each tick and after the last. After a tick at
            which the world failed, what they read before it.
        controls: Array (ticks, motors): what the creature was driven with.
        worth: Array (ticks,): the score that the episode would have had at its start and after each tick but the last,
            had it ended there; NaN where there is none.
        lasted: Whether it lasted its time, and was neither ended nor failed.
        begin: When it began, s since the recording did.
    """

    genome: Genome
    task: Task
    result: Result
    sensed: Array
    controls: Array
    worth: Array
    lasted: bool
    begin: float


def retrace(recording: str | os.PathLike[str]) -> Course:
    """Runs a recorded episode again, and tells what its creature sensed and did.

    Args:
        recording: The file. Its commands are checked as by `prove`; the controls may come from anywhere.

    Raises:
        RecordingError, ProofError, DocumentError: As by `prove`; or there is nothing to tell, since the creature never
            came to rest or nobody drove it (`nothing_to_export`), or more than half a gigabyte (`too_long`).
    """
    source, log = Recording(recording), _Log()
    task, genome, _seed = recorded_episode(source)
    numbers = task.ticks * (len(genome.body.sensors) + len(genome.body.outputs))
    if numbers > _MOST:
        what = f"{recording}: its task's episodes have up to {numbers:,} readings and controls"
        raise RecordingError("too_long", f"{what}, and at most {_MOST:,} can be kept")
    episode, _, _ = _check(source, False, log)
    result, ticks = episode.result(), episode.driven_ticks
    if not ticks:
        raise ProofError("nothing_to_export", f"{recording}: the episode has no tick: {result.fault}")
    sensed = np.array(log.sensed[: ticks + 1]).reshape(ticks + 1, len(genome.body.sensors))
    controls = np.array(log.controls[:ticks], float).reshape(ticks, len(genome.body.outputs))
    times, worth = episode.scores_so_far()[:ticks].T
    return Course(genome, task, result, sensed, controls, worth, episode.lasted, float(times[0]))


class _Log:
    """What the creature of an episode sensed, and was driven with."""

    def __init__(self) -> None:
        self.sensed: list[Array] = []
        self.controls: list[list[float]] = []

    def note(self, world: World) -> None:
        """Notes what is sensed now, before a tick or after the last; of a world that failed, what was sensed before."""
        self.sensed += self.sensed[-1:] if world.fault is not None else [world.creature(CREATURE).sense()]


def _check(recording: Recording, brain: bool, log: _Log | None = None) -> tuple[Episode, Task, Genome]:
    """Runs a recorded episode again; returns it, once a recording was followed to its end without finding fault.

    Args:
        recording: The episode's.
        brain: As for `prove`.
        log: Where to write what the creature senses and does.

    Raises:
        ProofError, DocumentError, MissingPackage: As by `prove`.
    """
    task, genome, seed = recorded_episode(recording)
    if reasons := task.check(genome.body):  # whoever recorded it need not have asked
        raise ProofError("not_an_evaluation", f"{recording.path}: {'; '.join(reasons)}")
    driver = brain_of(genome) if brain else None

    def make(world: World) -> Episode:
        return Episode(world, genome, driver, task, seed, logged=not brain)

    models = {CREATURE} if brain and has_model([genome.document]) else set()
    return follow(recording, task.world_config(seed), make, models, log), task, genome


def follow(
    recording: Recording,
    config: JsonObject,
    make: Callable[[World], R],
    models: Set[str],
    log: _Log | None = None,
) -> R:
    """Runs a recording again, and compares each of its inputs with the next step of what it should be of.

    Args:
        recording: The recording.
        config: That of the world that it must have.
        make: Makes what yields the steps, in a new world.
        models: The names of the creatures whose brains are compared too, and may round otherwise here.
        log: Where to write what the creature of an episode senses and does.

    Returns:
        What was made, all of whose steps were done.

    Raises:
        ProofError: As by `prove`.
    """
    if recording.config != protocol.complete_config(config):
        raise ProofError("diverged", f"{recording.path}, frame 0: the world is not the task's")
    if recording.start().snapshot is not None:
        raise ProofError("diverged", f"{recording.path} begins with a world in which something was done before")
    checker = _Checker(make, models, log)
    try:
        report = replay(recording, watch=checker)
        if report.verdict == "not_comparable":
            pairs = ", ".join(f"{name} {was}, here {here}" for name, (was, here) in report.differences.items())
            raise ProofError("not_comparable", f"it comes out otherwise here, and was recorded with another {pairs}")
        if report.divergence is not None:
            frame = report.divergence.frame
            raise ProofError("diverged", f"it diverges at frame {frame}: {report.divergence.message}")
        if report.damage is not None:
            raise ProofError("damaged", report.damage)
        return checker.finished()
    except (ProofError, RecordingError, WorldError) as error:
        elsewhere = fingerprint_differences(recording.config["backend"], recording.fingerprint)
        code = "not_comparable" if error.code == "diverged" and elsewhere else error.code
        raise ProofError(code, f"{recording.path}: {error.message}") from error


def recorded_episode(recording: Recording) -> tuple[Task, Genome, int]:
    """Returns the task, the creature and the seed that a recording says it is of.

    Raises:
        ProofError: It is no recorded episode (`not_an_evaluation`).
        DocumentError: Its task or its genome is not as it must be.
    """
    if MATCH in recording.metadata:
        what = f"{recording.path} is of a match, and here it takes one of a single creature"
        raise ProofError("not_an_evaluation", f"{what}; `nmes eval --from-recording` scores it")
    about = recording.metadata.get(METADATA)
    begin, first = islice(chain(recording, (None, None)), 2)  # one that goes on from another begins with a keyframe
    spawn = None
    if begin is not None and begin.kind is Kind.JOINED and first is not None and first.kind is Kind.COMMAND:
        spawn = protocol.parse(first.data).command
    if about is None or not {"task", "seed"} <= about.keys() or spawn is None or spawn["type"] != "spawn_creature":
        raise ProofError("not_an_evaluation", f"{recording.path} is no recording of `nmes eval`")
    task = Task(parse_document(about["task"].encode()))
    if not re.fullmatch("0|[1-9][0-9]{0,18}", about["seed"]):
        raise ProofError("not_an_evaluation", f"{recording.path} names no seed, but {about['seed'][:40]!r}")
    return task, Genome(spawn["genome"]), int(about["seed"])


class _Checker(Generic[R]):
    """Follows a replay, and compares each of its inputs with the next step."""

    def __init__(self, make: Callable[[World], R], models: Set[str], log: _Log | None) -> None:
        """Takes what makes that which yields the steps, whose drives may differ, and where to write what one does."""
        self._make, self._models, self._log = make, models, log
        self._rounded: ProofError | None = None  # the first drive of a model that is another here
        self._run: R | None = None
        self._steps: Iterator[Step] = iter(())
        self._next: Step = None
        self._over = self._left = False

    def __call__(self, world: World, happened: Request | Kind | None) -> None:
        """Takes one input, after it has acted."""
        # One client is there all along. So the world never sleeps, of which what is watched and judged would be gone.
        if self._left:
            raise _divergence(world, f"{_input(happened)} after its client left")
        if self._run is None:
            if happened is not Kind.JOINED:
                raise _divergence(world, f"{_input(happened)} before a client came")
            self._run = self._make(world)
            self._steps = self._run.steps()
            self._advance(world)
        elif happened is Kind.LEFT:
            self._left = True
        elif self._over:
            raise _divergence(world, f"{_input(happened)} after the end of the episode")
        elif isinstance(happened, Kind):
            raise _divergence(world, f"{_input(happened)} where there should be {_expected(self._next)}")
        else:
            self._compare(world, happened)

    def _compare(self, world: World, request: Request | None) -> None:
        """Compares a command or a tick with the next step."""
        while _leaves_alone(self._next, request):
            self._leave_alone(world)
        if not _agree(self._next, request):
            what = f"{_input(request)} where there should be {_expected(self._next)}"
            if not _drives(self._next, request, self._models):
                raise _divergence(world, what)
            # All else must come out as recorded, with the drives of the recording.
            otherwise = f"at frame {world.frame} it has {what}: {MODEL}"
            self._rounded = self._rounded or ProofError("not_comparable", otherwise)
        driven = request.command if request is not None and _is_free(self._next) else None
        if self._log is not None and driven is not None:
            self._log.controls.append(driven["controls"])
        self._advance(world)

    def _leave_alone(self, world: World) -> None:
        """Goes on to what comes after a creature that has no brain and is not driven."""
        if self._log is not None:
            what = f"nobody drives the creature at frame {world.frame - 1}, so that there is no action"
            raise RecordingError("nothing_to_export", what)
        self._advance(world)

    def _advance(self, world: World) -> None:
        try:
            self._next = next(self._steps)
        except StopIteration:
            self._over = True
        if self._log is not None and (self._over or _is_free(self._next)):
            self._log.note(world)

    def finished(self) -> R:
        """Returns the result.

        Raises:
            ProofError: The recording ends before its steps are done, or before its client left (`damaged`), or a model
                did otherwise (`not_comparable`).
        """
        if self._run is None or not self._over:
            raise ProofError("damaged", "the recording ends before the episode does")
        # Or its last tick may be one within a command that was never answered, and so never shown and compared.
        if not self._left:
            raise ProofError("damaged", "the recording ends before its client left")
        if self._rounded is not None:
            raise self._rounded
        return self._run


def _is_free(step: Step) -> bool:
    """Whether a creature may be driven with any controls."""
    return isinstance(step, Drive) and step.controls is ANY_CONTROLS


def _leaves_alone(step: Step, request: Request | None) -> bool:
    """Whether a creature that need not be driven is not: at a tick, or where it is another one's turn."""
    if not (isinstance(step, Drive) and step.optional and _is_free(step)):
        return False
    command = None if request is None else request.command
    return request is None or (
        command is not None and command["type"] == "drive" and command["creature"] != step.creature
    )


def _agree(step: Step, request: Request | None) -> bool:
    """Whether a recorded input is the step that there should be."""
    if step is None or request is None:
        return step is None and request is None
    if isinstance(step, bytes):
        return request.raw == step
    command = request.command
    if command is None or command["type"] != "drive" or command["creature"] != step.creature:
        return False
    if _is_free(step):
        return True
    alike = np.array_equal(np.array(command["controls"], float), np.asarray(step.controls))
    return alike and command.keys() == _DRIVE


def _drives(step: Step, request: Request | None, models: Set[str]) -> bool:
    """Whether a recorded input drives a creature as there should be, but for the numbers that its model puts out."""
    command = None if request is None else request.command
    if not isinstance(step, Drive) or step.creature not in models or command is None:
        return False
    if command["type"] != "drive" or command["creature"] != step.creature or command.keys() != _DRIVE:
        return False
    return len(command["controls"]) == np.asarray(step.controls).size


def _divergence(world: World, what: str) -> ProofError:
    return ProofError("diverged", f"at frame {world.frame} it has {what}")


def _input(happened: Request | Kind | None) -> str:
    if isinstance(happened, Kind):
        return "a client who came" if happened is Kind.JOINED else "a sleep"
    return "a tick" if happened is None else f"the command {happened.type or 'that was refused'}"


def _expected(step: Step) -> str:
    if step is None:
        return "a tick"
    if isinstance(step, bytes):
        return f"another {protocol.decode(step)['type']}"
    creature = "the creature" if step.creature == CREATURE else step.creature
    return f"a drive of {creature}" if _is_free(step) else f"what the brain of {creature} does"
