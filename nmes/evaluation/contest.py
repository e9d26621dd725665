"""A creature's worth against others: the mean of its scores in matches, one against each of some lineups.

Invariant: what comes out follows from task, creatures, role and seeds alone, whoever plays the matches.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import orjson

from nmes.errors import MACHINE_ERRORS, MissingPackage, NmesError, RecordingError
from nmes.evaluation.evaluation import Evaluation
from nmes.evaluation.judge import Result
from nmes.evaluation.match import MatchResult, admit_players, play_match
from nmes.evaluation.match_task import MatchTask
from nmes.genome import Genome

__all__ = ["Contest", "Pairing", "Rivals", "evaluate_contests", "hold_contest", "pairings", "play_pairing"]


@dataclass(frozen=True, slots=True)
class Rivals:
    """Whom a creature meets.

    Attributes:
        role: The creature's; where roles are interchangeable it plays each of them, and this says nothing.
        lineups: The others, of each match or pair of matches: one for each other role, in the order of the roles.
    """

    role: str
    lineups: tuple[tuple[Genome, ...], ...]


class Pairing(NamedTuple):
    """One match of a contest.

    Attributes:
        lineup: Which of the lineups is met.
        seed: The match's.
        places: By role, who plays it: 0 is the creature whose contest it is, then come those of the lineup.
    """

    lineup: int
    seed: int
    places: dict[str, int]

    def role(self, place: int) -> str:
        """Returns the role of the creature in a place."""
        return next(name for name, held in self.places.items() if held == place)


def pairings(task: MatchTask, role: str, lineups: int, seeds: Sequence[int]) -> Iterator[Pairing]:
    """Yields the matches of a contest, in their order.

    Each lineup is met on one of the seeds, which take turns; where roles are interchangeable, once in each role.
    """
    roles = list(task.roles)
    for number in range(lineups):
        seed = seeds[number % len(seeds)]
        if task.interchangeable:
            for places in task.sides(seed):
                yield Pairing(number, seed, dict(zip(roles, places, strict=True)))
        else:
            ordered = [role, *(name for name in roles if name != role)]
            yield Pairing(number, seed, {name: ordered.index(name) for name in roles})


def play_pairing(task: MatchTask, cast: Sequence[Genome], pairing: Pairing, record: Path | None = None) -> MatchResult:
    """Plays one match of a contest, in this process.

    Args:
        task: What is played.
        cast: The creature whose contest it is, then those of the lineup.
        pairing: Who plays which role.
        record: An existing folder, in which a recording is left.

    Raises:
        DocumentError, WorldError: Somebody may not play a role, or cannot be set down.
        RecordingError: The recording cannot be written.
    """
    players = {name: cast[place] for name, place in pairing.places.items()}
    return play_match(task, players, admit_players(task, players), pairing.seed, record)


def hold_contest(
    genome: Genome, rivals: Rivals, task: MatchTask, seeds: Sequence[int], record: Path | None = None
) -> Evaluation:
    """Plays a creature's matches, in this process.

    Args:
        genome: The creature.
        rivals: Whom it meets.
        task: What is played.
        seeds: Of the matches.
        record: An existing folder, in which a recording of each match is left.

    Returns:
        Its result in each match, in the order of `pairings`; the score is their mean. `error` says why a match could
        not be played.

    Raises:
        RecordingError: A recording cannot be written.
        MissingPackage: A brain needs a package that is not installed.
    """
    begin, names = time.perf_counter(), (genome.name, genome.hash, task.name, task.hash)
    results: list[Result] = []
    recordings: list[str] = []
    for pairing in pairings(task, rivals.role, len(rivals.lineups), seeds):
        try:
            match = play_pairing(task, (genome, *rivals.lineups[pairing.lineup]), pairing, record)
        except (MissingPackage, RecordingError):
            raise
        except NmesError as refusal:
            return Evaluation(*names, error=refusal.message, wall_seconds=time.perf_counter() - begin)
        results.append(match.results[pairing.role(0)])
        recordings += [] if match.recording is None else [match.recording]
    return Evaluation(*names, tuple(results), None, tuple(recordings), time.perf_counter() - begin)


@dataclass(frozen=True, slots=True)
class Contest:
    """A contest to be held somewhere else: plain data, the genomes not looked at yet.

    Attributes:
        name: What to call the creature.
        genome: The bytes of its file.
        task: The task's document, as JSON.
        seeds: Of the matches.
        role: As of `Rivals`.
        lineups: As of `Rivals`, the bytes of their files.
    """

    name: str
    genome: bytes
    task: bytes
    seeds: tuple[int, ...]
    role: str
    lineups: tuple[tuple[bytes, ...], ...]

    def run(self) -> Evaluation:
        """Holds it; where that fails in a way that nobody foresaw, the evaluation says so."""
        try:
            lineups = tuple(tuple(map(Genome.parse, lineup)) for lineup in self.lineups)
            task = MatchTask(orjson.loads(self.task))
            return hold_contest(Genome.parse(self.genome), Rivals(self.role, lineups), task, self.seeds)
        except (MissingPackage, *MACHINE_ERRORS):
            raise
        except Exception as error:  # a mistake of ours, which these genomes have found
            return self.failed(f"{type(error).__name__}: {error}")

    def failed(self, error: str) -> Evaluation:
        """Returns the evaluation of a creature whose contest could not be held."""
        task = MatchTask(orjson.loads(self.task))
        return Evaluation(self.name, "", task.name, task.hash, error=error)


def evaluate_contests(portion: Sequence[Contest]) -> list[Evaluation]:
    """Holds contests one after the other."""
    return [contest.run() for contest in portion]
