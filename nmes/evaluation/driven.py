"""Scenes whose creature is driven from outside: alone in a world, or side by side as rows of an engine.

Hides how a scene is set, how it is handed over to an engine as a row, and what of it a judge must be told.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from nmes import protocol
from nmes.backend import Array, BodyState, CameraSpec, Image, Places, Row
from nmes.errors import WorldError
from nmes.evaluation.balance import Balance
from nmes.evaluation.cohort import PlaceOfRows
from nmes.evaluation.episode import Episode
from nmes.evaluation.judge import Watched
from nmes.evaluation.task import CREATURE, Task
from nmes.genome import Genome
from nmes.objective.trajectory import Flags, touches
from nmes.world import World
from nmes.world.creature import Creature
from nmes.world.creature_rows import CreatureRows

if TYPE_CHECKING:
    from nmes.world.journal import Journal

__all__ = ["DrivenWorld", "EngineRows", "Parts", "Scene", "Start"]


@dataclass(frozen=True, eq=False, slots=True)
class Parts:
    """What a judge is told of a moment: arrays with the same leading axes.

    Attributes:
        states: Of the bodies, (..., n, 13), as `Simulation.states`.
        powers: Of the motors in the tick that led there, (..., 2, m), as `Simulation.powers`.
        positions: Of the joints with springs, (..., s), rad or m.
    """

    states: Array
    powers: Array
    positions: Array

    @classmethod
    def zeros(cls, lead: tuple[int, ...], watched: Watched) -> Parts:
        """Returns parts of as many bodies, motors and joints as are watched."""
        bodies, springs, motors = map(len, watched)
        return cls(np.zeros((*lead, bodies, 13)), np.zeros((*lead, 2, motors)), np.zeros((*lead, springs)))

    def at(self, index: int) -> Parts:
        """Returns a view of one place of the first axis."""
        return Parts(self.states[index], self.powers[index], self.positions[index])


@dataclass(frozen=True, eq=False, slots=True)
class Start:
    """The moment from which on an episode is scored.

    Attributes:
        seed: The episode's.
        balance: Of the energy of the creature and of the task's props.
        states: Of the bodies, array (n, 13).
        positions: Of the joints with springs, array (s,), rad or m.
        touches: What touches what, array (n, 2), as `Trajectory.touches`; without rows where nobody asks.
        energy: Of all bodies, J.
    """

    seed: int
    balance: Balance
    states: Array
    positions: Array
    touches: Flags
    energy: float


class DrivenWorld:
    """An episode in a world of its own, at its start, which somebody else drives.

    Attributes:
        creature: The creature.
        watched: What its judge is told of.
    """

    def __init__(
        self, genome: Genome, task: Task, seed: int, journal: Callable[[World], Journal] | None = None
    ) -> None:
        """Sets the scene.

        Args:
            genome: The creature.
            task: What it is asked to do.
            seed: The episode's.
            journal: Makes the world's journal, if it is to have one.

        Raises:
            WorldError: The creature cannot begin.
        """
        self._world = world = World(task.world_config(seed))
        if journal is not None:
            world.journal = journal(world)
        self._task, self._seed = task, seed
        self._client = client = world.join()
        episode = Episode(world, genome, None, task, seed, logged=True)
        for step in episode.steps():
            if step is None:
                world.tick()
            elif isinstance(step, bytes):
                reply = protocol.decode(world.handle(client, protocol.parse(step)))
                if reply["type"] == "error":
                    raise WorldError(reply["code"], reply["message"], reply.get("field"))
            else:
                break  # from here on it is driven
        start = episode.start()
        if start is None:
            raise WorldError("invalid", f"the creature cannot begin with seed {seed}: {episode.result().fault}")
        self.creature, self.watched, self._judge = start
        self._track = world.simulation.track(*self.watched, task.ticks)

    def hand_over(self) -> Row | None:
        """Gives the scene away as a row, if it can be one; then this world is done with."""
        return None if self.creature.solitary else self._world.simulation.hand_over()

    def start(self, *, touchy: bool) -> Start:
        """Returns the moment at which the episode begins; before the first step."""
        states, positions = self._judge.start
        balance, touches = self._judge.balance, self.touches() if touchy else np.zeros((0, 2), np.bool_)
        energy = float(balance.energy(states[np.newaxis], positions[np.newaxis])[0])
        return Start(self._seed, balance, states, positions, touches, energy)

    def step(self, action: Array) -> str | None:
        """Goes one tick on; returns why it cannot, if it cannot."""
        world = self._world
        world.drive(self._client, CREATURE, action)
        world.tick()
        if world.fault is not None:
            return f"{world.fault.code}: {world.fault.message}"
        self._track.note()
        return None

    def read(self, place: int, parts: Parts) -> None:
        """Writes what a judge is told of the last tick into a place of the parts."""
        track = self._track
        rows = track.rows - 1, track.rows
        parts.states[place], parts.powers[place] = track.states(*rows)[0], track.powers(*rows)[0]
        parts.positions[place] = track.positions(*rows)[0]

    def touches(self) -> Flags:
        """Returns which bodies are touched now, array (n, 2), as a row of `Trajectory.touches`."""
        return touches(self._world.simulation, self.watched.bodies, self._judge.trajectory.bodies.body)

    def picture(self, size: tuple[int, int]) -> Image:
        """Returns a picture of the creature and what is around it, array (height, width, 3) of bytes.

        Args:
            size: Width and height, pixels.

        Raises:
            WorldError: `unsupported`: the engine draws none, or no OpenGL works here.
        """
        entities = self._world.entities
        entities.require("camera", "cameras")
        states = [entities.simulation.body_state(body) for body in self.watched.bodies]
        places = np.array([state.position for state in states])
        low, high = places.min(axis=0), places.max(axis=0)
        arms = [math.hypot(*cube.size) / 2.0 for cube in self.creature.body.cubes]
        radius = math.dist(high.tolist(), low.tolist()) / 2.0 + max(arms)
        camera = CameraSpec.looking_at(tuple(((low + high) / 2.0).tolist()), radius, size)
        return entities.simulation.draw(camera, {cube.body: cube.color for cube in entities.cubes.values()})

    def leave(self) -> None:
        """Has the client that drives it leave, as at the end of an evaluation."""
        self._world.leave(self._client)

    def close(self) -> None:
        """Ends the world."""
        self._world.close()


@dataclass(frozen=True, eq=False, slots=True)
class Scene:
    """A scene at the start of an episode: all that episodes of its seed have in common.

    Attributes:
        creature: The creature.
        watched: What its judge is told of.
        start: How it begins.
        senses: What is sensed then, array (s,).
        row: The scene as a row; None where it can be none.
        target: As `Task.target`.
    """

    creature: Creature
    watched: Watched
    start: Start
    senses: Array
    row: Row | None
    target: tuple[float, float, float] | str | None

    @classmethod
    def of(cls, genome: Genome, task: Task, seed: int, *, touchy: bool) -> Scene:
        """Sets the scene in a world.

        Raises:
            WorldError: The creature cannot begin.
        """
        world = DrivenWorld(genome, task, seed)
        try:
            start, senses = world.start(touchy=touchy), world.creature.sense().copy()
            return cls(world.creature, world.watched, start, senses, world.hand_over(), task.target(seed))
        finally:
            world.close()


class EngineRows:
    """The rows of an engine with creatures of one plan in them.

    Args:
        first: Any of the scenes, which is a row.
        task: What is asked.
        count: The number of places.
        threads: How many threads step them.
        touchy: Whether `touch` will be asked.
    """

    def __init__(self, first: Scene, task: Task, count: int, threads: int, *, touchy: bool) -> None:
        assert first.row is not None
        feels = any(sensor.type == "touch" for sensor in first.creature.sensors)
        self._first, self._substeps = first, task.substeps
        self._rows = first.row.rows(count, threads=threads, contacts=feels or touchy)
        self._creatures = CreatureRows(self._rows, first.creature)
        self._track = self._rows.track(*first.watched, 1, task.substeps)
        self._columns = {body: column for column, body in enumerate(first.watched.bodies)}

    def takes(self, scene: Scene) -> bool:
        """Whether a scene can be one of the rows."""
        first, row = self._first, scene.row
        if row is None or first.row is None:
            return False
        mine = first.row.layout, first.creature.plan, first.watched
        return mine == (row.layout, scene.creature.plan, scene.watched)

    def put(self, scenes: Iterable[tuple[int, Scene]]) -> None:
        """Begins scenes in places."""
        scenes = list(scenes)
        self._rows.put([place for place, _ in scenes], [scene.row for _, scene in scenes if scene.row is not None])
        for place, scene in scenes:
            self._creatures.put(place, scene.creature)

    def step(self, places: Places, actions: Array) -> list[int]:
        """Drives some places, and goes one tick on; returns those that cannot go on as rows."""
        self._creatures.drive(places, actions if len(places) == self._rows.count else actions[places])
        return self._rows.step(places, self._substeps)

    def read(self, places: Places, observations: Array, parts: Parts) -> None:
        """Writes what is sensed in some places, and what judges are told of them."""
        track = self._track
        track.note()
        every = slice(None) if len(places) == self._rows.count else places  # the common case, and half the time
        states = track.states()[:, 0]
        observations[every] = self._creatures.sense(partial(self._body_state, states))[every]
        parts.states[every] = states[every]
        parts.powers[every], parts.positions[every] = track.powers()[every, 0], track.positions()[every, 0]
        track.clear()

    def _body_state(self, states: Array, body: int) -> BodyState:
        """Returns the pose and velocity of a body, each number an array (places,), from the states of all."""
        columns = np.ascontiguousarray(states[:, self._columns[body]].T)
        return BodyState(tuple(columns[0:3]), tuple(columns[3:7]), tuple(columns[7:10]), tuple(columns[10:13]))

    def touch(self, places: Places, out: Flags) -> None:
        """Writes what touches what in some places."""
        bodies, body = self._first.watched.bodies, self._first.start.balance.bodies.body
        for place in places.tolist():
            out[place] = touches(PlaceOfRows(self._rows, place), bodies, body)
