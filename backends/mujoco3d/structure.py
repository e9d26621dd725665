"""The bodies and joints of a scene as its user wants them, and the edits that the compiled model does not have yet.

An edit only notes what changed; the model is brought up to date once, at the next step (`rebuild`). Until then
`overrides` say how new and moved bodies are.
"""

from __future__ import annotations

from nmes.backend import BodySpec, BodyState, JointParams, Vector
from nmes.backends.mujoco3d.forest import Body, Joint
from nmes.backends.mujoco3d.model import CompiledModel

__all__ = ["Structure"]

_ZERO: Vector = (0.0, 0.0, 0.0)


class Structure:
    """Bodies and joints by number, and what was edited since the last step.

    Args:
        identity: A number that stands for the scenery.

    Attributes:
        bodies: All bodies.
        joints: All joints.
        identity: The XOR of the hashes of everything that MuJoCo's state does not hold.
        overrides: The states of new and moved bodies.
        touched: The bodies whose structure was edited.
        arrived: The free bodies that came since the last step, in order.
        departed: The free bodies that went since the last step, in order.
        stale: Whether the model must be compiled again.
        wake_all: Whether everything must wake.
    """

    def __init__(self, identity: int) -> None:
        self._scenery_identity = self.identity = identity
        self.bodies: dict[int, Body] = {}
        self.joints: dict[int, Joint] = {}
        self.overrides: dict[int, BodyState] = {}
        self.touched: set[int] = set()
        self.arrived: dict[int, None] = {}
        self.departed: dict[int, None] = {}
        self.stale = True
        self.wake_all = False

    @property
    def edited(self) -> bool:
        """Whether anything was edited since the last step."""
        return bool(self.stale or self.touched or self.arrived or self.departed)

    def clear_edits(self) -> None:
        """Forgets the edits, which the model has now."""
        self.overrides.clear()
        self.touched.clear()
        self.arrived.clear()
        self.departed.clear()
        self.stale = self.wake_all = False

    def replace(self, bodies: list[Body], joints: list[Joint]) -> None:
        """Takes other bodies and joints in place of all that are here, as if the model had them."""
        self.bodies = {body.number: body for body in bodies}
        self.joints = {joint.number: joint for joint in joints}
        self.identity = self._scenery_identity
        for body in bodies:
            self.identity ^= body.identity
        for joint in joints:
            self.identity ^= joint.identity
        self.clear_edits()

    # -- edits ----------------------------------------------------------------------------------------------------

    def add_body(self, number: int, spec: BodySpec) -> None:
        """Adds a body."""
        body = self.bodies[number] = Body.from_spec(number, spec)
        self.identity ^= body.identity
        self.touched.add(number)
        velocities = (_ZERO, _ZERO) if spec.frozen else (spec.linear_velocity, spec.angular_velocity)
        self.overrides[number] = BodyState(spec.position, spec.quaternion, *velocities)
        if spec.frozen:
            self.stale = self.wake_all = True
        else:
            self.arrived[number] = None

    def remove_body(self, number: int, compiled: CompiledModel) -> None:
        """Removes a body; what slept on a frozen one wakes."""
        body = self.bodies.pop(number)
        self.identity ^= body.identity
        if body.frozen:
            self.stale = self.wake_all = True
        elif number in self.arrived:
            del self.arrived[number]
        elif number in compiled.free:
            self.departed[number] = None
        else:
            self.stale = True
        self.overrides.pop(number, None)
        self.touched.discard(number)

    def move_body(self, number: int, state: BodyState) -> None:
        """Moves a body; a frozen one stays at rest."""
        if self.bodies[number].frozen:
            state = BodyState(state.position, state.quaternion, _ZERO, _ZERO)
            self.stale = self.wake_all = True
        self.overrides[number] = state
        self.touched.add(number)

    def set_frozen(self, number: int, frozen: bool, state: BodyState) -> None:
        """Makes a body with this state part of the world, or lets it go at rest."""
        self.overrides[number] = BodyState(state.position, state.quaternion, _ZERO, _ZERO)
        body = self.bodies[number]
        self.identity ^= body.identity
        body.frozen = frozen
        self.identity ^= body.identity
        self.touched.add(number)
        for joint in self.joints.values():
            if number in (joint.body1, joint.body2):
                self.touched.update((joint.body1, joint.body2))
        self.stale = self.wake_all = True

    def add_joint(self, joint: Joint) -> None:
        """Joins two bodies."""
        self.joints[joint.number] = joint
        self.identity ^= joint.identity
        self._rejoin(joint)

    def remove_joint(self, number: int) -> None:
        """Cuts a joint."""
        joint = self.joints.pop(number)
        self.identity ^= joint.identity
        self._rejoin(joint)

    def set_joint_params(self, joint: Joint, params: JointParams) -> bool:
        """Sets a joint's parameters; returns False where its form in the model changes by that."""
        before, form = joint.params, joint.form
        self.identity ^= joint.identity
        joint.params = params
        self.identity ^= joint.identity
        if (params.motor == "off") != (before.motor == "off"):
            self.stale = True
        if joint.form != form:  # a ball gets or loses its limits
            self._rejoin(joint)
        return joint.form == form

    def hold_joint(self, joint: Joint, at: float) -> None:
        """Notes the coordinate of a joint that no model has now; 0 for one that a model has again."""
        self.identity ^= joint.identity
        joint.held_at = at + 0.0  # no negative zero, which a snapshot would leave out
        self.identity ^= joint.identity

    def _rejoin(self, joint: Joint) -> None:
        self.touched.update((joint.body1, joint.body2))
        self.stale = True

    # -- what the model is made from --------------------------------------------------------------------------------

    def lone_bodies(self, compiled: CompiledModel) -> set[int]:
        """Returns the free bodies that no joint holds, new ones included."""
        lone = compiled.free.keys() | self.arrived.keys()
        for joint in self.joints.values():
            lone -= {joint.body1, joint.body2}
        return lone
