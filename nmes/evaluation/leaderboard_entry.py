"""One line of a leaderboard: what its recordings prove of it, and how a row that anybody may have edited is judged.

A line is of one creature on a task, or of creatures that have met on a task with roles.

Invariants:

- All that a line says follows from its recordings: whatever a row says otherwise, it is broken.
- What is in a row, or in a recording, is one entry's matter: judging one never fails.
- What is the verifier's own trouble (another machine, a missing engine, a disk) breaks nothing.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass
from hashlib import file_digest, sha256
from pathlib import Path
from statistics import pstdev
from typing import Any, Final, Literal, TypeAlias

import orjson

from nmes.errors import LeaderboardError, NmesError
from nmes.evaluation.identity import creature_hash, task_title
from nmes.evaluation.match_proof import MatchProof, is_match, prove_match, recorded_match
from nmes.evaluation.match_task import MatchTask
from nmes.evaluation.proof import Proof, prove, recorded_episode
from nmes.evaluation.ratings import places
from nmes.evaluation.task import Task
from nmes.genome import Genome
from nmes.objective.means import mean
from nmes.playback.report import fingerprint_differences
from nmes.recording import Recording
from nmes.recording.signing import signer

__all__ = [
    "COLUMNS",
    "AnyProof",
    "Entry",
    "Player",
    "Verdict",
    "examine",
    "facts",
    "group",
    "proved",
    "read_row",
    "told",
]

AnyProof: TypeAlias = Proof | MatchProof
"""The proof of an episode, or of a match."""

_HASH: Final = re.compile("[0-9a-f]{64}")
_MACHINE: Final = {"backend_not_found", "missing_package", "not_comparable", "recording_unreadable", "unknown_format"}
"""Codes of errors that say something of the verifier's machine, and nothing of the entry."""
_LAST_BITS: Final = 1e-9
"""How far apart numbers may be, relatively, of which an expression made other last bits from the same worlds."""


@dataclass(frozen=True, slots=True)
class Player:
    """One of several creatures of an entry on a task with roles.

    Attributes:
        role: What it plays; empty where the roles are interchangeable, and everybody plays all of them.
        name: The genome's name.
        genome_hash: SHA-256 of the genome, hexadecimal.
        creature_hash: SHA-256 of what of the genome acts, hexadecimal.
        score: The mean of its scores over the matches.
        spread: Their standard deviation, as of a whole population.
        places: Its place in each match, from 0, the best.
    """

    role: str
    name: str
    genome_hash: str
    creature_hash: str
    score: float
    spread: float
    places: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Entry:
    """One line of a leaderboard.

    Attributes:
        id: Its number in the file.
        task: The task's name.
        task_hash: SHA-256 of the task, hexadecimal.
        name: The genome's name; of several creatures all of them.
        genome_hash: SHA-256 of the genome, hexadecimal; of several over their hashes, a line each.
        creature_hash: SHA-256 of what of the genome acts, hexadecimal (see `nmes.evaluation.identity`); of several over
            their hashes, a line each.
        author: Who made the genome, as it says itself; empty where it does not, and of several.
        key: SHA-256 of the Ed25519 public key that signed all of its recordings, hexadecimal; empty where none did.
        score: The mean over the task's seeds, in whatever the task's objective measures; of several over them too.
        spread: Standard deviation of the scores over the recordings, as of a whole population.
        players: Each of several creatures, in the order of the roles; empty on a task for one.
        recordings: SHA-256 of the recordings' files, hexadecimal, one a seed of the task, in its order; on a task with
            roles one for each match.
        recorded: When the last recording was closed, as the clock of who made it had it: UTC, ISO 8601.
        broken: Why its proof was found not to hold, if that was written down; else None.
    """

    id: int
    task: str
    task_hash: str
    name: str
    genome_hash: str
    creature_hash: str
    author: str
    key: str
    score: float
    spread: float
    players: tuple[Player, ...]
    recordings: tuple[str, ...]
    recorded: str
    broken: str | None

    @property
    def recording_hash(self) -> str:
        """One hash for all recordings: the file's own, or SHA-256 over the files' hashes, a line each."""
        if len(self.recordings) == 1:
            return self.recordings[0]
        return _over(self.recordings)

    @property
    def title(self) -> str:
        """The name; of several creatures each with its role and score."""
        told = (f"{player.role} {player.name} {player.score:.6g}".lstrip() for player in self.players)
        return ", ".join(told) or self.name

    @property
    def task_title(self) -> str:
        """The task's name and, where it is that of a task that ships and this is another, that it is."""
        return task_title(self.task, self.task_hash)

    @property
    def signed_author(self) -> str:
        """The author, and whose signature vouches for that; empty where there is neither."""
        if not self.author and not self.key:
            return ""
        return f"{self.author} ({f'key {self.key[:16]}' if self.key else 'unsigned'})".lstrip()

    def to_json(self) -> dict[str, Any]:
        """Returns the entry as plain data."""
        players = [asdict(player) for player in self.players]
        plain = {**{name: getattr(self, name) for name in self.__slots__}, "players": players}
        return {**plain, "recording_hash": self.recording_hash}


_KINDS: Final = {"id": (int,), "score": (float,), "spread": (float,), "broken": (str, type(None))}
COLUMNS: Final = Entry.__slots__
"""The columns of a row, in the order of the table."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """The judgement of one entry.

    Attributes:
        id: The entry's number in the file.
        task: The name of its task, as the row has it; empty where it cannot be read.
        name: That of its genome, likewise.
        verdict: `holds`; `broken`: it says what its recordings do not prove; or `not_judged`: this machine cannot tell.
        reason: Why it does not hold; None where it does.
    """

    id: int
    task: str
    name: str
    verdict: Literal["holds", "broken", "not_judged"]
    reason: str | None = None

    def to_json(self) -> dict[str, Any]:
        """Returns the verdict as plain data."""
        return {name: getattr(self, name) for name in self.__slots__}


def read_row(row: Sequence[Any]) -> Entry:
    """Reads a row of the table, whatever somebody has put there.

    Raises:
        ValueError: It is none that a leaderboard writes.
    """
    fields: dict[str, Any] = dict(zip(COLUMNS, row, strict=True))
    for name, value in fields.items():
        kinds: tuple[type, ...] = _KINDS.get(name, (str,))
        if not isinstance(value, kinds) or (name.endswith("_hash") and not _HASH.fullmatch(str(value))):
            raise ValueError(f"{name} holds what no leaderboard writes")
    if not math.isfinite(fields["score"]) or not math.isfinite(fields["spread"]):
        raise ValueError("the score or its spread is no finite number")
    names = orjson.loads(fields["recordings"])
    if not isinstance(names, list) or not names or not all(isinstance(n, str) and _HASH.fullmatch(n) for n in names):
        raise ValueError("recordings holds what no leaderboard writes")
    return Entry(**{**fields, "recordings": tuple(names), "players": _read_players(fields["players"])})


def _read_players(text: str) -> tuple[Player, ...]:
    values = orjson.loads(text)
    sound = isinstance(values, list) and all(_is_player(value) for value in values)
    if not sound or len({len(value["places"]) for value in values}) > 1:  # all have played the same matches
        raise ValueError("players holds what no leaderboard writes")
    return tuple(Player(**{**value, "places": tuple(value["places"])}) for value in values)


def _is_player(value: Any) -> bool:
    kinds = {"score": float, "spread": float, "places": list}
    return (
        isinstance(value, dict)
        and {*value} == {*Player.__slots__}
        and all(isinstance(item, kinds.get(name, str)) for name, item in value.items())
        and all(type(place) is int for place in value["places"])
    )


def proved(path: str | os.PathLike[str]) -> AnyProof:
    """Runs a recorded episode or match again, the brains beside it; see `prove` and `prove_match`."""
    return prove_match(path, brain=True) if is_match(Recording(path)) else prove(path, brain=True)


def told(path: str | os.PathLike[str]) -> tuple[Task | MatchTask, tuple[Genome, ...]]:
    """Returns the task and the creatures that a recording says it is of; nothing is run.

    Raises:
        RecordingError, ProofError, DocumentError: As by `prove`.
    """
    recording = Recording(path)
    if is_match(recording):
        match, genomes, _seed = recorded_match(recording)
        return match, tuple(genomes.values())
    task, genome, _seed = recorded_episode(recording)
    return task, (genome,)


def group(proof: AnyProof) -> tuple[str, ...]:
    """Returns the hashes that the proofs of one entry have in common: of the task and of the creatures."""
    if isinstance(proof, MatchProof):
        return (proof.task.hash, *(genome.hash for genome in _cast(proof)))
    return (proof.task.hash, proof.genome.hash)


def facts(proofs: Sequence[AnyProof]) -> dict[str, Any]:
    """Returns all that proofs say of an entry: the values of its columns, by name, but for `id` and `broken`.

    Args:
        proofs: Of one genome on one task: one for each of its seeds, in any order. Or of the same genomes on one task
            with roles: one for each match of each of its seeds.

    Raises:
        LeaderboardError: They are of several genomes or tasks, or not one a seed (`incomplete`), or an episode has no
            score (`no_score`).
        SigningError: A signature beside a recording is none of it.
    """
    matches = [proof for proof in proofs if isinstance(proof, MatchProof)]
    episodes = [proof for proof in proofs if isinstance(proof, Proof)]
    if matches and episodes:
        raise _incomplete(proofs[0])
    return _facts_of_matches(matches) if matches else _facts_of_episodes(episodes)


def _facts_of_episodes(proofs: Sequence[Proof]) -> dict[str, Any]:
    task, genome = proofs[0].task, proofs[0].genome
    by_seed = {proof.result.seed: proof for proof in proofs}
    same = all((proof.task.hash, proof.genome.hash) == (task.hash, genome.hash) for proof in proofs)
    if not same or sorted(by_seed) != sorted(task.seeds) or len(proofs) != len(by_seed):
        raise _incomplete(proofs[0])
    ordered = [by_seed[seed] for seed in task.seeds]
    scores = [proof.result.score for proof in ordered if proof.result.score is not None]
    if len(scores) < len(ordered):
        reason = next(proof.result.fault for proof in ordered if proof.result.score is None)
        what = f"{genome.name!r} on {task.name}: an episode has no score ({reason})"
        raise LeaderboardError("no_score", what)
    return {
        "name": genome.name,
        "genome_hash": genome.hash,
        "creature_hash": creature_hash(genome, task),
        "author": str(genome.document.get("author", "")),
        "players": (),
        **_common(ordered, scores),
    }


def _common(proofs: Sequence[AnyProof], scores: Sequence[float]) -> dict[str, Any]:
    """Returns the fields of an entry, of one creature or several; the proofs are in order, each with its score."""
    keys = {signer(Recording(proof.path)) for proof in proofs}
    return {
        "task": proofs[0].task.name,
        "task_hash": proofs[0].task.hash,
        "key": keys.pop() if len(keys) == 1 else "",
        "score": mean(scores),
        "spread": pstdev(scores),
        "recordings": tuple(proof.recording_hash for proof in proofs),
        "recorded": max(proof.recorded for proof in proofs),
    }


def _facts_of_matches(proofs: Sequence[MatchProof]) -> dict[str, Any]:
    task, cast = proofs[0].task, _cast(proofs[0])
    wanted = {
        (seed, tuple(cast[number].hash for number in way)): way for seed in task.seeds for way in task.sides(seed)
    }
    played = {(proof.seed, tuple(proof.genomes[role].hash for role in task.roles)): proof for proof in proofs}
    same = all(proof.task.hash == task.hash for proof in proofs)
    if not same or played.keys() != wanted.keys() or len(proofs) != len(played):
        raise _incomplete(proofs[0])
    scores: list[list[float]] = [[] for _ in cast]
    ranks: list[list[int]] = [[] for _ in cast]
    for key, way in wanted.items():
        placed = places(played[key].results, task.margin) or {}
        for number, (role, result) in zip(way, played[key].results.items(), strict=True):
            if result.score is None:
                what = f"{cast[number].name!r} as {role} on {task.name}: a match has no score ({result.fault})"
                raise LeaderboardError("no_score", what)
            scores[number].append(result.score)
            ranks[number].append(placed[role])
    players = tuple(
        Player(
            "" if task.interchangeable else role,
            genome.name,
            genome.hash,
            creature_hash(genome, task),
            mean(own),
            pstdev(own),
            tuple(placed),
        )
        for role, genome, own, placed in zip(task.roles, cast, scores, ranks, strict=True)
    )
    means = [mean(match) for match in zip(*scores, strict=True)]
    return {
        "name": ", ".join(player.name for player in players),
        "genome_hash": _over(player.genome_hash for player in players),
        "creature_hash": _over(player.creature_hash for player in players),
        "author": "",  # a signature is of who recorded the matches, and vouches for no creature of somebody else
        "players": players,
        **_common([played[key] for key in wanted], means),
    }


def _cast(proof: MatchProof) -> tuple[Genome, ...]:
    """Returns the creatures in the order of the roles; where those are interchangeable, the same for all matches."""
    genomes = tuple(proof.genomes.values())
    if not proof.task.interchangeable:
        return genomes
    turns = [(*genomes[turn:], *genomes[:turn]) for turn in range(len(genomes))]
    return min(turns, key=lambda turn: [(creature_hash(genome, proof.task), genome.hash) for genome in turn])


def _over(hashes: Iterable[str]) -> str:
    return sha256("".join(f"{each}\n" for each in hashes).encode()).hexdigest()


def _incomplete(proof: AnyProof) -> LeaderboardError:
    seeds = ", ".join(map(str, proof.task.seeds))
    if isinstance(proof, MatchProof):
        names = ", ".join(genome.name for genome in proof.genomes.values())
        sides = ", played from every side" if proof.task.interchangeable else ""
        what = f"{names} on {proof.task.name}: it takes the recordings of all matches with the seeds {seeds}{sides}"
    else:
        what = f"{proof.genome.name!r} on {proof.task.name}: it takes one recording for each of the seeds {seeds}"
    return LeaderboardError("incomplete", what)


def examine(work: tuple[Entry, Sequence[Path]]) -> Verdict:
    """Runs an entry's recordings again, and compares all that they prove with what it says; it never raises.

    Args:
        work: The entry, and the files of its recordings, in its order.
    """
    entry, paths = work
    verdict: Literal["holds", "broken", "not_judged"]
    try:
        proofs = _proved_again(entry, paths)
        differing = _differences(entry, facts(proofs))
        verdict, reason = "broken" if differing else "holds", _told(differing)
        nearly = all(_nearly(listed, value) for listed, value in differing.values())
        if differing and nearly and any(map(_recorded_otherwise, proofs)):
            # The worlds came out alike, and what an expression makes of them may still have another last bit.
            verdict, reason = "not_judged", f"it was recorded with another probe: {reason}"
    except NmesError as error:
        verdict, reason = ("not_judged" if error.code in _MACHINE else "broken"), error.message
    except Exception as error:  # a disk, the memory, a mistake of ours: in no case the entry's fault that is proved
        verdict, reason = "not_judged", f"{type(error).__name__}: {error}"
    return Verdict(entry.id, entry.task, entry.name, verdict, reason or None)


def _recorded_otherwise(proof: AnyProof) -> bool:
    """Whether a proof was recorded where other last bits are computed."""
    engine = proof.task.world_config(proof.task.seeds[0])["backend"]
    return bool(fingerprint_differences(engine, proof.fingerprint))


def _proved_again(entry: Entry, paths: Sequence[Path]) -> list[AnyProof]:
    if len({*entry.recordings}) < len(entry.recordings):  # each is of another seed or match
        raise LeaderboardError("changed", "it names a recording twice")
    for path, expected in zip(paths, entry.recordings, strict=True):
        if not path.is_file():
            raise LeaderboardError("changed", f"there is no recording {path}")
        with path.open("rb") as file:
            if file_digest(file, "sha256").hexdigest() != expected:
                raise LeaderboardError("changed", f"{path} is not the recording that was listed")
        task_hash = told(path)[0].hash
        if task_hash != entry.task_hash:  # known before it is run, which may take as long as its task says
            raise LeaderboardError("changed", f"task_hash: listed {entry.task_hash!r}, {path} is of {task_hash!r}")
    first = proved(paths[0])
    if len(paths) > len(first.task.seeds) * max(len(entry.players), 1):  # counted before thousands of them are run
        raise _incomplete(first)
    return [first, *(proved(path) for path in paths[1:])]


def _differences(entry: Entry, proved: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Compares an entry with its recordings; returns by column what is listed and what is proved, where they differ."""
    pairs = ((name, getattr(entry, name), value) for name, value in proved.items())
    return {name: (listed, value) for name, listed, value in pairs if listed != value}


def _nearly(listed: Any, proved: Any) -> bool:
    """Whether two values of a column, or of a part of one, differ in last bits of numbers alone."""
    if isinstance(proved, float):
        return math.isclose(listed, proved, rel_tol=_LAST_BITS, abs_tol=_LAST_BITS)
    if isinstance(proved, Player):
        return _nearly(astuple(listed), astuple(proved))
    if isinstance(proved, tuple):
        return len(listed) == len(proved) and all(map(_nearly, listed, proved))
    return bool(listed == proved)


def _told(differing: Mapping[str, tuple[Any, Any]]) -> str:
    return "; ".join(f"{name}: listed {was!r}, proved {value!r}" for name, (was, value) in differing.items())
