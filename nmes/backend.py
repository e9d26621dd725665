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
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from nmes.errors import BackendNotFound

__all__ = [
    "CAPABILITIES",
    "Backend",
    "BodySpec",
    "BodyState",
    "Contact",
    "JointParams",
    "JointSpec",
    "JointState",
    "SceneSpec",
    "Simulation",
    "entry_points_by_name",
    "load_backend",
]

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  # x, y, z, w
Array = npt.NDArray[np.float64]

ENTRY_POINT_GROUP = "nmes.backends"

CAPABILITIES = frozenset(
    {"joint.fixed", "joint.hinge", "joint.slide", "joint.pin", "joint.conetwist"}  # kinds of joints
    | {"motor", "servo", "spring", "limits"}  # what hinges and slides have; `limits` are also a conetwist's
    | {"collisions", "friction", "restitution", "contacts"}  # between bodies; on the ground; and whether it tells
    | {"sleep", "snapshot"}
)


@dataclass(frozen=True, slots=True)
class SceneSpec:
    """What a scene is before any body is in it.

    Attributes:
        timestep: Length of one engine step, s.
        gravity: Acceleration of free fall, m/s^2.
        max_bodies: How many bodies may exist at once; a hint for memory.
        ground: Whether the flat ground y = 0 is there.
        options: The world config's `engine` object: settings of one engine, which it validates itself.
    """

    timestep: float
    gravity: Vector = (0.0, -9.81, 0.0)
    max_bodies: int = 10_000
    ground: bool = True
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


@dataclass(frozen=True, slots=True)
class Contact:
    """One touching partner of a body, as of the last step: `other` is a body, or None for the ground and scenery.

    `normal` points from the other into the body (world, unit); `force` is the normal force in N.
    """

    other: int | None
    position: Vector
    normal: Vector
    force: float


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

    @abstractmethod
    def contacts(self, body: int) -> list[Contact]:
        """Returns what a body touched in the last step, in a deterministic order."""

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


def load_backend(name: str) -> Backend:
    """Loads a backend by name.

    Raises:
        BackendNotFound: None has that name (with the nearest names), or its engine cannot be imported.
    """
    points = entry_points_by_name()
    point = points.get(name)
    if point is None:
        near = difflib.get_close_matches(name, points, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise BackendNotFound(f"no backend is called {name!r}{hint} (installed: {', '.join(points) or 'none'})")
    try:
        backend = point.load()()
    except Exception as error:  # whatever a stranger's package does when it is imported
        raise BackendNotFound(f"backend {name!r} ({point.value}) cannot be loaded: {error}") from error
    if not isinstance(backend, Backend):
        raise BackendNotFound(f"backend {name!r} ({point.value}) is not an nmes Backend")
    return backend
