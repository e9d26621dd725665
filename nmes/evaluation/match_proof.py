"""Proof of a match: a recorded one, run again and scored from its log alone.

Invariant: what `prove_match` returns was reproduced tick by tick, in the very world of the task, and nothing but the
motors of the creatures in its roles was touched.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice

from nmes import protocol
from nmes.backend import Array
from nmes.errors import ProofError, WorldError
from nmes.evaluation.again import has_model
from nmes.evaluation.episode import brain_of
from nmes.evaluation.judge import Result
from nmes.evaluation.match import Match, check_players
from nmes.evaluation.match_task import METADATA, MatchTask
from nmes.evaluation.proof import closed, digest, follow
from nmes.genome import Genome
from nmes.recording import Kind, Recording
from nmes.schemas.documents import parse_document
from nmes.world import World

__all__ = ["MatchProof", "is_match", "match_scores_so_far", "prove_match", "recorded_match"]


@dataclass(frozen=True, slots=True)
class MatchProof:
    """What a recording proves: how one match came out.

    Attributes:
        genomes: The creature of each role.
        task: The task.
        seed: The match's.
        results: Of each role, computed from the log.
        path: The recording.
        recording_hash: SHA-256 of the file, hexadecimal.
        fingerprint: What the last bits depend on.
        recorded: When the recording was closed by the clock of who made it: UTC, ISO 8601, to the second.
    """

    genomes: Mapping[str, Genome]
    task: MatchTask
    seed: int
    results: Mapping[str, Result]
    path: str
    recording_hash: str
    fingerprint: Mapping[str, str]
    recorded: str


def prove_match(recording: str | os.PathLike[str], *, brain: bool = False) -> MatchProof:
    """Runs a recorded match again and scores it, from its log alone.

    The commands must be those that set up the task's world with these creatures in their roles, and then only drive
    their motors.

    Args:
        recording: The file.
        brain: Compare the controls too with what the genomes' brains give; else they may come from anywhere.

    Raises:
        RecordingError: It cannot be read.
        ProofError: It proves nothing: it is no recorded match (`not_an_evaluation`), ends too early (`damaged`), or
            something in it comes out otherwise, or was done otherwise, than recorded (`diverged`, or `not_comparable`
            where that may be for the machine or the versions); the message has the frame.
        DocumentError: Its task or a genome is not as it must be, or with `brain` a brain.
        MissingPackage: A brain, which is to be compared, needs a package that is not installed.
    """
    source = Recording(recording)
    match, task, genomes, seed = _check(source, brain)
    results, told = match.results(), (str(recording), digest(recording), source.fingerprint, closed(source))
    return MatchProof(genomes, task, seed, results, *told)


def match_scores_so_far(recording: Recording) -> dict[str, Array]:
    """Returns the score that each role would have had at each tick, had the match ended there.

    Args:
        recording: The match's. It is run again as by `prove_match`.

    Returns:
        Of each role, array (n, 2) of times since the recording began, s, and of values; where there is none, NaN.

    Raises:
        RecordingError, ProofError, DocumentError: As by `prove_match`.
    """
    match, task, _genomes, _seed = _check(recording, False)
    return {role: match.scores_so_far(role) for role in task.roles}


def is_match(recording: Recording) -> bool:
    """Whether a recording says that it is one of a match."""
    return METADATA in recording.metadata


def _check(recording: Recording, brain: bool) -> tuple[Match, MatchTask, dict[str, Genome], int]:
    task, genomes, seed = recorded_match(recording)
    try:
        check_players(task, genomes)  # whoever recorded it need not have asked
    except WorldError as error:
        raise ProofError("not_an_evaluation", f"{recording.path}: {error.message}") from error
    brains = {role: brain_of(genomes[role]) for role in task.roles} if brain else {}

    def make(world: World) -> Match:
        return Match(world, genomes, brains, task, seed, logged=not brain)

    models = {role for role, genome in genomes.items() if brain and has_model([genome.document])}
    return follow(recording, task.world_config(seed), make, models), task, genomes, seed


def recorded_match(recording: Recording) -> tuple[MatchTask, dict[str, Genome], int]:
    """Returns the task, the creatures and the seed that a recording says it is of.

    Raises:
        ProofError: It is no recorded match (`not_an_evaluation`).
        DocumentError: Its task or a genome is not as it must be.
    """
    about = recording.metadata.get(METADATA)
    if about is None or not {"task", "seed"} <= about.keys():
        raise ProofError("not_an_evaluation", f"{recording.path} is no recording of a match of `nmes eval`")
    task = MatchTask(parse_document(about["task"].encode()))
    if not re.fullmatch("0|[1-9][0-9]{0,18}", about["seed"]):
        raise ProofError("not_an_evaluation", f"{recording.path} names no seed, but {about['seed'][:40]!r}")
    spawned = dict(_spawned(recording, len(task.prop_ids()) + 2 * len(task.roles)))
    if list(spawned) != list(task.roles):
        raise ProofError("not_an_evaluation", f"{recording.path} does not begin with the roles of {task.name}")
    return task, spawned, int(about["seed"])


def _spawned(recording: Recording, most: int) -> Iterator[tuple[str, Genome]]:
    """Yields the names and genomes of the creatures that the first commands of a recording make.

    Args:
        recording: The recording.
        most: How many commands set the scene: the props, and at most two for each role.
    """
    commands = (protocol.parse(record.data).command for record in recording if record.kind is Kind.COMMAND)
    for command in islice(commands, most):
        if command is not None and command["type"] == "spawn_creature":
            yield str(command.get("name")), Genome(command["genome"])
