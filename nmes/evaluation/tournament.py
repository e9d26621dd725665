"""Tournaments: every group of creatures plays every other, in all roles, and what comes of it is a table with ratings.

Hides who plays whom, in which order, and which matches of a folder are played already. A folder of a tournament has a
line for each match in `matches.jsonl`, and beside it the recordings that prove them.

Invariants: the table is a function of the creatures, the task and its seeds, whatever was played first, where, and how
often it was stopped. A match counts as played if its line is as it was written and its recording is still the one that
it names.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import IO, Any, Final

import orjson

from nmes.backend import load_backend
from nmes.backend.fingerprint import decisive, fingerprint
from nmes.errors import MissingPackage, NmesError, RunError, WorldError
from nmes.evaluation.bouts import Bout, play_bouts
from nmes.evaluation.evaluation import check_types
from nmes.evaluation.judge import Result
from nmes.evaluation.kept_lines import ChangedLine, sealed, unsealed
from nmes.evaluation.match import MatchResult, admit_players
from nmes.evaluation.match_task import MatchTask
from nmes.evaluation.parallel import Pool
from nmes.evaluation.proof import digest
from nmes.evaluation.ratings import Rating, places, rate
from nmes.genome import Genome
from nmes.objective.means import mean_of_all
from nmes.schemas.files import lock_kept, open_kept

__all__ = ["LOG", "Pairing", "Standing", "Tournament"]

LOG: Final = "matches.jsonl"
"""The file of a tournament's folder that has a line for each match."""
_MOST: Final = 1_000_000  # matches
_HEAD: Final = b'{"key":"'  # of a line


@dataclass(frozen=True, slots=True)
class Pairing:
    """One match of a tournament: who plays which role.

    Attributes:
        players: The creatures' numbers, in the order of the roles.
        seed: The match's.
    """

    players: tuple[int, ...]
    seed: int


@dataclass(frozen=True, slots=True)
class Standing:
    """What a tournament says of one creature.

    Attributes:
        genome: The genome's name.
        genome_hash: Its hash.
        rating: Its rating.
        matches: How many it has played that were not void.
        wins: In how many it was better than all others.
        draws: In how many it shared the first place.
        score: The mean of its scores by role; None where it had none in one of them.
        void: How many matches of its nobody had a score in.
    """

    genome: str
    genome_hash: str
    rating: Rating
    matches: int
    wins: int
    draws: int
    score: dict[str, float | None]
    void: int

    @property
    def losses(self) -> int:
        """In how many it was not first."""
        return self.matches - self.wins - self.draws

    def to_json(self) -> dict[str, Any]:
        """Returns the fields as plain data."""
        plain = {name: getattr(self, name) for name in ("matches", "wins", "draws", "losses", "void", "score")}
        return {"genome": self.genome, "genome_hash": self.genome_hash, "rating": self.rating.to_json(), **plain}


class Tournament:
    """A tournament.

    Args:
        task: What is played.
        genomes: The creatures, each different, in any order.
        seeds: Instead of the task's.

    Attributes:
        genomes: The creatures, by whose places here they are known.
        pairings: All matches, in their order.
        results: Of those that are played, by their place in `pairings`.

    Raises:
        WorldError: There are too few creatures or too many matches, two are the same, or one may not play (`invalid`).
        MissingPackage: A brain needs a package that is not installed.
    """

    def __init__(self, task: MatchTask, genomes: Sequence[Genome], seeds: Sequence[int] | None = None) -> None:
        # In the order of their hashes, so that the table is the same however they were named.
        self.task, self.genomes = task, sorted(genomes, key=lambda genome: genome.hash)
        self.pairings = _pairings(task, len(genomes), task.seeds if seeds is None else seeds)
        self.results: dict[int, MatchResult] = {}
        self._check()

    def _check(self) -> None:
        roles = list(self.task.roles)
        if len(roles) < 2 or len(self.genomes) < len(roles):
            what = f"{self.task.name} has {len(roles)} roles, and there are {len(self.genomes)} creatures"
            raise WorldError("invalid", f"a tournament is between two roles and creatures, or more: {what}")
        seen: dict[str, str] = {}
        for genome in self.genomes:
            if genome.hash in seen:
                raise WorldError("invalid", f"{genome.name!r} and {seen[genome.hash]!r} are the same genome")
            seen[genome.hash] = genome.name
            try:
                admit_players(self.task, dict.fromkeys(roles, genome))
            except MissingPackage:
                raise
            except NmesError as error:
                what = f"{genome.name!r} may not play {self.task.name}: {error.message}"
                raise WorldError("invalid", what) from error

    def _cast(self, pairing: Pairing) -> dict[str, Genome]:
        return {role: self.genomes[number] for role, number in zip(self.task.roles, pairing.players, strict=True)}

    def play(
        self, pool: Pool, folder: Path | None = None, progress: Callable[[int, int], None] | None = None
    ) -> Iterator[int]:
        """Plays the matches that are not played yet.

        Args:
            pool: Where.
            folder: In which matches and recordings are kept, and were; made if it is not there.
            progress: Called with how many are played, and how many there are.

        Yields:
            The places of matches in `pairings`, as they are ready.

        Raises:
            RecordingError: A recording cannot be written.
            RunError: Another process plays in the folder (`run_busy`), or its log cannot be written (`cannot_write`)
                or is none of ours (`log_damaged`).
        """
        with _opened(folder) as log:
            if log is not None and folder is not None:
                self._resume(log, folder)
            left = [number for number in range(len(self.pairings)) if number not in self.results]
            before, total, place = len(self.results), len(self.pairings), None if folder is None else str(folder)
            bouts = [
                Bout.of(self.task, self._cast(self.pairings[number]), self.pairings[number].seed, place)
                for number in left
            ]

            def show(done: int, _left: int) -> None:
                if progress is not None:
                    progress(before + done, total)

            for index, result in play_bouts(pool, bouts, show):
                if log is not None and result.recording is not None:  # else something failed, and is tried again
                    log.write(self._line(left[index], result, result.recording))
                    log.flush()
                self.results[left[index]] = result
                yield left[index]

    # -- the log -----------------------------------------------------------------------------------------------------

    def _key(self, number: int) -> str:
        """Returns a hash of all that a match's result depends on, what this machine computes included."""
        pairing, here = self.pairings[number], decisive(fingerprint(load_backend(self.task.world_config(0)["backend"])))
        hashes = [genome.hash for genome in self._cast(pairing).values()]
        return sha256(orjson.dumps([self.task.hash, hashes, pairing.seed, here])).hexdigest()

    def _line(self, number: int, result: MatchResult, recording: str) -> bytes:
        results = {role: asdict(each) for role, each in result.results.items()}
        proof = [Path(recording).name, digest(recording)]
        return sealed(
            {"key": self._key(number), "results": results, "recording": proof, "seconds": result.wall_seconds}
        )

    def _resume(self, log: IO[bytes], folder: Path) -> None:
        """Takes what the log has; a line that was not written to its end is taken out."""
        numbers = {self._key(number): number for number in range(len(self.pairings))}
        log.seek(0)
        end = 0
        for number, line in enumerate(log, start=1):
            if not line.endswith(b"\n"):
                if not line.startswith(_HEAD[: len(line)]):
                    raise RunError("log_damaged", f"{folder / LOG}, line {number}: not what `nmes tournament` writes")
                break
            end += len(line)
            key, result = self._read(line, folder, f"{folder / LOG}, line {number}")
            if key in numbers and result is not None:
                self.results[numbers[key]] = result
        log.truncate(end)
        log.seek(end)

    def _read(self, line: bytes, folder: Path, where: str) -> tuple[str, MatchResult | None]:
        """Returns a line's key and what it says; None where its recording is not there any more, or another one."""
        try:
            fields = unsealed(line)
            results = {str(role): Result(**each) for role, each in fields["results"].items()}
            for result in results.values():
                check_types(result, asdict(result))
            if [*results] != [*self.task.roles]:
                raise ValueError("these are other roles")
            key, seconds = str(fields["key"]), float(fields["seconds"])
            name, expected = fields["recording"]
            path = folder / Path(name).name
        except ChangedLine as error:
            what = f"{where}: not as `nmes tournament` wrote it"
            raise RunError("log_damaged", f"{what}: take the line out, and the match is played again") from error
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise RunError("log_damaged", f"{where}: not what `nmes tournament` writes") from error
        if not (path.is_file() and digest(path) == expected):
            return key, None
        return key, MatchResult(next(iter(results.values())).seed, results, str(path), seconds)

    # -- the table ---------------------------------------------------------------------------------------------------

    def standings(self) -> list[Standing]:
        """Returns the table of the matches that are played, the best creature first."""
        played = [(self.pairings[number], self.results[number]) for number in sorted(self.results)]
        ranked = [(pairing, places(result.results, self.task.margin), result) for pairing, result in played]
        ratings = rate(
            len(self.genomes), [(pairing.players, list(ranks.values())) for pairing, ranks, _ in ranked if ranks]
        )
        tallies = [_Tally(self.task) for _ in self.genomes]
        for pairing, ranks, result in ranked:
            for player, role in zip(pairing.players, self.task.roles, strict=True):
                tallies[player].add(role, result, ranks)
        standings = [
            tally.standing(genome, rating) for genome, rating, tally in zip(self.genomes, ratings, tallies, strict=True)
        ]
        return sorted(standings, key=lambda each: (-each.rating.sure, each.genome, each.genome_hash))


class _Tally:
    """One creature's matches, counted."""

    def __init__(self, task: MatchTask) -> None:
        self.matches = self.wins = self.draws = self.void = 0
        self._scores: dict[str, list[float | None]] = {role: [] for role in task.roles}

    def add(self, role: str, result: MatchResult, ranks: dict[str, int] | None) -> None:
        """Counts a match, in which it had a role."""
        self._scores[role].append(result.results[role].score)
        if ranks is None:
            self.void += 1
            return
        first = [other for other, rank in ranks.items() if rank == 0]
        self.matches += 1
        self.wins += first == [role]
        self.draws += role in first and len(first) > 1

    def standing(self, genome: Genome, rating: Rating) -> Standing:
        """Returns its row of the table."""
        counts = self.matches, self.wins, self.draws, self._means(), self.void
        return Standing(genome.name, genome.hash, rating, *counts)

    def _means(self) -> dict[str, float | None]:
        return {role: mean_of_all(scores) for role, scores in self._scores.items()}


def _pairings(task: MatchTask, count: int, seeds: Sequence[int]) -> list[Pairing]:
    """Returns all matches: each group of creatures, with each seed, in as many ways as there are roles."""
    size = len(task.roles)
    turns = [tuple((place + turn) % size for place in range(size)) for turn in range(size)]
    found: list[Pairing] = []
    for group in itertools.combinations(range(count), size):
        for seed in seeds:
            ways = task.sides(seed) if task.interchangeable else turns
            found += [Pairing(tuple(group[number] for number in way), seed) for way in ways]
        if len(found) > _MOST:
            raise WorldError("invalid", f"{count} creatures would play over {_MOST:,} matches of {task.name}")
    return found


@contextmanager
def _opened(folder: Path | None) -> Iterator[IO[bytes] | None]:
    """Gives the log of a folder, and lets nobody else have it meanwhile: two would spoil it."""
    if folder is None:
        yield None
        return
    path = folder / LOG
    try:
        folder.mkdir(parents=True, exist_ok=True)
        log = os.fdopen(open_kept(path), "r+b")
    except OSError as error:
        raise RunError("cannot_write", f"cannot write {path}: {error.strerror}") from error
    with log:
        try:
            lock_kept(log.fileno(), path)
        except BlockingIOError as error:
            raise RunError("run_busy", f"another nmes tournament plays in {folder}") from error
        except OSError as error:
            raise RunError("cannot_write", f"cannot write {path}: {error.strerror}") from error
        yield log
