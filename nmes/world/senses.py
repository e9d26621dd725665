"""What the sensors of a body read: of its joints, its cubes, and what is around them.

Hides where each sensor's value comes from: a column of a joint's readings, a reading of a cube, or somebody nearby.
Invariant: to read changes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, sqrt

import numpy as np

from nmes.backend import Array, BodyState, Vector
from nmes.backend.rotation import conjugate, rotate, total
from nmes.genome.body import Body, Sensor
from nmes.genome.sensor_entries import count_rays
from nmes.genome.sensors import OF_FOOD, OF_OTHERS, READING_OF, TURNING, CubeReading, Read
from nmes.world.entities import Cube, Joint
from nmes.world.food import nearest
from nmes.world.sights import Surroundings, look_around, looks_around

__all__ = ["Senses", "aim"]

_HERE = 1e-9  # m; nearer than this a target is in no direction
_STILL: Vector = (0.0, 0.0, 0.0)
# As many rays as take as long, where each may meet as much as there is to be heard, seen or smelled:
_LIST = 50  # to list, once in a tick, who speaks on a channel, or who is there
_NOSES = {"food_smell": 10, "other_smell": 40}  # a nose, which smells all that there is


class Senses:
    """The sensors of one body that lives in a world. Valid while its cubes and joints are there.

    Args:
        body: Whose sensors they are, in the order of values.
        cubes: Its cubes in the world, by the ids in the body; the values of sensors of what is missing are 0.
        joints: Its joints, likewise.
        around: What it may sense besides.

    Attributes:
        missing: The rows of sensors of what is missing.
    """

    def __init__(
        self, body: Body, cubes: Mapping[str, Cube], joints: Mapping[str, Joint], around: Surroundings
    ) -> None:
        self._around, self._simulation = around, around.entities.simulation
        self._count = len(body.sensors)
        there = [
            (row, sensor)
            for row, sensor in enumerate(body.sensors)
            if sensor.target in (joints if sensor.of == "joint" else cubes)
        ]
        present = {row for row, _ in there}
        self.missing = [row for row in range(self._count) if row not in present]
        self._plan_joints(body, [(row, sensor) for row, sensor in there if sensor.of == "joint"], joints)
        self._readers = look_around([pair for pair in there if looks_around(pair[1])], cubes, around)
        self._plan_cubes([pair for pair in there if pair[1].of == "cube" and not looks_around(pair[1])], cubes)
        around.entities.rays = max(around.entities.rays, self._work([sensor for _, sensor in there]))

    def _work(self, sensors: list[Sensor]) -> int:
        """Returns how many rays take as long as what these sensors perceive around their body, for `costs`."""
        noses = {(sensor.type, sensor.target, sensor.range) for sensor in sensors if sensor.type in _NOSES}
        others = bool(self.seen) or any(kind == "other_smell" for kind, *_ in noses)
        lists = len({channel for _, channel, *_ in self.ears}) + others
        smells = int(total(_NOSES[kind] for kind, *_ in noses))
        return count_rays(sensors) + len(self.smelled) + len(self.seen) + len(self.ears) + smells + lists * _LIST

    def _plan_joints(self, body: Body, sensors: list[tuple[int, Sensor]], joints: Mapping[str, Joint]) -> None:
        """Finds the columns of the joints' readings, and what to multiply them by."""
        parts = list(dict.fromkeys(sensor.target for _, sensor in sensors))
        column = ("position", "velocity", "effort").index
        self.joint_numbers = tuple(joints[part].number for part in parts)
        self.joint_rows = _rows([row for row, _ in sensors]) if sensors else []
        self.joint_columns = np.array([3 * parts.index(s.target) + column(s.type) for _, s in sensors], np.intp)
        self.joint_scale = np.array([_joint_scale(body, sensor) for _, sensor in sensors])

    def _plan_cubes(self, sensors: list[tuple[int, Sensor]], cubes: Mapping[str, Cube]) -> None:
        """Finds the reading of a cube, or of what is around it, that each sensor has."""
        felt: dict[tuple[str, CubeReading], list[tuple[int, int]]] = {}
        aimed: dict[str, list[tuple[int, int]]] = {}
        smelled: dict[str, list[tuple[int, int]]] = {}
        seen: dict[tuple[str, float], list[tuple[int, int]]] = {}
        ears: dict[tuple[str, str], list[tuple[int, int]]] = {}
        touched = []
        for row, sensor in sensors:
            axis = 0 if sensor.axis is None else "xyz".index(sensor.axis)
            reading = READING_OF.get(sensor.type)
            if sensor.type == "touch":
                touched.append((row, cubes[sensor.target].body))
            elif sensor.channel is not None:
                ears.setdefault((sensor.target, sensor.channel), []).append((row, sensor.number - 1))
            elif sensor.type in OF_OTHERS:
                reach = inf if sensor.range is None else sensor.range
                seen.setdefault((sensor.target, reach), []).append((row, _AIMED[sensor.type] + axis))
            elif reading is None:
                of = smelled if sensor.type in OF_FOOD else aimed
                of.setdefault(sensor.target, []).append((row, _AIMED[sensor.type] + axis))
            else:
                felt.setdefault((sensor.target, reading), []).append((row, reading.first(sensor.type) + axis))
        self.felt: list[tuple[Read, int, slice | list[int], list[int] | None]] = []
        for (part, reading), wanted in felt.items():
            picked = [number for _, number in wanted]
            everything = picked == list(range(reading.count))  # as where a document names no sensors
            rows = _rows([row for row, _ in wanted])
            self.felt.append((reading.read, cubes[part].body, rows, None if everything else picked))
        self.aimed = [(cubes[part].body, *_split(wanted)) for part, wanted in aimed.items()]
        self.smelled = [(cubes[part].body, *_split(wanted)) for part, wanted in smelled.items()]
        self.seen = [(cubes[part].body, reach, *_split(wanted)) for (part, reach), wanted in seen.items()]
        self.ears = [(cubes[part].body, channel, *_split(wanted)) for (part, channel), wanted in ears.items()]
        self.touch_rows = [row for row, _ in touched]
        self.touch_bodies = [body for _, body in touched]

    def read(self) -> Array:
        """Returns the sensors' values now: a new array, shape (s,), in the body's order.

        Units are those of `schemas/genome.json`.
        """
        out = np.empty(self._count)
        simulation = self._simulation
        if self.missing:
            out[self.missing] = 0.0
        if self.joint_numbers:
            out[self.joint_rows] = (
                simulation.joint_readings(self.joint_numbers).take(self.joint_columns) * self.joint_scale
            )
        for read, body, rows, picked in self.felt:
            felt = read(simulation.body_state(body))
            out[rows] = felt if picked is None else [felt[i] for i in picked]
        if self.touch_bodies:
            out[self.touch_rows] = simulation.touching(self.touch_bodies)
        if self.aimed:
            self._sense_target(out)
        if self.seen:
            self._sense_others(out)
        if self.ears:
            self._sense_voices(out)
        if self.smelled:
            self._sense_food(out)
        for read_around in self._readers:
            read_around(out)
        return out

    def _sense_food(self, out: Array) -> None:
        places = self._around.entities.food
        for body, rows, picked in self.smelled:
            state = self._simulation.body_state(body)
            found = nearest(places, state.position)
            if found is None:
                out[rows] = 0.0
            else:
                x, y, z = places[found[0]].tolist()
                smelled = aim(state, (x, y, z), _STILL)
                out[rows] = [smelled[i] for i in picked]

    def _sense_voices(self, out: Array) -> None:
        for body, channel, rows, picked in self.ears:
            values = self._around.channels.nearest(
                channel, self._simulation.body_state(body).position, self._around.bodies
            )
            out[rows] = 0.0 if values is None else [values[number] for number in picked]

    def _sense_others(self, out: Array) -> None:
        for body, reach, rows, picked in self.seen:
            state = self._simulation.body_state(body)
            other = self._around.others.nearest(state.position, reach, self._around.bodies[:1])
            if other is None:
                out[rows] = 0.0
            else:
                seen = aim(state, other.position, other.velocity)
                out[rows] = [seen[i] for i in picked]

    def _sense_target(self, out: Array) -> None:
        target = self._around.aim()
        for body, rows, picked in self.aimed:
            if target is None:
                out[rows] = 0.0
            else:
                seen = aim(self._simulation.body_state(body), *target)
                out[rows] = [seen[i] for i in picked]


# The place of the first number of each type of sensor in what `aim` returns.
_PLACES = {"direction": 0, "distance": 3, "velocity": 4}
_AIMED = {f"{whose}_{what}": at for whose in ("target", "other", "food") for what, at in _PLACES.items()}


def aim(state: BodyState, place: Vector, motion: Vector) -> tuple[float, ...]:
    """Returns where a target is from a cube, how far, and how it moves past it, directions being the cube's own."""
    back = conjugate(state.quaternion)
    (x, y, z), (vx, vy, vz) = state.position, state.linear_velocity
    dx, dy, dz = place[0] - x, place[1] - y, place[2] - z
    distance = sqrt(dx * dx + dy * dy + dz * dz)
    part = 1.0 / distance if distance > _HERE else 0.0
    direction = rotate(back, (dx * part, dy * part, dz * part))
    return (*direction, distance, *rotate(back, (motion[0] - vx, motion[1] - vy, motion[2] - vz)))


def _joint_scale(body: Body, sensor: Sensor) -> float:
    joint = next(joint for joint in body.joints if joint.id == sensor.target)
    if sensor.type == "effort":
        assert joint.motor is not None
        return 1.0 / joint.motor.max_effort if joint.motor.max_effort > 0.0 else 0.0
    return TURNING if sensor.type == "velocity" and joint.kind == "hinge" else 1.0


def _split(wanted: list[tuple[int, int]]) -> tuple[slice | list[int], list[int]]:
    """Returns the rows of pairs of a row and a number, and the numbers."""
    return _rows([row for row, _ in wanted]), [number for _, number in wanted]


def _rows(rows: list[int]) -> slice | list[int]:
    """Returns a slice where rows follow one another: it is written to faster."""
    first, last = rows[0], rows[0] + len(rows)
    return slice(first, last) if rows == list(range(first, last)) else rows
