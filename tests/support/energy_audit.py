"""Episodes run again under the eye of an auditor, who keeps books of energy without the product's own.

At every engine step he reads the joints and their motors, and works out what the motors put in; at every tick he reads
the cubes, and works out what the creature and its props have: kinetic and potential energy, and that of their springs.
What they have may never have grown by more than was put in. Nothing that he does changes the episode.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from typing import Any, Final
from unittest.mock import patch

import mujoco
import numpy as np
import pymunk

from nmes import protocol
from nmes.backend import Array
from nmes.errors import WorldError
from nmes.evaluation import Task
from nmes.evaluation.episode import Episode, brain_of
from nmes.evaluation.judge import Result
from nmes.evaluation.steps import Drive, Step
from nmes.genome import Genome
from nmes.world import World

__all__ = ["Audit", "audited", "begin"]

TOLERANCE: Final = 0.05
"""The part of the motors' work by which the balance may be broken."""
HELD: Final = 0.4
"""J for each kg that contacts and joints' limits may hold and give back: as much as 4 cm of height."""
MOMENT: Final = 0.1
"""s for which contacts and limits may hold more than that, as in an impact."""


@dataclass(frozen=True, slots=True)
class Audit:
    """An episode, and what the auditor found.

    Attributes:
        result: As evaluating gives it.
        work: Of the motors, the sizes of all that they put in or took out, J.
        unearned: The most by which the energy grew beyond what the motors put in, from any earlier moment on, J. What
            contacts and limits swallow and give back within a tenth of a second is no growth.
        fastest: The speed of the centre of the fastest cube at any tick that was scored, m/s.
        balanced: Whether at every tick that was less than the tolerance.
    """

    result: Result
    work: float
    unearned: float
    fastest: float
    balanced: bool


class _Books:
    """What the auditor writes down of a world, from its start on."""

    def __init__(self, world: World) -> None:
        self._world = world
        self.put_in: list[float] = []  # since the start, at each tick, J
        self.moved: list[float] = []  # the same of the sizes
        self.energies: list[float] = []  # of motion, of weight and in springs, at each tick, J
        self.fastest: list[float] = []  # the speed of the fastest cube, at each tick, m/s
        self._put_in = self._moved = 0.0
        self._list()
        self.note()

    def _list(self) -> None:
        """Lists what there is: cubes of the body, those that it lost, and props."""
        entities = self._world.entities
        joints = [joint for joint in entities.joints.values() if joint.kind in ("hinge", "slide")]
        self._version = entities.version
        self._numbers = tuple(joint.number for joint in joints)
        self._springs = np.array([joint.params["stiffness"] for joint in joints])
        cubes = list(entities.cubes.values())
        self._bodies = [cube.body for cube in cubes]
        self.masses = np.array([cube.mass for cube in cubes])
        self._sizes = np.array([cube.size for cube in cubes])

    def note(self) -> None:
        """Notes how it is at the end of a tick. What parts bring along that grew in it was put in."""
        simulation = self._world.simulation
        if self._version != self._world.entities.version:
            before = set(self._bodies)
            self._list()
            came = np.array([body not in before for body in self._bodies])
            self._put_in += max(0.0, float(self._mechanical(simulation.states(self._bodies))[came].sum()))
        states = simulation.states(self._bodies)
        positions = simulation.joint_readings(self._numbers)[:, 0]
        stored = float((self._springs * positions**2).sum() / 2.0)
        self.put_in.append(self._put_in)
        self.moved.append(self._moved)
        self.energies.append(float(self._mechanical(states).sum()) + stored)
        self.fastest.append(float(np.sqrt((states[:, 7:10] ** 2).sum(axis=1)).max()))

    def _work(self, works: Array) -> None:
        self._put_in += float(works.sum())
        self._moved += float(np.abs(works).sum())

    @contextmanager
    def open(self) -> Iterator[None]:
        """Reads the motors at every step that an engine takes meanwhile."""
        mj_step, space_step = mujoco.mj_step, pymunk.Space.step

        def mujoco_step(model: Any, data: Any, steps: int = 1) -> None:
            """Takes steps. MuJoCo tells the effort at a step's start, and lets it follow the velocity within the step
            unless it is at its bound; by Runge and Kutta's method it is at each moment what the motor's law says."""
            joints = model.actuator_trnid[:, 0]
            dofs, places, gears = model.jnt_dofadr[joints], model.jnt_qposadr[joints], model.actuator_gear[:, 0]
            gains, law, bounds = model.actuator_gainprm[:, 0], model.actuator_biasprm, model.actuator_forcerange

            def effort(position: Array, velocity: Array) -> Array:
                free = gains * data.ctrl + law[:, 0] + law[:, 1] * position + law[:, 2] * velocity
                return np.asarray(np.clip(free, bounds[:, 0], bounds[:, 1]))

            for _ in range(steps):
                before, began = gears * data.qvel[dofs], gears * data.qpos[places]
                mj_step(model, data)
                after, ended = gears * data.qvel[dofs], gears * data.qpos[places]
                middle = (before + after) / 2.0
                if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
                    powers = 4.0 * effort((began + ended) / 2.0, middle) * middle
                    powers = (effort(began, before) * before + powers + effort(ended, after) * after) / 6.0
                else:
                    efforts = data.actuator_force
                    free = np.abs(efforts) < bounds[:, 1]
                    powers = (efforts + free * law[:, 2] * (after - before)) * middle
                self._work(powers * model.opt.timestep)

        def chipmunk_step(space: pymunk.Space, seconds: float) -> None:
            """Takes a step. Chipmunk tells the impulse of the whole of it."""
            before = self._world.simulation.joint_readings(self._numbers)
            space_step(space, seconds)
            after = self._world.simulation.joint_readings(self._numbers)
            self._work(after[:, 2] * (before[:, 1] + after[:, 1]) * (seconds / 2.0))

        with (
            patch.object(mujoco, "mj_step", mujoco_step),
            patch.object(pymunk.Space, "step", chipmunk_step),
        ):
            yield

    def close(self, result: Result) -> Audit:
        """Adds up what was noted, of the ticks that were scored."""
        rows = result.ticks + 1
        unexplained = np.array(self.energies[:rows]) - np.array(self.put_in[:rows])
        moment = round(MOMENT * self._world.config["tick_rate"])
        before = np.array([unexplained[max(0, row - moment) : row + 1].max() for row in range(rows)])
        grown = unexplained - np.minimum.accumulate(before)
        allowed = TOLERANCE * np.array(self.moved[:rows]) + HELD * float(self.masses.sum())
        balanced = bool((grown <= allowed).all())
        return Audit(result, self.moved[rows - 1], float(grown.max()), max(self.fastest[:rows]), balanced)

    def _mechanical(self, states: Array) -> Array:
        """Returns kinetic and potential energy of each cube, array (n,), J."""
        x, y, z, w = states[:, 3:7].T
        turn = np.empty((len(x), 3, 3))  # the rows are the cubes' own axes
        turn[:, 0] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], axis=-1)
        turn[:, 1] = np.stack([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)], axis=-1)
        turn[:, 2] = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=-1)
        spin = (turn @ states[:, 10:13, None])[..., 0]
        squares = self._sizes**2
        inertia = self.masses[:, None] / 12.0 * (squares.sum(axis=1, keepdims=True) - squares)
        kinetic = (self.masses * (states[:, 7:10] ** 2).sum(axis=1) + (inertia * spin**2).sum(axis=1)) / 2.0
        gravity = np.array(self._world.config["gravity"])
        total: Array = kinetic - self.masses * (states[:, 0:3] @ gravity)
        return total


def audited(genome: Genome, task: Task, seed: int) -> Audit:
    """Runs one episode as evaluating does, and audits it.

    Raises:
        DocumentError: The genome's brain does not fit it.
        WorldError: The world refuses the creature.
    """
    world = World(task.world_config(seed))
    try:
        episode, ticks = begin(world, genome, task, seed)
        if episode._observer is None:
            return Audit(episode.result(), 0.0, 0.0, 0.0, balanced=True)
        books = _Books(world)
        with books.open():
            for _ in ticks:
                books.note()
        return books.close(episode.result())
    finally:
        world.close()


def begin(world: World, genome: Genome, task: Task, seed: int) -> tuple[Episode, Iterator[None]]:
    """Does the steps of an episode up to its start, which it may not come to.

    Returns:
        The episode, and an iterator that does the other steps, and yields after each tick.

    Raises:
        DocumentError: The genome's brain does not fit it.
        WorldError: The world refuses the creature.
    """
    episode = Episode(world, genome, brain_of(genome), task, seed)
    client, steps = world.join(), episode.steps()

    def ticks(first: Step) -> Iterator[None]:
        for step in chain([first], steps):
            _do(world, client, step)
            if step is None:
                yield

    for step in steps:
        if episode._observer is not None:  # this is the start
            return episode, ticks(step)
        _do(world, client, step)
    return episode, iter(())


def _do(world: World, client: int, step: Step) -> None:
    if step is None:
        world.tick()
    elif isinstance(step, Drive):
        assert isinstance(step.controls, np.ndarray)
        world.drive(client, step.creature, step.controls)
    else:
        reply = protocol.decode(world.handle(client, protocol.parse(step)))
        if reply["type"] == "error":
            raise WorldError(reply["code"], reply["message"])
