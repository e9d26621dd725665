"""Episodes as data: what a creature sensed, did and earned in each tick of a recording.

    episode = read_episode("proofs/walker-…-1.mcap")
    episode.observations[:-1], episode.actions  # what behaviour cloning learns from

Hides that a recording holds neither senses nor rewards: it is run again, and every digest compared.

Invariant: what is read is what `nmes.evaluation.Environments` give where they are driven with the same actions, bit
for bit.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from nmes.backend import Array
from nmes.errors import RecordingError, visible
from nmes.evaluation import Course, Result, Task, retrace
from nmes.genome import Genome
from nmes.objective.trajectory import Flags

__all__ = ["RecordedEpisode", "read_episode", "read_episodes"]


@dataclass(frozen=True, eq=False, slots=True)
class RecordedEpisode:
    """An episode of one creature on one task, tick by tick.

    Attributes:
        path: The recording.
        observations: Array (ticks + 1, sensors): what the sensors read before each tick and after the last, in the
            units of the genome's sensors.
        actions: Array (ticks, motors): controls from -1 to 1.
        rewards: Array (ticks,): by how much the objective grew; they add up to the score, or to 0 where there is none.
        terminated: Array (ticks,): whether the tick ended the episode early, or the world failed; only the last may.
        truncated: Array (ticks,): whether the episode had lasted its time; only the last may.
        result: How it came out, with its seed.
        genome: The creature.
        task: The task.
        begin: When it began, s since the recording did: until then its creature came to rest.
    """

    path: str
    observations: Array
    actions: Array
    rewards: Array
    terminated: Flags
    truncated: Flags
    result: Result
    genome: Genome
    task: Task
    begin: float

    @property
    def sensors(self) -> tuple[str, ...]:
        """The ids of the sensors, the columns of `observations`."""
        return tuple(sensor.id for sensor in self.genome.body.sensors)

    @property
    def motors(self) -> tuple[str, ...]:
        """The ids of the motors and voices, the columns of `actions`."""
        return self.genome.body.outputs


def read_episode(recording: str | os.PathLike[str]) -> RecordedEpisode:
    """Reads the recording of an episode, of an evaluation's or of one that was driven from outside.

    Args:
        recording: The file; it is run again.

    Raises:
        RecordingError, ProofError, DocumentError: As by `nmes.evaluation.retrace`: what does not come out as recorded
            is refused, and where it parts is named.
    """
    course = retrace(recording)
    last = np.arange(len(course.controls)) == len(course.controls) - 1
    return RecordedEpisode(
        str(recording),
        course.sensed,
        course.controls,
        _rewards(course),
        last & (not course.lasted),
        last & course.lasted,
        course.result,
        course.genome,
        course.task,
        course.begin,
    )


def read_episodes(recordings: Iterable[str | os.PathLike[str]]) -> Iterator[RecordedEpisode]:
    """Reads recordings of creatures that sense and do the same things: what a dataset holds, or a brain learns from.

    Args:
        recordings: The files; each is run again when its episode is asked for.

    Raises:
        RecordingError: One has other sensors, other motors or another tick rate than the first (`not_alike`), or none
            (`nothing_to_export`).
        RecordingError, ProofError, DocumentError: As by `read_episode`.
    """
    first: RecordedEpisode | None = None
    for recording in recordings:
        episode = read_episode(recording)
        if not episode.sensors or not episode.motors:
            what = f"{episode.genome.name} has {len(episode.sensors)} sensors and {len(episode.motors)} motors"
            raise RecordingError("nothing_to_export", visible(f"{recording}: {what}: there must be one of each"))
        first = first or episode
        for what, mine, others in (
            ("sensors", episode.sensors, first.sensors),
            ("motors", episode.motors, first.motors),
            ("ticks a second", (str(episode.task.tick_rate),), (str(first.task.tick_rate),)),
        ):
            if mine != others:
                unlike = f"{episode.path} and {first.path} have different {what}: {_few(mine)}, and {_few(others)}"
                raise RecordingError("not_alike", visible(f"{unlike}; episodes that are used together have the same"))
        yield episode


def _few(names: tuple[str, ...]) -> str:
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")


def _rewards(course: Course) -> Array:
    """Returns by how much the episode was worth more after each tick; nothing where that is not known."""
    rewards, given = np.zeros(len(course.controls)), 0.0
    # The start is worth something too: the first tick is paid for all that the episode is worth after it.
    worths = [*course.worth[1:].tolist(), course.result.score or 0.0]
    for tick, worth in enumerate(worths):
        if worth == worth:  # else it is no number
            rewards[tick] = worth - given
            given += float(rewards[tick])
    return rewards
