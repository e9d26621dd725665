"""The values that pass between a world and a physics engine: what a scene, a body and a joint are made of, and read.

All are immutable, in SI units, Y up, with quaternions `(x, y, z, w)`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from math import cos, pi, radians, sin, sqrt
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from nmes.backend.rotation import conjugate, quaternion_from_euler, rotate
from nmes.backend.shapes import Shape, axis, reach

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  # x, y, z, w
Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]  # rows from the top, columns, red green blue

CAPABILITIES = frozenset(
    {"joint.fixed", "joint.hinge", "joint.slide", "joint.pin", "joint.conetwist"}  # kinds of joints
    | {"joint.several"}  # between one pair of bodies
    | {"motor", "servo", "spring", "limits"}  # what hinges and slides have; `limits` are also a conetwist's
    | {"collisions", "friction", "restitution", "contacts"}  # between bodies; on the ground; and whether it tells
    | {"collision_groups"}  # of bodies that pass through each other
    | {"shape.sphere", "shape.capsule", "shape.cylinder"}  # of bodies and obstacles, besides boxes
    | {"scene.obstacles", "scene.heightfield", "scene.planets", "scene.arena"}  # what a SceneSpec may hold
    | {"scene.damping"}  # and how the velocities of its bodies may decay
    | {"medium"}  # water or air about them
    | {"sensors.inertial", "sensors.range", "camera"}  # what else than contacts a body can feel and see
    | {"sleep", "snapshot"}
)


_UNITS: tuple[Vector, Vector, Vector] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_CIRCLE = [(cos(pi / 24.0 * step), sin(pi / 24.0 * step)) for step in range(48)]  # corners by which a circle is told


@dataclass(frozen=True, slots=True)
class StaticBox:
    """An immovable box of scenery, or the `shape` that just fills it: full edge lengths `size` (m).

    It takes on the surface of whatever touches it.
    """

    size: Vector
    position: Vector
    quaternion: Quaternion = (0.0, 0.0, 0.0, 1.0)
    shape: Shape = "box"

    def reach(self, direction: Vector) -> float:
        """Returns how far (m) it reaches from its middle in a direction of the world, times that one's length."""
        return reach(self.shape, self.size, rotate(conjugate(self.quaternion), direction))

    def section(self) -> list[tuple[float, float]]:
        """Returns the corners (x, y) of the slice that the plane z = 0 cuts out, for engines of that plane.

        They are in no particular order, and none where the box does not reach the plane.
        """
        if self.shape != "box":
            return list(self._round_section())
        (dx, dy, dz), (px, py, pz) = self.size, self.position
        signs = [(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]
        arms = [rotate(self.quaternion, (x * dx, y * dy, z * dz)) for x, y, z in signs]
        corners = [(px + x, py + y, pz + z) for x, y, z in arms]
        cut = []
        for i, (one, a) in enumerate(zip(signs, corners, strict=True)):
            for other, b in zip(signs[i + 1 :], corners[i + 1 :], strict=True):
                is_edge = sum(p != q for p, q in zip(one, other, strict=True)) == 1
                if is_edge and (a[2] < 0.0) != (b[2] < 0.0):
                    part = a[2] / (a[2] - b[2])
                    cut.append((a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1])))
        return cut

    def _round_section(self) -> Iterator[tuple[float, float]]:
        """Yields the corners of a polygon in the slice of a round shape: of a ball's the circle's, of a side's ends."""
        lies = axis(self.size)
        radius, half = self.size[lies - 1] / 2.0, self.size[lies] / 2.0
        along, one, two = (rotate(self.quaternion, _UNITS[lies - i]) for i in range(3))
        x, y, z = self.position
        if self.shape != "cylinder":
            half -= radius
            for end in (-half, half):
                deep = z + end * along[2]
                if deep * deep < radius * radius:
                    wide = sqrt(radius * radius - deep * deep)
                    middle = x + end * along[0], y + end * along[1]
                    yield from ((middle[0] + wide * c, middle[1] + wide * s) for c, s in _CIRCLE)
        rims: list[list[Vector]] = []
        for end in (-half, half):
            arms = [
                [end * a + radius * (c * u + s * v) for a, u, v in zip(along, one, two, strict=True)]
                for c, s in _CIRCLE
            ]
            rims.append([(x + arm[0], y + arm[1], z + arm[2]) for arm in arms])
        edges = [*zip(*rims, strict=True)]
        for rim in rims:
            edges += zip(rim, [*rim[1:], rim[0]], strict=True)
        for a, b in edges:
            if (a[2] < 0.0) != (b[2] < 0.0):
                part = a[2] / (a[2] - b[2])
                yield a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1])


@dataclass(frozen=True, slots=True, eq=False)
class Heightfield:
    """A landscape over a rectangle whose middle is the origin. Beyond its edges there is nothing.

    Attributes:
        size: Extent along x and z, m.
        heights: Array (rows along z, columns along x) of heights y in m, at equal distances from the edges at -size/2
            to those at +size/2. In between the surface is straight along x and along z, within what the engine can do.
    """

    size: tuple[float, float]
    heights: Array

    def profile(self) -> list[tuple[float, float]]:
        """Returns the points (x, y) of the surface in the plane z = 0, for engines of that plane."""
        rows, columns = self.heights.shape
        middle = (rows - 1) / 2.0
        low = int(middle)
        part = middle - low
        line = self.heights[low] if part == 0.0 else (self.heights[low] + self.heights[low + 1]) / 2.0
        step = self.size[0] / (columns - 1)
        return [(step * i - self.size[0] / 2.0, height) for i, height in enumerate(line.tolist())]


@dataclass(frozen=True, slots=True)
class Planet:
    """An immovable ball, m."""

    position: Vector
    radius: float


@dataclass(frozen=True, slots=True)
class Arena:
    """An arena by name, which the engine's own library makes: the same for the same values.

    Attributes:
        name: `bowl`, `corridor`, `gaps`, `walls` or `maze`.
        seed: What is drawn follows from it.
        length: Of a corridor, along x, m.
        width: Of a corridor, m.
        cells: Of a maze, along each side; odd.
    """

    name: str
    seed: int
    length: float
    width: float
    cells: int


@dataclass(frozen=True, slots=True)
class Medium:
    """Water or air: what slows bodies down and lifts them; `nmes.backend.medium` has the formulas.

    Attributes:
        density: kg/m^3.
        viscosity: Pa s.
        level: The height y up to which it reaches, m; above there is nothing. None: it is everywhere.
    """

    density: float
    viscosity: float
    level: float | None = None


@dataclass(frozen=True, slots=True)
class SceneSpec:
    """What a scene is before any body is in it.

    Scenery never moves, and contacts with it report no partner. The World asks an engine only for scenery that its
    capabilities promise.

    Attributes:
        timestep: Length of one engine step, s.
        gravity: Acceleration of free fall, m/s^2.
        max_bodies: How many bodies may exist at once; a hint for memory.
        ground: Whether the flat ground y = 0 is there.
        boxes: Obstacles (`scene.obstacles`), of the shapes that the engine has.
        heightfield: A landscape (`scene.heightfield`).
        planets: Balls (`scene.planets`). Where there are any, each body falls towards the centre of the nearest one,
            as strongly as `gravity` says, at any distance.
        arena: An arena (`scene.arena`).
        linear_damping: Of each body's own velocity (`scene.damping`), 1/s: without anything else that acts, a velocity
            v decays as v exp(-c t). It acts as a force at the body's centre would, whatever it is joined to.
        angular_damping: Likewise of the angular velocity, 1/s.
        passes: Of each collision group, the first being 1 (`collision_groups`), the groups whose bodies its own pass
            through, as bits: 1 << group. Where one has another's, that one has its own; there are at most 15.
        medium: What is about the bodies (`medium`); nothing where None. Where it has a level, gravity is along y.
        options: The world config's `engine` object: settings of one engine, which it validates itself.
    """

    timestep: float
    gravity: Vector = (0.0, -9.81, 0.0)
    max_bodies: int = 10_000
    ground: bool = True
    boxes: tuple[StaticBox, ...] = ()
    heightfield: Heightfield | None = None
    planets: tuple[Planet, ...] = ()
    arena: Arena | None = None
    linear_damping: float = 0.0
    angular_damping: float = 0.0
    passes: tuple[int, ...] = ()
    medium: Medium | None = None
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class BodySpec:
    """A box: full edge lengths `size` (m), `mass` (kg), surface, and its state when it appears.

    It is solid and even throughout. With a `shape` it is what just fills that box, see `nmes.backend.shapes`.
    `frozen` bodies are immovable: infinite mass, no velocity. `group` is the collision group, of those in the scene's
    `passes`; bodies of none (0) meet everything.
    """

    size: Vector
    mass: float
    friction: float
    restitution: float
    position: Vector
    quaternion: Quaternion
    linear_velocity: Vector = (0.0, 0.0, 0.0)
    angular_velocity: Vector = (0.0, 0.0, 0.0)
    frozen: bool = False
    group: int = 0
    shape: Shape = "box"


@dataclass(frozen=True, slots=True)
class JointParams:
    """Everything adjustable about a joint with one degree of freedom (`hinge`, `slide`), all of it at once.

    The World turns the wire's `set_joint_param` into a new JointParams and checks it, so an engine only obeys.

    Attributes:
        motor: `off`, `velocity` (drives towards `target_velocity`) or `position` (a servo that drives towards
            `target_position` and holds there, with gains of the engine's choice, critically damped).
        target_velocity: rad/s or m/s.
        target_position: rad or m.
        max_effort: What the motor may apply at most, N m or N; never exceeded.
        stiffness: Of a passive spring towards the joint's zero, N m/rad or N/m.
        damping: Passive, N m s/rad or N s/m.
        limits: Lowest and highest position, rad or m, or None. For `conetwist` the largest swing and twist, rad.
    """

    motor: Literal["off", "velocity", "position"] = "off"
    target_velocity: float = 0.0
    target_position: float = 0.0
    max_effort: float = 0.0
    stiffness: float = 0.0
    damping: float = 0.0
    limits: tuple[float, float] | None = None

    def with_target(self, target: float) -> JointParams:
        """Returns these parameters with another target of the motor, in the unit of its mode."""
        if self.motor == "velocity":
            return replace(self, target_velocity=target)
        return replace(self, target_position=target)


@dataclass(frozen=True, slots=True)
class JointSpec:
    """A joint from `body1` to `body2`, given in world coordinates at the moment it is made.

    The relative pose at that moment is the joint's zero. Position is the motion of `body2` relative to `body1`:
    about `axis` by the right hand rule (hinge, rad), or along it (slide, m).

    Attributes:
        kind: `fixed`, `hinge`, `slide`, `pin` (a ball joint) or `conetwist`.
        anchor: World point, m.
        axis: World direction, unit length. Ignored by `fixed` and `pin`.
        params: Motor, spring and limits to begin with.
    """

    kind: str
    body1: int
    body2: int
    anchor: Vector
    axis: Vector
    params: JointParams = JointParams()


@dataclass(frozen=True, slots=True)
class BodyState:
    """Pose of a body's centre, and velocity of its centre of mass, in world coordinates (m, m/s, rad/s)."""

    position: Vector
    quaternion: Quaternion
    linear_velocity: Vector
    angular_velocity: Vector


@dataclass(frozen=True, slots=True)
class JointState:
    """Reading of a joint: position (rad or m), velocity (rad/s or m/s), effort its motor applied (N m or N).

    `anchor` and `axis` are where the joint is now, in world coordinates.
    """

    position: float
    velocity: float
    effort: float
    anchor: Vector
    axis: Vector


class Contact(NamedTuple):  # a tuple, since a body has many and a dataclass takes three times as long to make
    """One touching partner of a body, as of the last step: `other` is a body, or None for the ground and scenery.

    `normal` points from the other into the body (world, unit); `force` is the normal force in N.
    """

    other: int | None
    position: Vector
    normal: Vector
    force: float


class Hit(NamedTuple):
    """What a ray meets first: how far away, m, and which body; None for the ground and scenery."""

    distance: float
    other: int | None


@dataclass(frozen=True, slots=True)
class CameraSpec:
    """A view of the scene.

    Attributes:
        width: Of the image, pixels.
        height: Of the image, pixels.
        fov: Vertical field of view, rad.
        position: World, m.
        quaternion: World. A camera looks along its own -z, with its own y upwards.
        shadows: Whether things should cast shadows, where the engine can draw them: they take most of the time.
    """

    width: int
    height: int
    fov: float
    position: Vector
    quaternion: Quaternion
    shadows: bool = False

    @classmethod
    def looking_at(
        cls,
        middle: Vector,
        radius: float,
        size: tuple[int, int],
        *,
        fov: float = radians(40.0),
        elevation: float = radians(20.0),
        turn: float = radians(30.0),
        shadows: bool = False,
    ) -> CameraSpec:
        """Returns a view in which a ball is seen whole.

        Args:
            middle: Of the ball, m.
            radius: Of the ball, m.
            size: Width and height of the image, pixels.
            fov: Vertical field of view, rad.
            elevation: How high the camera stands above the middle, rad.
            turn: How far it has gone around the middle from the front, towards x, rad.
            shadows: As the attribute.
        """
        width, height = size
        distance = radius / sin(fov / 2.0) * max(1.0, 0.75 * height / width)
        x, y, z = middle
        aside, front = cos(elevation) * sin(turn), cos(elevation) * cos(turn)
        position = (x + distance * aside, y + distance * sin(elevation), z + distance * front)
        return cls(width, height, fov, position, quaternion_from_euler(-elevation, turn, 0.0), shadows)
