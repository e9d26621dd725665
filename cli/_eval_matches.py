"""The matches of `nmes eval`: creatures in the roles of a task, played with a progress bar, or read from recordings."""

from __future__ import annotations

import signal
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import click

from nmes.cli._interruptions import interruptions
from nmes.cli._progress import progress_bars
from nmes.errors import DocumentError, NmesError, visible
from nmes.evaluation import Evaluation, MatchProof, MatchTask, prove_match
from nmes.evaluation.bouts import Bout, play_bouts
from nmes.evaluation.match import MatchResult, admit_players, recording_name
from nmes.evaluation.parallel import open_pool
from nmes.genome import Genome
from nmes.genome.genome import SHIPPED
from nmes.recording.signed import require_unsigned

__all__ = ["read_creature", "score_matches", "score_recorded_matches"]


def read_creature(name: str) -> Genome:
    """Returns the genome of a file, or the one of that name that ships.

    Raises:
        ClickException: It is none.
    """
    try:
        return Genome.parse(SHIPPED.read(name))
    except DocumentError as error:
        raise click.ClickException(f"{name}:\n{error.message}") from error


def score_matches(
    files: Sequence[str],
    task: MatchTask,
    seeds: Sequence[int] | None,
    record: Path | None,
    jobs: int | None,
    ray: str | None,
) -> tuple[list[Evaluation], bool]:
    """Plays creatures in the roles of a task, in their order, and in all places where roles are interchangeable.

    Returns:
        An evaluation of each, in their order, and whether all matches were played.

    Raises:
        UsageError: There are not as many creatures as roles.
        ClickException: One of them is no creature, or may not play.
        RecordingError: A recording would replace one that is signed (`signed`): nothing was played.
    """
    names = ", ".join(task.roles)
    if len(files) != len(task.roles):
        count = f"{len(files)} {'is' if len(files) == 1 else 'are'} named"
        raise click.UsageError(f"{task.name} has the roles {names}: it takes {len(task.roles)} genomes, and {count}")
    genomes = [read_creature(name) for name in files]
    chosen = task.seeds if seeds is None else seeds
    casts = [(side, seed) for seed in chosen for side in task.sides(seed)]
    for side in dict.fromkeys(side for side, _ in casts):
        _check(task, {role: genomes[number] for role, number in zip(task.roles, side, strict=True)})
    if record is not None:
        record.mkdir(parents=True, exist_ok=True)
        for side, seed in casts:
            cast = {role: genomes[number] for role, number in zip(task.roles, side, strict=True)}
            require_unsigned(record / recording_name(task, cast, seed))
    folder = None if record is None else str(record)
    bouts = [
        Bout.of(task, {role: genomes[number] for role, number in zip(task.roles, side, strict=True)}, seed, folder)
        for side, seed in casts
    ]
    results = _play(bouts, jobs, ray)
    played: list[list[tuple[str, MatchResult]]] = [[] for _ in genomes]
    for index in sorted(results):
        for role, number in zip(task.roles, casts[index][0], strict=True):
            played[number].append((role, results[index]))
    evaluations = [Evaluation.of_matches(*each) for each in zip(genomes, [task] * len(genomes), played, strict=True)]
    return evaluations, len(results) == len(bouts)


def _check(task: MatchTask, genomes: dict[str, Genome]) -> None:
    try:
        admit_players(task, genomes)
    except NmesError as error:
        raise click.ClickException(f"{task.name}: {error.message}") from error


def _play(bouts: Sequence[Bout], jobs: int | None, ray: str | None) -> dict[int, MatchResult]:
    """Plays matches until all are played, or Ctrl-C."""
    results: dict[int, MatchResult] = {}
    try:
        with (
            progress_bars() as progress,
            interruptions(signal.SIGINT, signal.SIGTERM) as interrupted,
            open_pool(jobs, ray) as pool,
        ):
            for index, result in play_bouts(pool, bouts, partial(progress, "playing")):
                results[index] = result
                if interrupted():
                    raise KeyboardInterrupt
    except KeyboardInterrupt:
        click.echo(f"stopped: {len(results)} of {len(bouts)} matches played", err=True)
    return results


def score_recorded_matches(recordings: Sequence[Path]) -> list[Evaluation]:
    """Returns the evaluation of each creature on each task by recordings of matches, in their order of coming up."""
    played: dict[tuple[str, str], tuple[Genome, MatchTask, list[tuple[str, MatchResult]]]] = {}
    proofs: list[MatchProof] = []
    for path in recordings:
        proof = prove_match(path)
        match = proof.task.hash, proof.seed, {role: genome.hash for role, genome in proof.genomes.items()}
        for other in proofs:
            if match == (other.task.hash, other.seed, {role: genome.hash for role, genome in other.genomes.items()}):
                raise click.UsageError(visible(f"{other.path} and {path} are of the same match: it counts once"))
        proofs.append(proof)
        for role, genome in proof.genomes.items():
            key = genome.hash, proof.task.hash
            group = played.setdefault(key, (genome, proof.task, []))
            group[2].append((role, MatchResult(proof.seed, proof.results, proof.path)))
    return [Evaluation.of_matches(*group) for group in played.values()]
