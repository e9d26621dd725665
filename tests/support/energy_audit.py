"""Episodes run again under the eye of an auditor, who keeps books of energy without the product's own.

At every engine step he reads the joints and their motors, and works out what the motors put in; at every tick he reads
the cubes, and works out what the creature and its props have: kinetic and potential energy, and that of their springs.
What they have may never have grown by more than was put in. Nothing that he does changes the episode.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from nmes import protocol
from nmes.backend import Array
from nmes.errors import WorldError
from nmes.evaluation import Task
from nmes.evaluation.episode import Episode, Result, brain_of
from nmes.genome import Genome
from nmes.world import World

__all__ = ["Audit", "audited"]

TOLERANCE: Final = 0.05
"""The part of the motors' work by which the balance may be broken."""
HELD: Final = 0.1
"""J for each kg that contacts and joints' limits may hold and give back: as much as 1 cm of height."""


@dataclass(frozen=True, slots=True)
class Audit:
    """An episode, and what the auditor found.

    Attributes:
        result: As evaluating gives it.
        work: Of the motors, the sizes of all that they put in or took out, J.
        unearned: The most by which the energy grew beyond what the motors put in, from any earlier tick on, J.
        fastest: The speed of the centre of the fastest cube at any tick that was scored, m/s.
        mass: Of all cubes, the props' too, kg.
    """

    result: Result
    work: float
    unearned: float
    fastest: float
    mass: float

    @property
    def balanced(self) -> bool:
        """Whether the energy never grew by more than the motors put in, within the tolerance."""
        return self.unearned <= TOLERANCE * self.work + HELD * self.mass


class _Books:
    """What the auditor writes down of a world."""

    def __init__(self, world: World) -> None:
        self._world, self._simulation = world, world.simulation
        self._dt = 1.0 / (world.config["tick_rate"] * world.config["substeps"])
        self._advance, self._simulation.step = self._simulation.step, self._step  # type: ignore[method-assign]
        self.put_in: list[float] = []  # at each tick, J
        self.moved: list[float] = []
        self.stored: list[float] = []
        self.states: list[Array] = []

    def begin(self) -> None:
        """Notes which joints and cubes there are, and the start."""
        entities = self._world.entities
        joints = [joint for joint in entities.joints.values() if joint.kind in ("hinge", "slide")]
        self._numbers = tuple(joint.number for joint in joints)
        self._springs = np.array([joint.params["stiffness"] for joint in joints])
        self._bounds = np.array([joint.params["motor_max_force"] for joint in joints])
        cubes = list(entities.cubes.values())
        self._bodies = [cube.body for cube in cubes]
        self.masses = np.array([cube.mass for cube in cubes])
        self._sizes = np.array([cube.size for cube in cubes])
        self._model: Any = None  # MuJoCo's, of which the slopes are
        self._readings = self._simulation.joint_readings(self._numbers)
        self._note(0.0, 0.0)

    def _step(self, substeps: int) -> None:
        if not self.states:
            self._advance(substeps)
            return
        put_in = moved = 0.0
        for _ in range(substeps):
            before = self._readings
            self._advance(1)
            self._readings = after = self._simulation.joint_readings(self._numbers)
            works = self._efforts(before, after) * (before[:, 1] + after[:, 1]) * (self._dt / 2.0)
            put_in, moved = put_in + float(works.sum()), moved + float(np.abs(works).sum())
        self._note(put_in, moved)

    def _efforts(self, before: Array, after: Array) -> Array:
        """Returns what the motors gave during an engine step.

        Chipmunk tells the impulse of the whole step. MuJoCo tells the effort at the step's start, and lets it follow
        the velocity within the step unless it is at its bound.
        """
        efforts = after[:, 2]
        running = getattr(self._simulation, "running", None)
        if running is None:
            return efforts
        if running.model is not self._model:
            self._model, motors = running.model, running.compiled.actuator
            slopes = [self._model.actuator_biasprm[motors[n], 2] if n in motors else 0.0 for n in self._numbers]
            self._slopes = np.array(slopes, float)
        free = np.abs(efforts) < self._bounds
        told: Array = efforts + free * self._slopes * (after[:, 1] - before[:, 1])
        return told

    def _note(self, put_in: float, moved: float) -> None:
        self.put_in.append(put_in)
        self.moved.append(moved)
        self.stored.append(float((self._springs * self._readings[:, 0] ** 2).sum() / 2.0))
        self.states.append(self._simulation.states(self._bodies))

    def close(self, result: Result) -> Audit:
        """Adds up what was noted, of the ticks that were scored."""
        rows = result.ticks + 1
        states = np.array(self.states[:rows])
        moved, put_in = np.cumsum(self.moved[:rows]), np.cumsum(self.put_in[:rows])
        energy = self._mechanical(states) + np.array(self.stored[:rows])
        unexplained = energy - put_in
        unearned = float((unexplained - np.minimum.accumulate(unexplained)).max())
        fastest = float(np.sqrt((states[:, :, 7:10] ** 2).sum(axis=2)).max())
        return Audit(result, float(moved[-1]), unearned, fastest, float(self.masses.sum()))

    def _mechanical(self, states: Array) -> Array:
        """Returns kinetic and potential energy, array (rows,), J."""
        x, y, z, w = np.moveaxis(states[:, :, 3:7], 2, 0)
        turn = np.empty((*x.shape, 3, 3))  # the rows are the cubes' own axes
        turn[..., 0, :] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], axis=-1)
        turn[..., 1, :] = np.stack([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)], axis=-1)
        turn[..., 2, :] = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=-1)
        spin = (turn @ states[:, :, 10:13, None])[..., 0]
        squares = self._sizes**2
        inertia = self.masses[:, None] / 12.0 * (squares.sum(axis=1, keepdims=True) - squares)
        kinetic = (self.masses * (states[:, :, 7:10] ** 2).sum(axis=2) + (inertia * spin**2).sum(axis=2)) / 2.0
        gravity = np.array(self._world.config["gravity"])
        potential = -self.masses * (states[:, :, 0:3] @ gravity)
        total: Array = (kinetic + potential).sum(axis=1)
        return total


def audited(genome: Genome, task: Task, seed: int) -> Audit:
    """Runs one episode as evaluating does, and audits it.

    Raises:
        DocumentError: The genome's brain does not fit it.
        WorldError: The world refuses the creature.
    """
    world = World(task.world_config(seed))
    try:
        episode = Episode(world, genome, brain_of(genome), task, seed)
        client, books, started = world.join(), _Books(world), False
        for step in episode.steps():
            if not started and episode._observer is not None:
                books.begin()
                started = True
            if step is None:
                world.tick()
            elif isinstance(step, np.ndarray):
                world.drive(client, "creature", step)
            else:
                assert isinstance(step, bytes)
                reply = protocol.decode(world.handle(client, protocol.parse(step)))
                if reply["type"] == "error":
                    raise WorldError(reply["code"], reply["message"])
        result = episode.result()
        return books.close(result) if started else Audit(result, 0.0, 0.0, 0.0, genome.body.mass)
    finally:
        world.close()
