"""Learning as a state machine: legs, each of which follows from the settings, its number and the state before it.

    learning = Learning(settings, threads=2)
    while learning.leg < learning.legs:
        content = learning.go()  # what the log says of a leg
    learning.champion.genome, learning.state()

Hides how environments, learners and scores come together. Invariants: a leg begins with a reset of all environments,
and everything that it draws follows from the run's seed and its number; `restore(state())` changes nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Final, Protocol

import numpy as np
import orjson

from nmes.backend import Array
from nmes.brain.base import JsonObject
from nmes.errors import DocumentError, RunError
from nmes.evaluation import Environments, evaluate
from nmes.genome import Genome
from nmes.learning.learners.actor_critic import ActorCritic, Report
from nmes.learning.learners.arithmetic import average
from nmes.learning.learners.cloning import Cloning
from nmes.learning.learners.experience import Collector
from nmes.learning.learners.ppo import Ppo
from nmes.learning.learners.reinforce import Reinforce
from nmes.learning.learners.rows import Spaces
from nmes.learning.settings import LearningSettings, read_lessons
from nmes.learning.state import State, state_digest
from nmes.variation.draw import Draw

__all__ = ["Champion", "Learning"]

_SEEDS: Final = (1 << 31) - 1
_CHAMPION: Final = "champion"


@dataclass(frozen=True, slots=True)
class Champion:
    """The brain with the highest score so far.

    Attributes:
        leg: After which it was scored.
        score: On the task's seeds.
        genome: The creature with this brain.
    """

    leg: int
    score: float
    genome: Genome


class Learning:
    """A run of learning after some leg, at first before the first.

    Args:
        settings: What it is about.
        threads: How many step the engine.

    Raises:
        WorldError: The creature cannot begin.
        RecordingError, ProofError: A recording that it learns from cannot be read.
        RunError: The recordings are others than they were (`recordings_changed`).

    Attributes:
        leg: How many legs are done.
        legs: How many there are.
        champion: The best so far; None where none has a score.
    """

    def __init__(self, settings: LearningSettings, threads: int = 1) -> None:
        self._settings = settings
        self._pupil: _Pupil = _Clone(settings) if settings.algorithm == "clone" else _Actor(settings, threads)
        self.legs = -(-settings.steps // self._pupil.steps)
        self.leg = 0
        self.champion: Champion | None = None

    def go(self) -> JsonObject:
        """Goes on for a leg; returns what the log says of it (`schemas/learning_record.json`).

        Raises:
            RunError: Learning came to numbers that are too large (`not_finite`).
        """
        settings, number = self._settings, self.leg + 1
        report = self._learn(number)
        self.leg = number
        scored = self._genome() if number % settings.every == 0 or number == self.legs else None
        score = None if scored is None else evaluate(scored, settings.task).score
        if scored is not None and score is not None and (self.champion is None or score > self.champion.score):
            self.champion = Champion(number, score, scored)
        return {
            "leg": number,
            "steps": number * self._pupil.steps,
            "episodes": len(report.returns),
            "return": _mean(report.returns),
            "length": _mean(report.lengths),
            "figures": {name: value if isfinite(value) else None for name, value in report.figures.items()},
            "score": score,
            "genome_hash": None if scored is None else scored.hash,
            "state": state_digest(self.state()),
        }

    def _learn(self, number: int) -> Report:
        try:
            with np.errstate(over="raise", invalid="raise", divide="raise"):
                report = self._pupil.go(self._settings.draw("leg", number), 1.0 - (number - 1) / self.legs)
            if not all(np.isfinite(array).all() for array in self._pupil.arrays().values()):
                raise FloatingPointError("what was learned is no number")  # sums raise nothing
        except ArithmeticError as error:
            what = f"in leg {number} learning came to numbers that are too large ({error})"
            raise RunError(
                "not_finite", f"{what}: begin another run, with a smaller rate or smaller rewards"
            ) from error
        return report

    def _genome(self) -> Genome | None:
        """Returns the creature with the brain that was learned; None where its numbers are too large for one."""
        start = self._settings.genome
        try:
            genome = Genome({**start.document, "brain": self._pupil.brain(), "parents": [start.hash]})
            genome.check_brain()
        except DocumentError:
            return None
        return genome

    def best(self, observations: Array) -> Array:
        """Returns the learner's actions without chance (n, motors) at observations (n, sensors)."""
        return self._pupil.best(observations)

    def state(self) -> State:
        """Returns all that it knows: the learner's own arrays, and the champion."""
        champion = self.champion
        told = None if champion is None else [champion.leg, champion.score, champion.genome.document]
        return {**self._pupil.arrays(), _CHAMPION: np.frombuffer(orjson.dumps(told), np.uint8)}

    def restore(self, leg: int, state: State) -> None:
        """Goes to where it was after a leg.

        Args:
            leg: How many legs were done.
            state: What `state` gave then.

        Raises:
            ValueError: It is no such state.
        """
        arrays = self._pupil.arrays()
        if {*state} != {*arrays, _CHAMPION}:
            raise ValueError("a state of another learner")
        for name, array in arrays.items():
            if (state[name].shape, state[name].dtype) != (array.shape, array.dtype):
                raise ValueError(f"{name} is of another shape")
            if not np.isfinite(state[name]).all():
                raise ValueError(f"{name} has something that is no number")
        self.champion = _champion(state[_CHAMPION].tobytes(), leg)
        for name, array in arrays.items():
            array[...] = state[name]
        self.leg = leg

    def close(self) -> None:
        """Ends the environments."""
        self._pupil.close()


def _champion(text: bytes, leg: int) -> Champion | None:
    """Reads the champion in the state after a leg.

    Raises:
        ValueError: It is none.
    """
    try:
        told = orjson.loads(text)
        match told:
            case None:
                return None
            case [int(since), float(score), dict(document)] if 1 <= since <= leg:
                return Champion(since, score, Genome(document))
    except DocumentError as error:
        raise ValueError(f"its champion is none: {error}") from error
    raise ValueError("its champion is none")


def _mean(values: Sequence[float]) -> float | None:
    return average(np.array(values, np.float64)) if values else None


# -- who learns -------------------------------------------------------------------------------------------------------


class _Pupil(Protocol):
    """A learner, and what it learns from.

    Attributes:
        steps: Of a leg.
    """

    steps: int

    def go(self, draw: Draw, rest: float) -> Report:
        """Learns for a leg; `draw` gives all that is drawn, and `rest` is how much is still to be done, from 1 to 0."""

    def best(self, observations: Array) -> Array:
        """Returns its actions without chance (n, motors) at observations (n, sensors)."""

    def brain(self) -> JsonObject:
        """Returns the learned brain."""

    def arrays(self) -> dict[str, Array]:
        """Returns all that it knows, which whoever goes on with it writes into."""

    def close(self) -> None:
        """Ends what it learns from."""


class _Actor:
    """One that learns from what it does, in environments."""

    def __init__(self, settings: LearningSettings, threads: int) -> None:
        options = settings.algorithm_options()
        rows, reward = options.rows, settings.reward
        self._environments = Environments(settings.genome, settings.task, rows, threads=threads, reward=reward)
        self._ticks = options.ticks or settings.task.ticks
        self.steps = options.rows * self._ticks
        spaces = Spaces(len(self._environments.sensors), len(self._environments.motors))
        kind = Ppo if settings.algorithm == "ppo" else Reinforce
        start = settings.start()
        self._learner: ActorCritic = kind(spaces, options, settings.draw("first"), start)
        self.best, self.brain, self.arrays = self._learner.best, self._learner.brain, self._learner.arrays
        self.close = self._environments.close

    def go(self, draw: Draw, rest: float) -> Report:
        collector = Collector(self._environments, draw.count(0, _SEEDS))
        return self._learner.learn(collector, self._ticks, draw, rest)


class _Clone:
    """One that learns from what others did, in recordings."""

    def __init__(self, settings: LearningSettings) -> None:
        lessons = read_lessons(settings.recordings)
        if lessons.digest != settings.episodes:
            raise RunError("recordings_changed", "the recordings are others than those that the run began with")
        self._lessons = lessons
        spaces = Spaces(lessons.observations.shape[1], lessons.actions.shape[1])
        self._learner = Cloning(spaces, settings.algorithm_options(), settings.draw("first"))
        self.steps = self._learner.lessons(len(lessons.observations))
        self.best, self.brain, self.arrays = self._learner.best, self._learner.brain, self._learner.arrays

    def go(self, draw: Draw, rest: float) -> Report:
        return self._learner.learn(self._lessons.observations, self._lessons.actions, draw, rest)

    def close(self) -> None:
        pass
