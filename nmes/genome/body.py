"""A creature's body at rest: its cubes, joints, motors and sensors, read from a genome's document and judged.

Hides the defaults of a body, and the geometry by which cubes are found to overlap. A body is plain data; a creature
that lives in a world is `nmes.world.creature`'s.

Invariants: cubes and joints are in the document's order (a graph's in the order in which it grows), motors in that of
their joints; every id is unique among its kind; a body is connected, stands on or above y = 0, and no two of its cubes
overlap unless a joint joins them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from typing import Any, Literal

import numpy as np

from nmes.backend import Array, Quaternion, Vector
from nmes.backend.rotation import normalize, quaternion_from_euler, rotate, total
from nmes.backend.shapes import Shape, misfit, volume
from nmes.errors import DocumentError
from nmes.genome.development import Rule, read_rules
from nmes.genome.sensor_entries import MOST_RAYS, count_rays, read_sensor
from nmes.genome.sensors import Flaws, Sensor
from nmes.schemas.documents import did_you_mean, fits, nor_at

__all__ = [
    "PALETTE",
    "Body",
    "BodyCube",
    "BodyJoint",
    "Motor",
    "Sensor",
    "Voice",
    "corners",
    "overlap",
    "overlaps",
    "read_body",
    "read_cube",
]

JsonObject = Mapping[str, Any]

PALETTE = ((0.36, 0.55, 0.75), (0.85, 0.62, 0.31), (0.45, 0.65, 0.45), (0.72, 0.42, 0.42), (0.58, 0.49, 0.7))
"""Colours for parts that are given none, in turn."""

_TOUCHING = 1e-4  # m that cubes may overlap, and reach into the ground, by rounding
_SIGNS = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])  # of a box's corners
_HINTS = 5  # problems with suggestions
_BLOCK = 256  # pairs of cubes whose overlap is computed at once
_MOST_SENSORS = 4096  # as many as a brain may have
_PARALLEL = 1e-6  # sine of the angle below which edges count as parallel
_DRIVEN = ("hinge", "slide")
_ROOT = ("height", "up", "velocity", "spin")  # what the root senses where a document names no sensors


@dataclass(frozen=True, slots=True)
class BodyCube:
    """A cube as the document has it: m, kg; `friction` and `restitution` None where they are the world's.

    `group` is its collision group, None for none. Of another `shape` than a box it fills the box that `size` says; for
    what overlaps what, how large the body is and how deep it reaches, that box counts.
    """

    id: str
    size: Vector
    mass: float
    position: Vector
    quaternion: Quaternion
    friction: float | None
    restitution: float | None
    color: tuple[float, ...] | None
    group: str | None = None
    shape: Shape = "box"

    @property
    def volume(self) -> float:
        """Its volume, m^3."""
        return volume(self.shape, self.size)


@dataclass(frozen=True, slots=True)
class Motor:
    """A motor. A control c in [-1, 1] aims at `low + (c + 1) / 2 * (high - low)`.

    Attributes:
        id: That of its joint.
        mode: `position` (rad or m) or `velocity` (rad/s or m/s).
        low: What -1 stands for.
        high: What 1 stands for.
        max_effort: The most that it gives, N m or N.
        flaws: How it errs; noise is that of controls. None: it does not.
    """

    id: str
    mode: Literal["position", "velocity"]
    low: float
    high: float
    max_effort: float
    flaws: Flaws | None = None


@dataclass(frozen=True, slots=True)
class BodyJoint:
    """A joint as the document has it: `anchor` in m, `axis` None where it is its type's own."""

    id: str
    cube1: str
    cube2: str
    kind: str
    anchor: Vector
    axis: Vector | None
    limits: tuple[float, float] | None
    stiffness: float
    damping: float
    motor: Motor | None


@dataclass(frozen=True, slots=True)
class Voice:
    """One number that a creature says on a channel: the `number`-th, from 1; `id` is unique among all outputs."""

    id: str
    channel: str
    number: int


@dataclass(frozen=True)
class Body:
    """A whole body: cubes, joints, sensors and voices, in the order that the module promises.

    `later` are the ids of the cubes that are not there at birth, and may grow; `development` are the rules by which it
    changes.
    """

    cubes: tuple[BodyCube, ...]
    joints: tuple[BodyJoint, ...]
    sensors: tuple[Sensor, ...]
    voices: tuple[Voice, ...] = ()
    later: tuple[str, ...] = ()
    development: tuple[Rule, ...] = ()

    @property
    def motors(self) -> tuple[Motor, ...]:
        """The motors, in the order of their joints."""
        return tuple(joint.motor for joint in self.joints if joint.motor is not None)

    @property
    def outputs(self) -> tuple[str, ...]:
        """The ids of the motors, then those of the voices: what a brain drives, and the order of controls."""
        return (*(motor.id for motor in self.motors), *(voice.id for voice in self.voices))

    @cached_property
    def mass(self) -> float:
        """Mass of all cubes, kg."""
        return total(cube.mass for cube in self.cubes)

    @property
    def planar(self) -> bool:
        """Whether it lies in the plane z = 0 and moves in it: what an engine of that plane can hold."""
        flat = all(cube.position[2] == 0.0 and cube.quaternion[:2] == (0.0, 0.0) for cube in self.cubes)
        return flat and all(_stays_in_plane(joint) for joint in self.joints)

    @property
    def born(self) -> Body:
        """What of it is there at birth: its cubes and joints but those that are later, with all sensors and voices."""
        if not self.later:
            return self
        cubes = tuple(cube for cube in self.cubes if cube.id not in self.later)
        joints = tuple(each for each in self.joints if not {each.cube1, each.cube2} & {*self.later})
        return replace(self, cubes=cubes, joints=joints, later=())

    @cached_property
    def bounds(self) -> tuple[Vector, Vector]:
        """The lowest and the highest corner of the box around the body, m."""
        points = np.concatenate([corners(cube) for cube in self.cubes])
        low, high = points.min(axis=0).tolist(), points.max(axis=0).tolist()
        return (low[0], low[1], low[2]), (high[0], high[1], high[2])

    @cached_property
    def size(self) -> float:
        """The longest edge of the box around the body, m."""
        low, high = self.bounds
        return max(b - a for a, b in zip(low, high, strict=True))


def corners(cube: BodyCube) -> Array:
    """Returns the eight corners of a cube, shape (8, 3), m."""
    return np.asarray(((_SIGNS * cube.size)[:, :, None] * _axes(cube)).sum(axis=1) + cube.position)


def read_body(
    body: JsonObject,
    sensors: Sequence[JsonObject] | None,
    voices: Sequence[JsonObject] = (),
    place: str | None = None,
    absent: Collection[str] = (),
    later: Sequence[str] = (),
    development: Sequence[JsonObject] = (),
) -> tuple[list[tuple[str, str]], Body]:
    """Reads the `body`, `sensors` and `voices` of a document, which its schema has accepted so far as they are given.

    Args:
        body: Its `cubes` and `joints`.
        sensors: As in the document; None for those that a body has by default.
        voices: As in the document.
        place: What of the document to blame for the cubes and joints; None where they stand in it themselves.
        absent: The ids of cubes and joints that were left out, `*` for one whose id is not known: what may be due to
            that is no problem.
        later: As in the document.
        development: As in the document.

    Returns:
        Everything that is wrong, each with its place; and the body, which is good only where that is nothing.

    Raises:
        DocumentError: There are more problems than one lists.
    """
    reader = _Reader(place, absent)
    read = reader.read(body, sensors, voices)
    if later and not absent:
        reader.later(read, later)
    rules: tuple[Rule, ...] = ()
    if development and not absent:
        rules = reader.development(read, development)
    return reader.problems, replace(read, later=tuple(later), development=rules)


class _Reader:
    """Reads one body, and notes its problems."""

    def __init__(self, place: str | None, absent: Collection[str]) -> None:
        self.problems: list[tuple[str, str]] = []
        self.place = place
        self.absent = absent

    def note(self, path: str, message: str) -> None:
        """Notes a problem; raises all of them where there are more than one lists."""
        self.problems.append((self.place if self.place is not None and path.startswith("body/") else path, message))
        if len(self.problems) > DocumentError.MOST:
            raise DocumentError(self.problems)

    def may_be_absent(self, pattern: str) -> bool:
        """Whether a pattern may stand for what was left out."""
        return bool(self.absent) and any(name == "*" or fits(pattern)(name) for name in self.absent)

    def hint(self, name: str, known: Sequence[str]) -> str:
        """Returns a suggestion, with the first problems only: each name may be held against hundreds."""
        return did_you_mean(name, known) if len(self.problems) < _HINTS else ""

    def read(self, body: JsonObject, sensors: Sequence[JsonObject] | None, voices: Sequence[JsonObject]) -> Body:
        cubes = [read_cube(entry) for entry in body["cubes"]]
        self.unique([f"body/cubes/{i}/id" for i in range(len(cubes))], [cube.id for cube in cubes], "cube")
        for i, cube in enumerate(cubes):
            problem = misfit(cube.shape, cube.size)
            if problem is not None:
                self.note(f"body/cubes/{i}/size", f"cube {cube.id!r}: {problem}")
        joints = [_joint(entry) for entry in body.get("joints", ())]
        self.unique([f"body/joints/{i}/id" for i in range(len(joints))], [joint.id for joint in joints], "joint")
        for i, joint in enumerate(joints):
            self.joint(joint, f"body/joints/{i}")
        self.structure(cubes, joints)
        self.ground(cubes)
        paths, all_sensors, rays = [], [], 0
        for i, entry in enumerate(_default_sensors(cubes, joints) if sensors is None else sensors):
            single = read_sensor(entry, f"sensors/{i}", cubes, joints, self)
            paths += [f"sensors/{i}"] * len(single)
            all_sensors += single
            if len(all_sensors) > _MOST_SENSORS:
                self.note(f"sensors/{i}", f"with it there are over {_MOST_SENSORS:,} single readings")
                break
            rays += count_rays(single)
            if rays > MOST_RAYS:
                self.note(f"sensors/{i}", f"with it there are over {MOST_RAYS:,} rays of cameras and range finders")
                break
        self.unique(paths, [sensor.id for sensor in all_sensors], "sensor")
        return Body(tuple(cubes), tuple(joints), tuple(all_sensors), self.voices(voices, joints))

    def later(self, body: Body, names: Sequence[str]) -> None:
        """Notes what is wrong with the parts that are not there at birth."""
        known, root = {cube.id for cube in body.cubes}, body.cubes[0].id
        for i, name in enumerate(names):
            if name not in known:
                self.note(f"later/{i}", f"there is no cube {name!r}{self.hint(name, sorted(known))}")
        if body.cubes[0].id in names:
            self.note(
                f"later/{names.index(body.cubes[0].id)}", f"{body.cubes[0].id!r} is the root, on which all others hang"
            )
        elif not self.problems:
            born = replace(body, later=tuple(names)).born
            ends, hanging = [_ends(joint) for joint in born.joints], {root}
            while more := {name for pair in ends if pair & hanging for name in pair} - hanging:
                hanging |= more
            for i, cube in enumerate(body.cubes):
                if cube.id not in hanging and cube.id not in names:
                    self.note(f"body/cubes/{i}", f"{cube.id!r} is there at birth, and what it hangs on is later")

    def development(self, body: Body, entries: Sequence[JsonObject]) -> tuple[Rule, ...]:
        """Reads the rules of development, and notes what is wrong with them."""
        problems, rules = read_rules(entries, body)
        for problem in problems:
            self.note(*problem)
        return rules

    def voices(self, entries: Sequence[JsonObject], joints: Sequence[BodyJoint]) -> tuple[Voice, ...]:
        """Reads the voices, and notes those that are there twice, or called like a joint, which may have a motor."""
        voices = [_voice(entry) for entry in entries]
        paths = [f"voices/{i}" for i in range(len(voices))]
        self.unique(paths, [f"{voice.channel} {voice.number}" for voice in voices], "voice on channel and number")
        names = {joint.id for joint in joints}
        for path, voice in zip(paths, voices, strict=True):
            if voice.id in names:
                self.note(path, f"there is a joint {voice.id!r}, and both would be outputs of the brain")
        self.unique(paths, [voice.id for voice in voices], "voice")
        return tuple(voices)

    def unique(self, paths: Iterable[str], ids: Iterable[str], what: str) -> None:
        seen: set[str] = set()
        for path, name in zip(paths, ids, strict=True):
            if name in seen:
                self.note(path, f"there is a {what} {name!r} already")
            seen.add(name)

    def joint(self, joint: BodyJoint, path: str) -> None:
        """Notes problems of one joint by itself."""
        kind, limits, motor = joint.kind, joint.limits, joint.motor
        who = f"joint {joint.id!r}"
        if kind not in _DRIVEN:
            if motor is not None:
                self.note(f"{path}/motor", f"{who} is a {kind}; only a hinge or a slide can have a motor")
            for name, value in (("stiffness", joint.stiffness), ("damping", joint.damping)):
                if value:
                    self.note(f"{path}/{name}", f"{who} is a {kind}; only a hinge or a slide can have {name}")
        if limits is not None:
            if kind in ("fixed", "pin"):
                self.note(f"{path}/limits", f"{who} is a {kind}, which has no limits")
            elif kind == "conetwist" and min(limits) < 0.0:
                self.note(f"{path}/limits", f"the swing and twist of {who} must not be negative")
            elif kind != "conetwist":
                self.limits(limits, who, f"{path}/limits")
        if motor is not None and motor.low == motor.high:
            self.note(f"{path}/motor/range", f"both ends of the motor of {who} are {motor.low:g}: it could do nothing")

    def limits(self, limits: tuple[float, float], who: str, path: str) -> None:
        """Notes limits that are the wrong way round, or exclude 0, from where a solver would fling the body."""
        low, high = limits
        if low > high:
            self.note(path, f"the lower limit of {who}, {low:g}, is above the upper, {high:g}")
        elif not low <= 0.0 <= high:
            self.note(path, f"the limits of {who}, {low:g} to {high:g}, exclude 0, the position in which it is built")

    def structure(self, cubes: Sequence[BodyCube], joints: Sequence[BodyJoint]) -> None:
        """Notes joints that lead nowhere, and cubes that no joint ties to the rest."""
        names = [cube.id for cube in cubes]
        leader = {name: name for name in names}

        def find(name: str) -> str:
            while leader[name] != name:
                leader[name] = leader[leader[name]]
                name = leader[name]
            return name

        joined: dict[frozenset[str], str] = {}
        nowhere: dict[str, list[str]] = {}  # where there are names of no cube
        for i, joint in enumerate(joints):
            path, ends = f"body/joints/{i}", (joint.cube1, joint.cube2)
            for field, name in zip(("cube1", "cube2"), ends, strict=True):
                if name not in leader and not self.may_be_absent(name):
                    nowhere.setdefault(name, []).append(f"{path}/{field}")
            pair = _ends(joint)
            if len(pair) == 1:
                self.note(f"{path}/cube2", f"joint {joint.id!r} joins {joint.cube1!r} to itself")
            elif pair in joined:
                self.note(path, f"{ends[0]!r} and {ends[1]!r} are joined by {joined[pair]!r} already")
            elif pair <= leader.keys():
                joined[pair] = joint.id
                leader[find(joint.cube2)] = find(joint.cube1)
        for name, (first, *others) in nowhere.items():
            self.note(first, f"there is no cube {name!r}{nor_at(others)}{self.hint(name, names)}")
        if not self.absent:
            pairs = [_ends(joint) for joint in joints]
            wrong = [pair for pair in pairs if not pair <= leader.keys()]  # what these should join is not known
            self.loose(names, find, len(wrong))
            self.overlaps(cubes, set(pairs), {name for pair in wrong for name in pair})

    def loose(self, names: Sequence[str], find: Callable[[str], str], wrong: int) -> None:
        """Notes cubes that no joint ties to the first, unless there are joints with wrong names enough to tie all.

        Args:
            names: All cubes.
            find: Gives one cube of all that are joined to a cube.
            wrong: How many joints have a wrong name.
        """
        loose = [name for name in names if find(name) != find(names[0])]
        if len({find(name) for name in loose}) <= wrong:
            return
        for i, name in enumerate(names):
            if name in loose and find(name) == name:
                others = [other for other in loose if find(other) == name and other != name]
                with_them = f" (nor are {', '.join(map(repr, others))}, joined to it)" if others else ""
                self.note(f"body/cubes/{i}", f"{name!r} is not joined to the rest of the body{with_them}")

    def overlaps(self, cubes: Sequence[BodyCube], pairs: Set[frozenset[str]], spared: Set[str]) -> None:
        """Notes cubes that overlap, but for the pairs that are joined, and for those in which one is spared."""
        centres, axes, halves = _boxes(cubes)
        meeting = iter(_near_pairs(centres, halves))
        # In blocks: a body that has grown into itself has thousands of pairs, and is refused for the first few.
        while block := list(islice(meeting, _BLOCK)):
            near = [pair for pair in block if frozenset(cubes[i].id for i in pair) not in pairs]
            if not near:  # of most bodies only cubes that are joined
                continue
            one, other = np.array(near).T
            depths = _depths(centres[other] - centres[one], axes[one], axes[other], halves[one], halves[other])
            for (i, j), depth in zip(near, depths.tolist(), strict=True):
                if depth > _TOUCHING and not {cubes[i].id, cubes[j].id} & spared:
                    message = f"{cubes[i].id!r} and {cubes[j].id!r} overlap by {depth:.3g} m, and no joint joins them"
                    self.note(f"body/cubes/{j}", message)

    def ground(self, cubes: Sequence[BodyCube]) -> None:
        """Notes cubes that reach into the ground."""
        centres, axes, halves = _boxes(cubes)
        lowest = centres[:, 1] - (halves * abs(axes[:, :, 1])).sum(axis=1)
        for i, low in enumerate(lowest.tolist()):
            if low < -_TOUCHING:
                message = f"{cubes[i].id!r} reaches {-low:.3g} m below the ground, y = 0"
                self.note(f"body/cubes/{i}/position", message)


def read_cube(entry: JsonObject) -> BodyCube:
    """Reads a cube of a document that its schema has accepted."""
    size, color = entry["size"], entry.get("color")
    x, y, z = size if isinstance(size, Sequence) else (size, size, size)
    return BodyCube(
        id=entry["id"],
        size=(float(x), float(y), float(z)),
        mass=float(entry["mass"]),
        position=_vector(entry["position"]),
        quaternion=_quaternion(entry.get("rotation", (0.0, 0.0, 0.0))),
        friction=None if "friction" not in entry else float(entry["friction"]),
        restitution=None if "restitution" not in entry else float(entry["restitution"]),
        color=None if color is None else tuple(map(float, color)),
        group=entry.get("group"),
        shape=entry.get("shape", "box"),
    )


def _voice(entry: JsonObject) -> Voice:
    channel, number = entry["channel"], int(entry.get("number", 1))
    return Voice(entry.get("id", _heard("say", channel, number)), channel, number)


def _heard(name: str, channel: str, number: int) -> str:
    """Returns the name of a number of a channel: the first is called like the channel itself."""
    return f"{name}.{channel}" if number == 1 else f"{name}.{channel}.{number}"


def _joint(entry: JsonObject) -> BodyJoint:
    limits, motor = entry.get("limits"), entry.get("motor")
    return BodyJoint(
        id=entry["id"],
        cube1=entry["cube1"],
        cube2=entry["cube2"],
        kind=entry["type"],
        anchor=_vector(entry["anchor"]),
        axis=_vector(entry["axis"]) if "axis" in entry else None,
        limits=None if limits is None else (float(limits[0]), float(limits[1])),
        stiffness=float(entry.get("stiffness", 0.0)),
        damping=float(entry.get("damping", 0.0)),
        motor=None if motor is None else _motor(entry["id"], motor),
    )


def _ends(joint: BodyJoint) -> frozenset[str]:
    return frozenset((joint.cube1, joint.cube2))


def _motor(name: str, entry: JsonObject) -> Motor:
    low, high = entry["range"]
    return Motor(
        name, entry["mode"], float(low), float(high), float(entry["max_effort"]), Flaws.read(entry.get("flaws"))
    )


def _stays_in_plane(joint: BodyJoint) -> bool:
    if joint.kind == "hinge":
        return joint.axis is None or joint.axis[:2] == (0.0, 0.0)
    if joint.kind == "slide":
        return joint.axis is None or joint.axis[2] == 0.0
    return joint.kind in ("fixed", "pin")


def _default_sensors(cubes: Sequence[BodyCube], joints: Sequence[BodyJoint]) -> Iterator[JsonObject]:
    for joint in joints:
        if joint.motor is not None and joint.kind in _DRIVEN:
            for kind in ("position", "velocity"):
                yield {"type": kind, "joint": joint.id}
    for kind in _ROOT:
        yield {"type": kind, "cube": cubes[0].id}


# -- geometry ---------------------------------------------------------------------------------------------------------


def _axes(cube: BodyCube) -> Array:
    """Returns a cube's own directions as rows, shape (3, 3)."""
    q = cube.quaternion
    return np.array([rotate(q, (1.0, 0.0, 0.0)), rotate(q, (0.0, 1.0, 0.0)), rotate(q, (0.0, 0.0, 1.0))])


def _boxes(cubes: Sequence[BodyCube]) -> tuple[Array, Array, Array]:
    """Returns centres (n, 3), own directions as rows (n, 3, 3) and halves of the edges (n, 3) of cubes, m."""
    centres, halves = np.array([cube.position for cube in cubes]), np.array([cube.size for cube in cubes]) / 2.0
    return centres, np.array([_axes(cube) for cube in cubes]), halves


def overlap(one: BodyCube, other: BodyCube) -> float:
    """Returns how far two cubes overlap, m; not above 0 where they do not."""
    centres, axes, halves = _boxes((one, other))
    arms = centres[1:] - centres[:1]
    return float(_depths(arms, axes[:1], axes[1:], halves[:1], halves[1:])[0])


def overlaps(cube: BodyCube, sizes: Array, places: Array) -> Array:
    """Returns how far a cube overlaps each of some others, m, shape (n,), to the bits of `overlap`.

    Args:
        cube: The one.
        sizes: The others' edges, shape (n, 3), m.
        places: Their positions, m, and quaternions, shape (n, 7).
    """
    turns: Any = tuple(places[:, 3:].T)  # `rotate` has the same operations for rows as for numbers, in the same order
    ways = [rotate(turns, axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))]
    axes = np.ascontiguousarray(np.array(ways).transpose(2, 0, 1))
    centres, own, halves = _boxes((cube,))
    return _depths(places[:, :3] - centres, np.broadcast_to(own, axes.shape), axes, halves, sizes / 2.0)


def _near_pairs(centres: Array, halves: Array) -> list[tuple[int, int]]:
    """Returns the pairs (i < j) whose bounding spheres meet, in order."""
    reach = np.sqrt((halves * halves).sum(axis=1))
    arms = centres[:, None] - centres[None]
    close = (arms * arms).sum(axis=2) < (reach[:, None] + reach[None]) ** 2
    one, other = np.nonzero(np.triu(close, 1))
    return list(zip(one.tolist(), other.tolist(), strict=True))


def _depths(arms: Array, axes1: Array, axes2: Array, halves1: Array, halves2: Array) -> Array:
    """Returns how far pairs of boxes overlap, m, shape (n,): not above 0 where they do not.

    By the separating axis theorem: of two boxes, the faces' normals and the cross products of the edges.

    Args:
        arms: From the first centre to the second, shape (n, 3).
        axes1: The first boxes' own directions as rows, shape (n, 3, 3).
        axes2: The second ones'.
        halves1: Half the first boxes' edges, shape (n, 3).
        halves2: Half the second ones'.
    """
    crossed = np.cross(axes1[:, :, None], axes2[:, None]).reshape(-1, 9, 3)
    length = np.sqrt((crossed * crossed).sum(axis=2))
    crossed /= np.maximum(length, _PARALLEL)[..., None]
    axes = np.concatenate([axes1, axes2, crossed], axis=1)
    reach = (abs((axes[:, :, None] * axes1[:, None]).sum(axis=3)) * halves1[:, None]).sum(axis=2)
    reach += (abs((axes[:, :, None] * axes2[:, None]).sum(axis=3)) * halves2[:, None]).sum(axis=2)
    depths = reach - abs((axes * arms[:, None]).sum(axis=2))
    depths[:, 6:][length < _PARALLEL] = np.inf  # parallel edges span no plane of their own
    return np.asarray(depths.min(axis=1))


def _vector(value: Sequence[float]) -> Vector:
    x, y, z = value
    return float(x), float(y), float(z)


def _quaternion(value: Sequence[float]) -> Quaternion:
    if len(value) == 3:
        return quaternion_from_euler(*_vector(value))
    x, y, z, w = value
    return normalize((float(x), float(y), float(z), float(w)))
