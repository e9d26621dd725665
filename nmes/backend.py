"""What a physics engine must provide, and how one is found.

A Backend is an installed engine adapter: a name, a version, capabilities and a factory of Simulations. A Simulation
is one running scene: bodies and joints known by the integers that the World chose, in SI units, Y up, quaternions
`(x, y, z, w)`. It knows no names, clients, frames or JSON: those are the World's, so that an adapter is small and
engines cannot differ in meaning.

Invariants that every Simulation keeps (and that the contract tests check):

- It is deterministic: the same calls in the same order give the same digests. It reads no clock, no environment and
  no unseeded random number, and it starts no thread of which the result depends.
- Queries never change what happens later.
- Edits and forces act at the next `step`. Until then queries see edits (a new body's pose, a moved body) at once.
- What it returns is the caller's: no result aliases engine memory.
"""

from __future__ import annotations

import difflib
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from nmes.errors import BackendNotFound
from nmes.rotation import rotate

__all__ = [
    "CAPABILITIES",
    "Arena",
    "Backend",
    "BodySpec",
    "BodyState",
    "CameraSpec",
    "Contact",
    "Heightfield",
    "JointParams",
    "JointSpec",
    "JointState",
    "Planet",
    "SceneSpec",
    "Simulation",
    "StaticBox",
    "Track",
    "entry_points_by_name",
    "load_backend",
]

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  # x, y, z, w
Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]  # rows from the top, columns, red green blue

ENTRY_POINT_GROUP = "nmes.backends"

CAPABILITIES = frozenset(
    {"joint.fixed", "joint.hinge", "joint.slide", "joint.pin", "joint.conetwist"}  # kinds of joints
    | {"motor", "servo", "spring", "limits"}  # what hinges and slides have; `limits` are also a conetwist's
    | {"collisions", "friction", "restitution", "contacts"}  # between bodies; on the ground; and whether it tells
    | {"scene.obstacles", "scene.heightfield", "scene.planets", "scene.arena"}  # what a SceneSpec may hold
    | {"sensors.inertial", "sensors.range", "camera"}  # what else than contacts a body can feel and see
    | {"sleep", "snapshot"}
)


@dataclass(frozen=True, slots=True)
class StaticBox:
    """An immovable box of scenery: full edge lengths `size` (m). It takes on the surface of whatever touches it."""

    size: Vector
    position: Vector
    quaternion: Quaternion = (0.0, 0.0, 0.0, 1.0)

    def section(self) -> list[tuple[float, float]]:
        """Returns the corners (x, y) of the slice that the plane z = 0 cuts out, for engines of that plane.

        They are in no particular order, and none where the box does not reach the plane.
        """
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
class SceneSpec:
    """What a scene is before any body is in it.

    Scenery never moves, and contacts with it report no partner. The World asks an engine only for scenery that its
    capabilities promise.

    Attributes:
        timestep: Length of one engine step, s.
        gravity: Acceleration of free fall, m/s^2.
        max_bodies: How many bodies may exist at once; a hint for memory.
        ground: Whether the flat ground y = 0 is there.
        boxes: Obstacles (`scene.obstacles`).
        heightfield: A landscape (`scene.heightfield`).
        planets: Balls (`scene.planets`). Where there are any, each body falls towards the centre of the nearest one,
            as strongly as `gravity` says, at any distance.
        arena: An arena (`scene.arena`).
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
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class BodySpec:
    """A box: full edge lengths `size` (m), `mass` (kg), surface, and its state when it appears.

    `frozen` bodies are immovable: infinite mass, no velocity.
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

    def aimed(self, target: float) -> JointParams:
        """Returns the same with another target of the motor, in the unit of its mode."""
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


class Track(ABC):
    """What bodies and joints did, row by row: kept at little cost while a scene runs, computed with afterwards.

    Args:
        simulation: The scene.
        bodies: Whose states are kept.
        joints: Whose readings are kept: hinges and slides with motors.

    Attributes:
        rows: How many are kept.
    """

    def __init__(self, simulation: Simulation, bodies: Sequence[int], joints: Sequence[int]) -> None:
        self._simulation = simulation
        self._bodies, self._joints = list(bodies), list(joints)
        self.rows = 0

    @abstractmethod
    def note(self) -> None:
        """Keeps how things are now as the next row."""

    @abstractmethod
    def states(self, begin: int, end: int) -> Array:
        """Returns the states of the rows from `begin` to before `end`, array (rows, n, 13), as `Simulation.states`."""

    @abstractmethod
    def drives(self, begin: int, end: int) -> tuple[Array, Array]:
        """Returns the joints' velocities and efforts in those rows, each (rows, m), as `Simulation.joint_state`."""


class _PlainTrack(Track):
    """Asks the simulation for every row; does for every engine."""

    def __init__(self, simulation: Simulation, bodies: Sequence[int], joints: Sequence[int], rows: int) -> None:
        super().__init__(simulation, bodies, joints)
        self._states = np.empty((rows, len(bodies), 13))
        self._velocities, self._efforts = np.empty((2, rows, len(joints)))

    def note(self) -> None:
        self._states[self.rows] = self._simulation.states(self._bodies)
        readings = [self._simulation.joint_state(joint) for joint in self._joints]
        self._velocities[self.rows] = [reading.velocity for reading in readings]
        self._efforts[self.rows] = [reading.effort for reading in readings]
        self.rows += 1

    def states(self, begin: int, end: int) -> Array:
        return self._states[begin:end]

    def drives(self, begin: int, end: int) -> tuple[Array, Array]:
        return self._velocities[begin:end], self._efforts[begin:end]


class Simulation(ABC):
    """One running scene inside an engine. Never touched by two threads at a time."""

    # -- structure ----------------------------------------------------------------------------------------------

    @abstractmethod
    def add_body(self, body: int, spec: BodySpec) -> None:
        """Adds a body under a number never used before. Overlap with other bodies is allowed."""

    @abstractmethod
    def remove_body(self, body: int) -> None:
        """Removes a body that no joint holds (the World removes those first)."""

    @abstractmethod
    def add_joint(self, joint: int, spec: JointSpec) -> None:
        """Joins two bodies under a number never used before. Jointed bodies do not collide with each other."""

    @abstractmethod
    def remove_joint(self, joint: int) -> None:
        """Cuts a joint; the bodies keep their motion."""

    @abstractmethod
    def set_joint_params(self, joint: int, params: JointParams) -> None:
        """Sets motor, spring and limits of a joint. The World asks only what the capabilities promise."""

    @abstractmethod
    def set_frozen(self, body: int, frozen: bool) -> None:
        """Makes a body immovable, or movable again with zero velocity."""

    # -- state --------------------------------------------------------------------------------------------------

    @abstractmethod
    def set_body_state(self, body: int, state: BodyState) -> None:
        """Puts a body somewhere. The World moves all bodies of a jointed structure in one go, as a rigid whole."""

    @abstractmethod
    def apply(self, body: int, force: Vector, torque: Vector, impulse: Vector, angular_impulse: Vector) -> None:
        """Adds to what acts on a body's centre of mass (world coordinates) during the next step, and only then.

        A force and a torque act throughout `step`; an impulse and an angular impulse change the momentum at once
        when it begins. A frozen body ignores them.
        """

    @abstractmethod
    def body_state(self, body: int) -> BodyState:
        """Returns one body's pose and velocity."""

    @abstractmethod
    def states(self, bodies: Sequence[int]) -> Array:
        """Returns a new array (n, 13): position 3, quaternion 4 (x, y, z, w), linear 3 and angular velocity 3."""

    @abstractmethod
    def sleeping(self, body: int) -> bool:
        """Tells whether the engine has put the body to rest; a frozen body does not sleep."""

    @abstractmethod
    def joint_state(self, joint: int) -> JointState:
        """Returns one joint's reading. For `fixed` and `pin` position, velocity and effort are 0."""

    def set_motor_targets(self, joints: Sequence[int], params: Sequence[JointParams], targets: Array) -> None:
        """Sets what motors aim at, as `set_joint_params` of each in turn would. Engines may have a faster way.

        Args:
            joints: Hinges and slides.
            params: What each of them has now, but for its target; no motor is off.
            targets: Shape (n,): a velocity (rad/s or m/s) or a position (rad or m), whichever the motor drives towards.
        """
        for joint, held, target in zip(joints, params, targets.tolist(), strict=True):
            self.set_joint_params(joint, held.aimed(target))

    def joint_readings(self, joints: Sequence[int]) -> Array:
        """Returns a new array (n, 3): position, velocity and effort of hinges and slides, as `joint_state` has them."""
        states = [self.joint_state(joint) for joint in joints]
        return np.array([(s.position, s.velocity, s.effort) for s in states]).reshape(-1, 3)

    def touching(self, bodies: Sequence[int]) -> Array:
        """Returns a new array (n,): 1 for each body that touched anything in the last step, as `contacts`, else 0."""
        return np.array([float(bool(self.contacts(body))) for body in bodies])

    def powers(self, joints: Sequence[int], out: Array) -> None:
        """Writes the power of joints' motors, effort times velocity as `joint_state` has them, W.

        Args:
            joints: Asked for right after a step; the same tuple for as long as they stay the same.
            out: Array (n,).
        """
        for row, joint in enumerate(joints):
            state = self.joint_state(joint)
            out[row] = state.effort * state.velocity

    @abstractmethod
    def contacts(self, body: int) -> list[Contact]:
        """Returns what a body touched in the last step, in a deterministic order.

        A sleeping body touches what it rests on, and is touched by what rests on it.
        """

    def proper_accelerations(self, bodies: Sequence[int]) -> Array:
        """Returns a new array (n, 3): what accelerometers at the bodies' centres felt in the last engine step.

        In world coordinates, m/s^2: the acceleration less that of free fall. It is zero in free fall, and gravity's
        opposite at rest, also of frozen and sleeping bodies; zero before a body's first step. Only with capability
        `sensors.inertial`.
        """
        raise NotImplementedError

    def ranges(self, body: int, directions: Array, limit: float) -> list[float | None]:
        """Returns how far it is from a body's centre to the first surface in each direction, but not its own.

        Other bodies are where they were after the last step, edits since then unseen. A surface that the ray leaves
        through counts too. Only with capability `sensors.range`.

        Args:
            body: The body, where it is now.
            directions: World directions of unit length, shape (n, 3).
            limit: m; None is answered beyond it.
        """
        raise NotImplementedError

    def draw(self, camera: CameraSpec, colors: Mapping[int, tuple[float, float, float, float]]) -> Image:
        """Returns a picture of the bodies, as they were after the last step, and of the scenery.

        Pixels may depend on the machine; the simulation does not depend on having been drawn. Only with capability
        `camera`.

        Args:
            camera: From where it is drawn.
            colors: RGBA of the bodies, each from 0 to 1.

        Raises:
            WorldError: `unsupported`, since this machine has no renderer that the engine can use.
        """
        raise NotImplementedError

    def track(self, bodies: Sequence[int], joints: Sequence[int], rows: int) -> Track:
        """Returns what keeps up to so many rows of bodies' states, and of joints' with motors, as the scene runs.

        An engine overrides it where it can keep a row at less cost than by being asked for it.
        """
        return _PlainTrack(self, bodies, joints, rows)

    # -- time ---------------------------------------------------------------------------------------------------

    @abstractmethod
    def step(self, substeps: int) -> None:
        """Advances by `substeps` engine steps.

        Raises:
            SimulationFault: The engine cannot go on (`diverged`, `contact_overflow`, ...). The simulation must
                then be closed; nothing else may be asked of it but `states` and `body_state` as of before.
        """

    @abstractmethod
    def digest(self) -> bytes:
        """Returns 16 bytes of BLAKE2b over everything on which the future depends, as float64 bytes."""

    def snapshot(self) -> bytes:
        """Returns the whole state, such that `restore` goes on bit for bit. Only with capability `snapshot`."""
        raise NotImplementedError

    def restore(self, snapshot: bytes) -> None:
        """Takes up a state that `snapshot` of the same engine returned. Only with capability `snapshot`."""
        raise NotImplementedError

    def close(self) -> None:  # noqa: B027 - most engines have nothing to release
        """Releases what the engine holds. The simulation is not used afterwards."""


class Backend(ABC):
    """An installed physics engine. The entry point in group `nmes.backends` names the class; it takes no arguments.

    Attributes:
        name: What users call it (`mujoco`).
        dims: 3, or 2 for an engine of the XY plane.
        capabilities: Of `CAPABILITIES`, what it can do. The World answers everything else with `unsupported`.
    """

    name: str
    dims: int = 3
    capabilities: frozenset[str] = frozenset()

    @abstractmethod
    def version(self) -> str:
        """Returns the engine's version, such as `4.0.0`."""

    @abstractmethod
    def fingerprint(self) -> dict[str, str]:
        """Returns what decides whether two runs are comparable: the engine's version, the SHA-256 of its binary."""

    @abstractmethod
    def create(self, scene: SceneSpec) -> Simulation:
        """Creates an empty scene."""


def entry_points_by_name() -> dict[str, EntryPoint]:
    """Returns the installed backends' entry points, sorted by name; none of them is loaded."""
    return {point.name: point for point in sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda p: p.name)}


@cache  # looking through all that is installed takes as long as compiling a model
def _entry_point(name: str) -> EntryPoint:
    points = entry_points_by_name()
    point = points.get(name)
    if point is None:
        near = difflib.get_close_matches(name, points, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise BackendNotFound(f"no backend is called {name!r}{hint} (installed: {', '.join(points) or 'none'})")
    return point


def load_backend(name: str) -> Backend:
    """Loads a backend by name.

    Raises:
        BackendNotFound: None has that name (with the nearest names), or its engine cannot be imported.
    """
    point = _entry_point(name)
    try:
        backend = point.load()()
    except (Exception, SystemExit) as error:  # whatever a stranger's package does when it is imported
        why = f"{type(error).__name__}: {error}" if not isinstance(error, ImportError) else str(error)
        package = "its package" if point.dist is None else point.dist.name
        hint = f"; install what it needs with: pip install {package}" if isinstance(error, ImportError) else ""
        raise BackendNotFound(f"backend {name!r} ({point.value}) cannot be loaded: {why}{hint}") from error
    if not isinstance(backend, Backend):
        raise BackendNotFound(f"backend {name!r} ({point.value}) is not an nmes Backend")
    return backend
