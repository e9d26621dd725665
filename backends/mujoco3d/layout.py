"""From bodies and joints to a compiled MuJoCo model: the spanning forest, its kinematic trees, loops and motors.

The joint graph's spanning forest becomes MuJoCo's kinematic trees; what is left over closes loops. Each joint keeps
its own frames, fixed when it is made, in the direction from `body1` to `body2`: its coordinate means the same
whichever way the tree happens to run, so re-rooting a structure never flips a sign or moves a zero.

A loop is closed by equality constraints. A hinge or slide that closes one is kept as a real joint all the same, with
its limits, its motor and its reading: it leads to a *twin*, a body that shares the mass of the cube which it stands
for and is welded to it. Splitting the mass instead of adding some keeps the structure's inertia exact and well
conditioned.

Invariants: the model is a function of the scene, the bodies, the joints and the forest alone, never of the current
poses (free roots are placed at the origin), so a restored simulation compiles the very same model; and the forest is
stable: adding a joint never takes another one out of the tree.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from math import log, pi, sqrt

import mujoco

from nmes.backend import JointParams, Quaternion, SceneSpec, Vector
from nmes.rotation import conjugate, multiply, rotate

__all__ = ["Body", "Forest", "Joint", "Layout", "Slot", "build", "span"]

# Body frame of the ground plane: MuJoCo's planes face z, ours faces y.
_FACE_UP = [sqrt(0.5), -sqrt(0.5), 0.0, 0.0]
_KINDS = {
    "hinge": mujoco.mjtJoint.mjJNT_HINGE,
    "slide": mujoco.mjtJoint.mjJNT_SLIDE,
    "pin": mujoco.mjtJoint.mjJNT_BALL,
}
_COORDINATES = {"hinge": (1, 1), "slide": (1, 1), "pin": (4, 3)}  # nq, nv of a joint
# Contact softness (MuJoCo's solref, solimp): a contact at rest settles in about 0.02 s.
_CONTACT_TIME = 0.02
# Loops are closed as stiffly as the time step allows.
_LOOP_SOLIMP = [0.95, 0.999, 0.0005, 0.5, 2.0]
_MEBIBYTE = 1 << 20


@dataclass(slots=True)
class Body:
    """A box as the model needs it; see `nmes.backend.BodySpec` for units."""

    number: int
    size: Vector
    mass: float
    friction: float
    restitution: float
    frozen: bool


@dataclass(slots=True)
class Joint:
    """A joint in its bodies' own frames, in one canonical direction.

    Attributes:
        anchor1: Anchor in the frame of body1, m; `anchor2` the same point in the frame of body2.
        axis2: Axis in the frame of body2 (where body2 is turned about the axis, it is the same in both).
        zero: Orientation of body2 relative to body1 at coordinate zero.
    """

    number: int
    kind: str
    body1: int
    body2: int
    anchor1: Vector
    anchor2: Vector
    axis2: Vector
    zero: Quaternion
    params: JointParams


@dataclass(slots=True)
class Forest:
    """Which joints make up the trees. `parent` maps each body that is not a root to its parent and the joint there."""

    order: list[int] = field(default_factory=list)  # parents before their children
    parent: dict[int, tuple[int, Joint]] = field(default_factory=dict)
    loops: list[Joint] = field(default_factory=list)


@dataclass(slots=True)
class Slot:
    """Where in `qpos` and `qvel` a coordinate lives. `flipped`: the tree runs from body2 to body1 there."""

    q: int
    nq: int
    v: int
    nv: int
    flipped: bool = False


@dataclass(slots=True)
class Layout:
    """A compiled model and where everything is in it."""

    model: mujoco.MjModel
    forest: Forest
    body: dict[int, int] = field(default_factory=dict)  # body number -> index in the model
    number: dict[int, int] = field(default_factory=dict)  # index in the model -> body number (twins: whose they are)
    key: dict[int, int] = field(default_factory=dict)  # index -> a name that outlives the model, twins included
    free: dict[int, Slot] = field(default_factory=dict)  # body number of a free root -> coordinates
    joint: dict[int, Slot] = field(default_factory=dict)  # joint number -> coordinates
    joint_index: dict[int, int] = field(default_factory=dict)
    actuator: dict[int, int] = field(default_factory=dict)  # joint number -> actuator
    twin: dict[int, tuple[int, int]] = field(default_factory=dict)  # joint number -> (index, body it stands for)
    share: dict[int, float] = field(default_factory=dict)  # body number -> part of its mass that it kept itself


def span(bodies: dict[int, Body], joints: Iterable[Joint]) -> Forest:
    """Finds the spanning forest: older joints first, roots at the frozen bodies, else at the oldest one.

    Frozen bodies count as one, the world; a joint between two of them does nothing and is left out.
    """
    leader = {number: number for number in bodies}

    def find(number: int) -> int:
        while leader[number] != number:
            leader[number] = leader[leader[number]]
            number = leader[number]
        return number

    frozen = [number for number, body in bodies.items() if body.frozen]
    for number in frozen[1:]:
        leader[number] = frozen[0]
    neighbours: dict[int, list[tuple[int, Joint]]] = {number: [] for number in bodies}
    forest = Forest()
    for joint in joints:
        a, b = joint.body1, joint.body2
        if bodies[a].frozen and bodies[b].frozen:
            continue
        root_a, root_b = find(a), find(b)
        if root_a == root_b:
            forest.loops.append(joint)
            continue
        # The older leads, but the world before all: then a root is found without a second pass.
        leader[root_b] = root_a
        neighbours[a].append((b, joint))
        neighbours[b].append((a, joint))
    seen: set[int] = set()
    for root in [*frozen, *bodies]:
        if root in seen:
            continue
        seen.add(root)
        forest.order.append(root)
        stack = [root]
        while stack:
            here = stack.pop()
            for child, joint in neighbours[here]:
                if child not in seen and not bodies[child].frozen:
                    seen.add(child)
                    forest.parent[child] = (here, joint)
                    forest.order.append(child)
                    stack.append(child)
    return forest


def build(
    scene: SceneSpec,
    bodies: dict[int, Body],
    joints: dict[int, Joint],
    forest: Forest,
    frozen_at: dict[int, tuple[Vector, Quaternion]],
) -> Layout:
    """Compiles the model. `frozen_at` gives the poses of the frozen bodies."""
    spec = mujoco.MjSpec()
    _options(spec, scene, len(bodies))
    if scene.ground:
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], quat=_FACE_UP)

    twins_of: dict[int, int] = {}
    for joint in forest.loops:
        if joint.kind in ("hinge", "slide"):
            twins_of[_stands_for(joint, bodies)] = twins_of.get(_stands_for(joint, bodies), 0) + 1
    share = {number: 1.0 / (1 + twins_of.get(number, 0)) for number in bodies}

    handles: dict[int, mujoco.MjsBody] = {}
    free: dict[int, mujoco.MjsJoint] = {}
    made: dict[int, mujoco.MjsJoint] = {}
    twins: dict[int, mujoco.MjsBody] = {}
    flipped: set[int] = set()
    for number in forest.order:
        body = bodies[number]
        link = forest.parent.get(number)
        if link is not None:
            parent, joint = link
            if number == joint.body1:
                flipped.add(joint.number)
            handle, hinge = _attach(handles[parent], joint, number == joint.body1, f"b{number}")
            if hinge is not None:
                made[joint.number] = hinge
        elif body.frozen:
            position, q = frozen_at[number]
            handle = spec.worldbody.add_body(name=f"b{number}", pos=position, quat=_wxyz(q))
        else:
            handle = spec.worldbody.add_body(name=f"b{number}")
            free[number] = handle.add_freejoint()
        handles[number] = handle
        handle.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[edge / 2 for edge in body.size],
            mass=body.mass * share[number],
            friction=[body.friction, 0.005, 0.0001],
            solref=_bounce(body.restitution, scene.timestep),
            priority=1,  # over the ground, which has no surface of its own
        )

    solref = [2.0 * scene.timestep, 1.0]
    for joint in forest.loops:
        _close(spec, joint, bodies, handles, made, twins, flipped, share, solref)
    for joint in joints.values():
        spec.add_exclude(bodyname1=f"b{joint.body1}", bodyname2=f"b{joint.body2}")
    actuators = {
        number: spec.add_actuator(
            name=f"m{number}",
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            target=f"j{number}",
            biastype=mujoco.mjtBias.mjBIAS_AFFINE,
            forcelimited=True,
            forcerange=[-1.0, 1.0],
        )
        for number in made
        if joints[number].params.motor != "off"
    }

    model = spec.compile()
    layout = Layout(model, forest, share=share)
    for number, handle in handles.items():
        layout.body[number] = handle.id
        layout.number[handle.id], layout.key[handle.id] = number, 2 * number
    for number, hinge in free.items():
        layout.free[number] = Slot(int(model.jnt_qposadr[hinge.id]), 7, int(model.jnt_dofadr[hinge.id]), 6)
    for number, hinge in made.items():
        nq, nv = _COORDINATES[joints[number].kind]
        at, dof = int(model.jnt_qposadr[hinge.id]), int(model.jnt_dofadr[hinge.id])
        layout.joint[number] = Slot(at, nq, dof, nv, number in flipped)
        layout.joint_index[number] = hinge.id
    for number, actuator in actuators.items():
        layout.actuator[number] = actuator.id
    for number, twin in twins.items():
        layout.twin[number] = (twin.id, _stands_for(joints[number], bodies))
        layout.number[twin.id], layout.key[twin.id] = layout.twin[number][1], 2 * number + 1
    return layout


def _options(spec: mujoco.MjSpec, scene: SceneSpec, bodies: int) -> None:
    option = spec.option
    option.timestep = scene.timestep
    option.gravity = list(scene.gravity)
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST  # motors and dampers stay stable at any gain
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 10.0  # friction that holds: at 1 a cube creeps down a slope that should hold it
    disable, enable = mujoco.mjtDisableBit, mujoco.mjtEnableBit
    # AUTORESET: on its own MuJoCo puts a diverged world silently back to its start. FILTERPARENT: only jointed cubes
    # are kept from colliding, and those we name.
    option.disableflags |= disable.mjDSBL_AUTORESET | disable.mjDSBL_FILTERPARENT
    option.enableflags |= enable.mjENBL_SLEEP
    # The arena is address space until it is used; the default for a big scene is too small to compile.
    spec.memory = max(_MEBIBYTE // 2, min(bodies * _MEBIBYTE, 2048 * _MEBIBYTE)) if bodies > 4 else _MEBIBYTE // 2


def _stands_for(joint: Joint, bodies: dict[int, Body]) -> int:
    """The body whose mass a loop joint's twin shares: body2, unless that one is frozen and has no mass to share."""
    return joint.body1 if bodies[joint.body2].frozen else joint.body2


def _attach(
    parent: mujoco.MjsBody, joint: Joint, flipped: bool, name: str
) -> tuple[mujoco.MjsBody, mujoco.MjsJoint | None]:
    """Adds a child at coordinate zero, with the joint in it; body2 under body1, or the other way round if flipped."""
    if flipped:
        turn, at_parent, at_child = conjugate(joint.zero), joint.anchor2, joint.anchor1
        axis = rotate(joint.zero, joint.axis2)
        # The coordinate is the motion of body2 relative to body1; here body1 moves, the other way.
        axis = (-axis[0], -axis[1], -axis[2])
    else:
        turn, at_parent, at_child, axis = joint.zero, joint.anchor1, joint.anchor2, joint.axis2
    arm = rotate(turn, at_child)
    position = [at_parent[i] - arm[i] for i in range(3)]
    child = parent.add_body(name=name, pos=position, quat=_wxyz(turn))
    if joint.kind == "fixed":
        return child, None
    return child, child.add_joint(name=f"j{joint.number}", type=_KINDS[joint.kind], pos=at_child, axis=axis)


def _close(
    spec: mujoco.MjSpec,
    joint: Joint,
    bodies: dict[int, Body],
    handles: dict[int, mujoco.MjsBody],
    made: dict[int, mujoco.MjsJoint],
    twins: dict[int, mujoco.MjsBody],
    flipped: set[int],
    share: dict[int, float],
    solref: list[float],
) -> None:
    """Closes a loop: a ball by one connection, a fixed joint by a weld, the others by a twin welded to its cube."""
    if joint.kind == "pin":
        # Sites, since between bodies the compiler would take the second anchor from the poses at coordinate zero.
        for end, anchor in ((joint.body1, joint.anchor1), (joint.body2, joint.anchor2)):
            handles[end].add_site(name=f"s{joint.number}_{end}", pos=anchor)
        spec.add_equality(
            type=mujoco.mjtEq.mjEQ_CONNECT,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            name1=f"s{joint.number}_{joint.body1}",
            name2=f"s{joint.number}_{joint.body2}",
            solref=solref,
            solimp=_LOOP_SOLIMP,
        )
        return
    if joint.kind == "fixed":
        first, second = f"b{joint.body1}", f"b{joint.body2}"
        # The anchor in the frame of the second body, then in that of the first, then how the second is turned in it.
        data = [*joint.anchor2, *joint.anchor1, *_wxyz(joint.zero), 1.0, 0.0]
    else:
        number = _stands_for(joint, bodies)
        turned = number == joint.body1
        twin, hinge = _attach(handles[joint.body2 if turned else joint.body1], joint, turned, f"t{joint.number}")
        assert hinge is not None
        body = bodies[number]
        mass = body.mass * share[number]
        x, y, z = (edge * edge for edge in body.size)
        twin.explicitinertial = True
        twin.ipos, twin.iquat = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]
        twin.mass = mass
        twin.inertia = [mass * (y + z) / 12.0, mass * (x + z) / 12.0, mass * (x + y) / 12.0]
        made[joint.number], twins[joint.number] = hinge, twin
        if turned:
            flipped.add(joint.number)
        first, second = f"t{joint.number}", f"b{number}"
        data = [0.0] * 6 + [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    spec.add_equality(
        type=mujoco.mjtEq.mjEQ_WELD,
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        name1=first,
        name2=second,
        data=data,
        solref=solref,
        solimp=_LOOP_SOLIMP,
    )


def _bounce(restitution: float, timestep: float) -> list[float]:
    """Contact spring (time constant, damping ratio) of which a body comes back with `restitution` times its speed.

    A damped oscillator that leaves after half a period keeps exp(-pi z / sqrt(1 - z^2)) of its speed.
    """
    if restitution <= 0.0:
        return [_CONTACT_TIME, 1.0]
    if restitution >= 1.0:
        ratio = 1e-3
    else:
        decay = -log(restitution)
        ratio = max(1e-3, decay / sqrt(pi * pi + decay * decay))
    return [2.0 * timestep / ratio, ratio]


def _wxyz(q: Quaternion) -> list[float]:
    return [q[3], q[0], q[1], q[2]]


def relative(q1: Quaternion, q2: Quaternion) -> Quaternion:
    """Returns the orientation of 2 in the frame of 1."""
    return multiply(conjugate(q1), q2)
