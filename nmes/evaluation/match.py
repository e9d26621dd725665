"""Matches: creatures set down in one world, each in a role, sensed, driven and ticked until the task says stop.

    results = play("sumo", {"red": "walker", "blue": "seeker"}, record="proofs")
    results[0].results["red"].score

A match is an episode of several creatures: its steps are the world's ordinary inputs, so that its recording replays
like any other, without the brains. At each tick all creatures sense before any is driven, in the order of the roles.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Generator, Iterable, Mapping
from dataclasses import dataclass, field
from hashlib import blake2b
from pathlib import Path
from typing import SupportsIndex

import numpy as np
import orjson

from nmes import protocol
from nmes.backend import Array
from nmes.brain import Brain
from nmes.errors import MACHINE_ERRORS, NmesError, RecordingError, WorldError
from nmes.evaluation.episode import brain_of
from nmes.evaluation.evaluator import file_name, recorded
from nmes.evaluation.judge import Result
from nmes.evaluation.match_task import METADATA, MatchTask, MatchTaskLike
from nmes.evaluation.referee import Referee, culprit, void_results
from nmes.evaluation.seeding import read_seeds
from nmes.evaluation.steps import ANY_CONTROLS, Drive, Step, perform, settle
from nmes.genome import Genome
from nmes.genome.genome import GenomeLike
from nmes.recording import Recorder
from nmes.world import World
from nmes.world.creature import Creature

__all__ = ["Match", "MatchResult", "admit_players", "check_players", "play", "play_match"]


@dataclass(frozen=True, slots=True)
class MatchResult:
    """How one match came out.

    Attributes:
        seed: The match's.
        results: Of each role.
        recording: The file of its recording; None where none was made.
        wall_seconds: How long it took, s.
    """

    seed: int
    results: Mapping[str, Result]
    recording: str | None = field(default=None, compare=False)
    wall_seconds: float = field(default=0.0, compare=False)


class Match:
    """One run of several creatures on a task with roles, in a world of their own.

    Args:
        world: The world, new and empty, with the config that the task has for the seed.
        genomes: The creatures, by role.
        brains: What drives them, by role; None for one that does not move, and for all that are driven by a log.
        task: What is played.
        seed: The world's, of what the task draws, and of what the brains do.
        logged: Whether it is a log that drives the creatures.
    """

    def __init__(
        self,
        world: World,
        genomes: Mapping[str, Genome],
        brains: Mapping[str, Brain | None],
        task: MatchTask,
        seed: int,
        *,
        logged: bool = False,
    ) -> None:
        self._world, self._task, self._seed, self._logged = world, task, seed, logged
        self._genomes = {role: genomes[role] for role in task.roles}
        self._brains = brains
        self._restless: dict[str, str] = {}
        self._referee: Referee | None = None
        self._start = 0  # the frame
        self._results: dict[str, Result] | None = None

    def run(self) -> dict[str, Result]:
        """Runs all of it; returns the result of each role.

        Raises:
            WorldError: The world refuses a command that sets the scene.
        """
        client = self._world.join()
        perform(self._world, client, self.steps())
        self._world.leave(client)
        return self.results()

    def steps(self) -> Generator[Step, None, None]:
        """Yields the match's steps; each must be done before the next is asked for."""
        referee, world, task = (yield from self._set_scene()), self._world, self._task
        if referee is None:
            return
        players, block = self._players(), task.tick_rate
        for tick in range(task.ticks):
            yield from [player.drive(tick) for player in players]
            yield None
            if world.fault is not None:
                referee.look()
                return
            referee.note()
            # How it was at a tick is looked at a second later, many ticks at a time; what came after is dropped.
            if ((tick + 1) % block == 0 or tick + 1 == task.ticks) and referee.look():
                return

    def _set_scene(self) -> Generator[Step, None, Referee | None]:
        """Yields the steps before the start; returns the referee, who has looked at it, if the match goes on."""
        world, task = self._world, self._task
        _, restless = yield from settle(world, task, list(task.roles), task.entry(self._seed, self._genomes))
        if world.fault is not None and culprit(world, task) is None:
            return None
        referee = self._referee = Referee(world, task, self._seed)
        self._start = world.frame
        if world.fault is not None:
            referee.look_at_failed_start()
            return None
        self._restless = restless
        referee.note()
        referee.look()
        return None if restless else referee

    def _players(self) -> list[_Player]:
        players = []
        for role, genome in self._genomes.items():
            brain, creature = self._brains.get(role), self._world.creature(role)
            if self._logged:
                players.append(_Player(creature, None, "brain" not in genome.document))
            elif brain is not None:
                brain.reset(self._seed, 1.0 / self._task.tick_rate)
                players.append(_Player(creature, brain))
        return players

    def results(self) -> dict[str, Result]:
        """Returns the result of each role, once all steps are done."""
        if self._results is None:
            self._results = self._judged()
        return self._results

    def _judged(self) -> dict[str, Result]:
        if self._referee is None:
            fault = self._world.fault
            assert fault is not None  # or there would be a referee
            return void_results(self._task, self._seed, f"{fault.code}: {fault.message}")
        return self._referee.results(self._restless)

    def scores_so_far(self, role: str) -> Array:
        """Returns a role's objective at the start and after each tick; where it has no value, NaN.

        Returns:
            Array (n, 2) of times since the world began, s, and of values.
        """
        if self._referee is None:
            return np.zeros((0, 2))
        values = self._referee.trajectories.values_so_far(self._task.roles[role].objective)
        return np.stack([(self._start + np.arange(len(values))) / self._task.tick_rate, values], axis=1)


class _Player:
    """A creature and what drives it: its brain, or whatever a log says."""

    def __init__(self, creature: Creature, brain: Brain | None, optional: bool = False) -> None:
        self._creature, self._brain, self._optional = creature, brain, optional

    def drive(self, tick: int) -> Drive:
        """Returns the step that drives the creature at a tick, given what it senses now."""
        if self._brain is None:
            return Drive(self._creature.name, ANY_CONTROLS, self._optional)
        return Drive(self._creature.name, self._brain.step(self._creature.sense()))


def play(
    task: MatchTaskLike,
    genomes: Mapping[str, GenomeLike],
    *,
    seeds: Iterable[SupportsIndex] | None = None,
    record: str | os.PathLike[str] | None = None,
) -> list[MatchResult]:
    """Plays a match for each seed, with each creature in its role, in this process.

    Args:
        task: A task with roles: a MatchTask, a document, a file, or the name of one that ships.
        genomes: The creature of each role, told likewise.
        seeds: Instead of the task's.
        record: An existing directory, in which a recording of each match is left.

    Returns:
        A result for each seed, in their order.

    Raises:
        DocumentError: A genome is none, or the task.
        WorldError: A role has no creature, there is no such role, or a creature may not play its role (`invalid`).
        TypeError: A seed is no whole number.
        RecordingError: A recording cannot be written.
    """
    asked = MatchTask.load(task)
    players = {role: Genome.load(genome) for role, genome in genomes.items()}
    brains = admit_players(asked, players)
    chosen = asked.seeds if seeds is None else read_seeds(seeds)
    folder = None if record is None else Path(record)
    return [play_match(asked, players, brains, seed, folder) for seed in chosen]


def admit_players(task: MatchTask, genomes: Mapping[str, Genome]) -> dict[str, Brain | None]:
    """Returns the brains of creatures that may play their roles.

    Raises:
        DocumentError: A brain is not as it must be, or does not fit its body.
        WorldError: As by `check_players`.
    """
    check_players(task, genomes)
    return {role: brain_of(genomes[role]) for role in task.roles}


def check_players(task: MatchTask, genomes: Mapping[str, Genome]) -> None:
    """Refuses creatures whose bodies may not play their roles.

    Raises:
        WorldError: They may not (`invalid`); the message has every reason.
    """
    if {*genomes} != {*task.roles}:
        what = f"{task.name} has the roles {', '.join(task.roles)}, each with one creature"
        raise WorldError("invalid", f"{what}; there are creatures for {', '.join(genomes) or 'none'}")
    reasons = [f"{role}: {reason}" for role in task.roles for reason in task.check(role, genomes[role].body)]
    if reasons:
        raise WorldError("invalid", "; ".join(reasons))


def play_match(
    task: MatchTask, genomes: Mapping[str, Genome], brains: Mapping[str, Brain | None], seed: int, folder: Path | None
) -> MatchResult:
    """Plays one match of creatures that may play their roles; recorded in a folder, if one is given.

    Raises:
        WorldError: They cannot be set down.
        RecordingError: The recording cannot be written, or would replace one that is signed (`signed`).
    """
    begin = time.perf_counter()
    try:
        if folder is None:
            return MatchResult(seed, _run(task, genomes, brains, seed, None), None, time.perf_counter() - begin)
        path = folder / recording_name(task, genomes, seed)
        with recorded(path, match_metadata(task, genomes, seed)) as journal:
            results = _run(task, genomes, brains, seed, journal)
        return MatchResult(seed, results, str(path), time.perf_counter() - begin)
    except (NmesError, *MACHINE_ERRORS):
        raise
    except Exception as failure:  # of an engine, an expression, a brain: this match's, and no other's
        return MatchResult(seed, void_results(task, seed, f"failed: {type(failure).__name__}: {failure}"))


def _run(
    task: MatchTask,
    genomes: Mapping[str, Genome],
    brains: Mapping[str, Brain | None],
    seed: int,
    journal: Callable[[World], Recorder] | None,
) -> dict[str, Result]:
    world = World(task.world_config(seed))
    try:
        if journal is not None:
            world.journal = journal(world)
        results = Match(world, genomes, brains, task, seed).run()
    except WorldError:  # which the players may have no part in
        _require_machine(world)
        raise
    finally:
        world.close()
    _require_machine(world)
    return results


def _require_machine(world: World) -> None:
    """Raises what a world failed of, where that says nothing of the players: a full disk, too little memory."""
    if world.fault is not None and world.fault.code == "recording_failed":
        raise RecordingError(world.fault.code, world.fault.message)
    if world.fault is not None and isinstance(world.fault.cause, MACHINE_ERRORS):
        raise world.fault.cause


def recording_name(task: MatchTask, genomes: Mapping[str, Genome], seed: int) -> str:
    """Returns the name of the file of a match's recording: the same for the same match, and no other's."""
    names = "-".join(file_name(genomes[role].name)[:20] for role in task.roles)[:80]
    cast = blake2b("".join(genomes[role].hash for role in task.roles).encode(), digest_size=8).hexdigest()
    return f"{names}-{cast}-{task.name}-{task.hash[:16]}-{seed}.mcap"


def match_metadata(task: MatchTask, genomes: Mapping[str, Genome], seed: int) -> dict[str, dict[str, str]]:
    """Returns the metadata records of a match's recording."""
    hashes = orjson.dumps({role: genomes[role].hash for role in task.roles}).decode()
    return {METADATA: {"task": protocol.encode(task.document).decode(), "genomes": hashes, "seed": str(seed)}}
