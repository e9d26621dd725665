"""The interface of a running scene in a physics engine.

Invariants that every Simulation keeps (and that the contract tests check):

- It is deterministic: the same calls in the same order give the same digests. It reads no clock, no environment and
  no unseeded random number, and it starts no thread of which the result depends.
- Queries never change what happens later.
- Edits and forces act at the next `step`. Until then queries see edits (a new body's pose, a moved body) at once.
- What it returns is the caller's: no result aliases engine memory.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

import numpy as np

from nmes.backend.rows import Row
from nmes.backend.specs import (
    Array,
    BodySpec,
    BodyState,
    CameraSpec,
    Contact,
    Hit,
    Image,
    JointParams,
    JointSpec,
    JointState,
    Vector,
)

__all__ = ["Simulation", "Track"]


class Track(ABC):
    """A record of bodies and joints, row by row: kept at little cost while a scene runs, computed with afterwards.

    Args:
        simulation: The scene.
        bodies: The bodies whose states are kept.
        joints: The joints whose positions are kept: hinges and slides.
        motors: The joints the powers of whose motors are kept.

    Attributes:
        rows: The number of rows that are kept.
    """

    def __init__(
        self, simulation: Simulation, bodies: Sequence[int], joints: Sequence[int], motors: Sequence[int]
    ) -> None:
        self._simulation = simulation
        self._bodies, self._joints, self._motors = list(bodies), list(joints), tuple(motors)
        self.rows = 0

    @abstractmethod
    def note(self) -> None:
        """Keeps the present states and readings as the next row."""

    @abstractmethod
    def states(self, begin: int, end: int) -> Array:
        """Returns the states of the rows from `begin` to before `end`, array (rows, n, 13), as `Simulation.states`."""

    @abstractmethod
    def positions(self, begin: int, end: int) -> Array:
        """Returns the joints' positions in those rows, array (rows, m), as `Simulation.joint_state`."""

    @abstractmethod
    def powers(self, begin: int, end: int) -> Array:
        """Returns the powers of the motors in those rows, array (rows, 2, m), as `Simulation.powers`."""


class _PlainTrack(Track):
    """A track that asks the simulation for every row, which works for every engine."""

    def __init__(
        self, simulation: Simulation, bodies: Sequence[int], joints: Sequence[int], motors: Sequence[int], rows: int
    ) -> None:
        super().__init__(simulation, bodies, joints, motors)
        self._states = np.empty((rows, len(bodies), 13))
        self._positions, self._powers = np.empty((rows, len(joints))), np.empty((rows, 2, len(motors)))

    def note(self) -> None:
        if self._bodies:
            self._states[self.rows] = self._simulation.states(self._bodies)
        if self._joints:
            self._positions[self.rows] = self._simulation.joint_readings(self._joints)[:, 0]
        self._simulation.powers(self._motors, self._powers[self.rows])
        self.rows += 1

    def states(self, begin: int, end: int) -> Array:
        return self._states[begin:end]

    def positions(self, begin: int, end: int) -> Array:
        return self._positions[begin:end]

    def powers(self, begin: int, end: int) -> Array:
        return self._powers[begin:end]


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
        """Makes a body immovable, or movable again with zero velocity; what was to act on it is dropped."""

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
        """Returns one joint's reading. For `fixed` and `pin` position, velocity and effort are 0.

        For `conetwist` they are of its twist, from -pi to pi, and the effort is 0.
        """

    def set_motor_targets(self, joints: Sequence[int], params: Sequence[JointParams], targets: Array) -> None:
        """Sets the targets of motors, as `set_joint_params` of each in turn would. Engines may have a faster way.

        Args:
            joints: Hinges and slides.
            params: The present parameters of each, but for its target; no motor is off.
            targets: Shape (n,): a velocity (rad/s or m/s) or a position (rad or m), whichever the motor drives towards.
        """
        for joint, own, target in zip(joints, params, targets.tolist(), strict=True):
            self.set_joint_params(joint, own.with_target(target))

    def joint_readings(self, joints: Sequence[int]) -> Array:
        """Returns a new array (n, 3): position, velocity and effort of hinges and slides, as `joint_state` has them."""
        states = [self.joint_state(joint) for joint in joints]
        return np.array([(s.position, s.velocity, s.effort) for s in states]).reshape(-1, 3)

    def touching(self, bodies: Sequence[int]) -> Array:
        """Returns a new array (n,): 1 for each body that touched anything in the last step, as `contacts`, else 0."""
        return np.array([float(bool(self.contacts(body))) for body in bodies])

    def powers(self, joints: Sequence[int], out: Array) -> None:
        """Writes what joints' motors gave in the last step: their mean power, and the mean size of it, W.

        The mean power times the length of the step is the work that the motor did on the scene. So an engine with
        motors overrides this, unless what it tells as a step ends is so throughout the step.

        Args:
            joints: Asked for right after a step; the same tuple for as long as they stay the same.
            out: Array (2, n).
        """
        for column, joint in enumerate(joints):
            state = self.joint_state(joint)
            power = state.effort * state.velocity
            out[:, column] = power, abs(power)

    @abstractmethod
    def contacts(self, body: int) -> list[Contact]:
        """Returns the contacts of a body in the last step, in a deterministic order.

        A sleeping body touches what it rests on, and is touched by what rests on it.
        """

    def guess_contacts(self, body: int) -> int | None:
        """Returns about how many contacts `contacts` has to look at for a body, which must be cheap to tell.

        Hosts ask, so that nobody waits for a floor on which thousands lie. None, as by default: as many as there are
        cubes.
        """
        return None

    def proper_accelerations(self, bodies: Sequence[int]) -> Array:
        """Returns a new array (n, 3): the readings of accelerometers at the bodies' centres in the last engine step.

        In world coordinates, m/s^2: the acceleration less that of free fall. It is zero in free fall, and gravity's
        opposite at rest, also of frozen and sleeping bodies; zero before a body's first step. Only with capability
        `sensors.inertial`.
        """
        raise NotImplementedError

    def hits(self, body: int, directions: Array, limit: float) -> list[Hit | None]:
        """Returns the first surface along each ray from a body's centre that is not its own.

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
            camera: The view.
            colors: RGBA of the bodies, each from 0 to 1.

        Raises:
            WorldError: `unsupported`, since this machine has no renderer that the engine can use.
        """
        raise NotImplementedError

    def track(self, bodies: Sequence[int], joints: Sequence[int], motors: Sequence[int], rows: int) -> Track:
        """Returns a Track that keeps up to `rows` rows of bodies' states, joints' positions and motors' powers.

        An engine overrides it where it can keep a row at less cost than by being asked for it.
        """
        return _PlainTrack(self, bodies, joints, motors, rows)

    # -- time ---------------------------------------------------------------------------------------------------

    def hand_over(self) -> Row | None:
        """Gives the scene away as it is now, to go on as a row (see `nmes.backend.rows`); this one is then closed.

        Returns:
            The row; None, with nothing changed, where the engine has no rows, or the scene is none that can be one now:
            it may be one after the next step.
        """
        return None

    @abstractmethod
    def step(self, substeps: int) -> None:
        """Advances by `substeps` engine steps.

        Raises:
            SimulationFault: The engine cannot go on (`diverged`, `contact_overflow`, ...). The simulation must
                then be closed, or made fit again by `recover`; nothing else may be asked of it but `states` and
                `body_state` as of before.
        """

    def recover(self) -> bool:
        """Makes a simulation whose step failed fit to go on, from the state before that step.

        What was to act on bodies in that step acts in the next one.
        What made it fail is still there: whoever goes on takes it away before the next step.

        Returns:
            Whether it is fit; False, with nothing changed, where the engine cannot.
        """
        return False

    @abstractmethod
    def digest(self) -> bytes:
        """Returns the 16 bytes of BLAKE2b over everything that decides the future, as float64 bytes."""

    def snapshot(self) -> bytes:
        """Returns the whole state, such that `restore` goes on bit for bit. Only with capability `snapshot`."""
        raise NotImplementedError

    def restore(self, snapshot: bytes) -> None:
        """Takes up a state that `snapshot` of the same engine returned. Only with capability `snapshot`.

        Raises:
            WorldError: `bad_snapshot`: the bytes are no such state. They may be anybody's: whatever is taken up must
                go on without a fault of the adapter's. The simulation must then be closed.
        """
        raise NotImplementedError

    def members(self) -> tuple[dict[int, bool], dict[int, tuple[str, int, int]]]:
        """Returns the bodies, each with whether it is frozen, and the joints: kind, body1 and body2.

        Only with capability `snapshot`: a World holds what was restored against what it says of itself.
        """
        raise NotImplementedError

    def close(self) -> None:  # noqa: B027 - most engines have nothing to release
        """Releases what the engine holds. The simulation is not used afterwards."""
