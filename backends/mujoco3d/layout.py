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

import hashlib
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import log, pi, sin, sqrt
from typing import Any

import mujoco
import numpy as np

from nmes.backend import JointParams, Quaternion, SceneSpec, Vector
from nmes.backend.rotation import conjugate, cross, multiply, rotate
from nmes.backends.mujoco3d.scenery import Scenery, set_options

__all__ = ["Body", "Forest", "Joint", "Layout", "Slot", "across", "build", "relative", "span"]

SPARE = -1
"""In place of a root: a parked body, ready to become the next free one without compiling the model anew."""

# What depends on a free body's mass and shape in a model (seen by comparing models; a test does so still).
_OF_BODY = (
    "body_mass",
    "body_inertia",
    "body_invweight0",
    "body_subtreemass",
    "body_contype",
    "body_conaffinity",
)
_OF_GEOM = (
    "geom_size",
    "geom_aabb",
    "geom_rbound",
    "geom_friction",
    "geom_solref",
    "geom_rgba",
    "geom_contype",
    "geom_conaffinity",
)
_OF_DOF = ("dof_M0", "dof_invweight0", "dof_length")
_KINDS = {
    "hinge": mujoco.mjtJoint.mjJNT_HINGE,
    "slide": mujoco.mjtJoint.mjJNT_SLIDE,
    "ball": mujoco.mjtJoint.mjJNT_BALL,
}
_COORDINATES = {"hinge": (1, 1), "slide": (1, 1), "ball": (4, 3), "cone": (3, 3)}  # nq, nv by form
_TWINNED = frozenset({"hinge", "slide", "cone"})  # forms that close a loop by way of a twin
_WIDEST_SWING = 1.4  # rad: a cone's two swinging hinges fall together at a right angle
_SERVO_RATE = 60.0  # 1/s: a strong servo closes 63% of a small error in 1/30 s
# Contact softness (MuJoCo's solref, solimp): a contact at rest settles in about 0.02 s.
_CONTACT_TIME = 0.02
# Loops are closed as stiffly as the time step allows.
_LOOP_SOLIMP = [0.95, 0.999, 0.0005, 0.5, 2.0]
_KIBIBYTE = 1 << 10


def _hash(*parts: object) -> int:
    return int.from_bytes(hashlib.blake2b(repr(parts).encode(), digest_size=16).digest(), "little")


@dataclass(slots=True)
class Body:
    """A box as the model needs it; see `nmes.backend.BodySpec` for units."""

    number: int
    size: Vector
    mass: float
    friction: float
    restitution: float
    frozen: bool

    @classmethod
    def read(cls, given: dict[str, Any]) -> Body:
        """Returns what was written down as JSON."""
        return cls(**{**given, "size": tuple(given["size"])})

    @property
    def identity(self) -> int:
        """A hash of all that MuJoCo's state does not say."""
        return _hash("body", self.number, self)


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

    @classmethod
    def read(cls, given: dict[str, Any]) -> Joint:
        """Returns what was written down as JSON."""
        vectors = {name: tuple(value) for name, value in given.items() if isinstance(value, list)}
        params: dict[str, Any] = dict(given["params"])
        if params["limits"] is not None:
            params["limits"] = tuple(params["limits"])
        return cls(**{**given, **vectors, "params": JointParams(**params)})

    @property
    def identity(self) -> int:
        """A hash of all that MuJoCo's state does not say."""
        # A motor's targets are in the state as controls; leaving them out here keeps setting one cheap.
        return _hash("joint", replace(self, params=replace(self.params, target_velocity=0.0, target_position=0.0)))

    @property
    def form(self) -> str:
        """What it is in the model: `fixed`, `hinge`, `slide`, `ball`, or `cone`, a ball with limits.

        A cone is three hinges, two that swing the axis and one that twists about it, so that swing and twist have
        limits of their own; it has no freedom to lose while the swing stays under a right angle.
        """
        if self.kind in ("pin", "conetwist"):
            return "ball" if self.params.limits is None else "cone"
        return self.kind


@dataclass(slots=True)
class Forest:
    """Which joints make up the trees. `parent` maps each body that is not a root to its parent and the joint there."""

    trees: dict[int, list[int]] = field(default_factory=dict)  # by root; parents before their children
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
    roots: list[int]  # of the trees, in the order of the model; SPARE for a parked body
    place: dict[int, int] = field(default_factory=dict)  # index of a root or a parked body -> where it is in `roots`
    spares: list[int] = field(default_factory=list)  # indices of the parked bodies, ascending
    body: dict[int, int] = field(default_factory=dict)  # body number -> index in the model
    number: dict[int, int] = field(default_factory=dict)  # index in the model -> body number (twins: whose they are)
    key: dict[int, int] = field(default_factory=dict)  # index -> a name that outlives the model, twins included
    free: dict[int, Slot] = field(default_factory=dict)  # body number of a free root -> coordinates
    joint: dict[int, Slot] = field(default_factory=dict)  # joint number -> coordinates
    joint_index: dict[int, int] = field(default_factory=dict)
    actuator: dict[int, int] = field(default_factory=dict)  # joint number -> actuator
    twin: dict[int, tuple[int, int]] = field(default_factory=dict)  # joint number -> (index, body it stands for)
    swing: dict[int, int] = field(default_factory=dict)  # joint number of a cone -> the tendon that bounds its swing


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
        forest.trees[root] = tree = [root]
        stack = [root]
        while stack:
            here = stack.pop()
            for child, joint in neighbours[here]:
                if child not in seen and not bodies[child].frozen:
                    seen.add(child)
                    forest.parent[child] = (here, joint)
                    tree.append(child)
                    stack.append(child)
    return forest


def build(
    scene: SceneSpec,
    scenery: Scenery,
    bodies: dict[int, Body],
    joints: dict[int, Joint],
    forest: Forest,
    frozen_at: dict[int, tuple[Vector, Quaternion]],
    roots: Sequence[int],
) -> Layout:
    """Compiles the model.

    Args:
        scene: Time step, gravity and the rest.
        scenery: What stands still.
        bodies: All bodies by number; `joints` likewise.
        joints: See above.
        forest: Their spanning forest.
        frozen_at: The poses of the frozen bodies.
        roots: The roots of the trees in the order in which the model has them; SPARE stands for a parked body.
    """
    layout = _Builder(scene, bodies, joints, forest).build(scenery, frozen_at, roots)
    for index in layout.spares:
        park(layout.model, index)
    weigh(layout)
    return layout


def occupy(layout: Layout, scene: SceneSpec, body: Body) -> int:
    """Lets a free body take the first parked one's place; returns its index. The model is as if compiled with it."""
    model, index = layout.model, layout.spares.pop(0)
    lone = _lone(scene.timestep, body.size, body.mass, body.friction, body.restitution)
    geom, dof = int(model.body_geomadr[index]), int(model.body_dofadr[index])
    for names, rows, source in (
        (_OF_BODY, slice(index, index + 1), slice(1, 2)),
        (_OF_GEOM, slice(geom, geom + 1), slice(0, 1)),
        (_OF_DOF, slice(dof, dof + 6), slice(0, 6)),
    ):
        for name in names:
            getattr(model, name)[rows] = getattr(lone, name)[source]
    model.bvh_aabb[model.body_bvhadr[index]] = lone.bvh_aabb[lone.body_bvhadr[1]]
    joint = int(model.body_jntadr[index])
    layout.roots[layout.place[index]] = body.number
    layout.body[body.number] = index
    layout.number[index], layout.key[index] = body.number, 2 * body.number
    layout.free[body.number] = Slot(int(model.jnt_qposadr[joint]), 7, dof, 6)
    return index


def vacate(layout: Layout, body: int) -> int:
    """Parks a free body that no joint holds; returns its index."""
    index = layout.body.pop(body)
    del layout.number[index], layout.key[index], layout.free[body]
    layout.roots[layout.place[index]] = SPARE
    layout.spares.append(index)
    layout.spares.sort()
    park(layout.model, index)
    return index


def park(model: mujoco.MjModel, index: int) -> None:
    """Makes a body touch nothing, and no ray meet it. It is never woken, so it costs nothing, too."""
    model.geom_rgba[model.body_geomadr[index], 3] = 0.0
    for name in ("contype", "conaffinity"):
        getattr(model, f"geom_{name}")[model.body_geomadr[index]] = 0
        getattr(model, f"body_{name}")[index] = 0


def weigh(layout: Layout) -> None:
    """Sets the inertia by which the solver judges its error to that of the bodies in use, as MuJoCo would."""
    model = layout.model
    used = np.ones(model.nv, bool)
    for index in layout.spares:
        used[model.body_dofadr[index] : model.body_dofadr[index] + 6] = False
    if used.any():
        model.stat.meaninertia = float(model.dof_M0[used].mean())


def write_params(layout: Layout, joint: Joint) -> None:
    """Writes a joint's motor, spring and limits into the model; a motor's target is a control of the data."""
    model, params = layout.model, joint.params
    index, slot = layout.joint_index[joint.number], layout.joint[joint.number]
    if joint.form == "ball":
        return
    if joint.form == "cone":
        assert params.limits is not None
        swing, twist = params.limits
        # In the order of the tree the twist comes last, or first where the tree runs from body2 to body1.
        twisting = index if slot.flipped else index + 2
        model.jnt_limited[twisting] = True
        model.jnt_range[twisting] = (-twist, twist)
        chord = 2.0 * sin(min(max(swing, 0.0), _WIDEST_SWING) / 2.0)
        model.tendon_range[layout.swing[joint.number]] = (0.0, max(chord, 1e-6))
        return
    model.jnt_stiffness[index] = params.stiffness
    model.dof_damping[slot.v] = params.damping
    model.jnt_limited[index] = params.limits is not None
    model.jnt_range[index] = params.limits or (0.0, 0.0)
    motor = layout.actuator.get(joint.number)
    if motor is None:
        return
    # What the two sides weigh against each other along this joint.
    inertia = 1.0 / max(float(model.dof_invweight0[slot.v]), 1e-12)
    gain, bias = np.zeros(model.actuator_gainprm.shape[1]), np.zeros(model.actuator_biasprm.shape[1])
    if params.motor == "velocity" and params.max_effort > 0.0:
        # As stiff as can be without overshooting when the bound on the effort is what stops it: one step at the
        # bound then ends within the band in which the drive is linear.
        gain[0] = 2.0 * inertia / model.opt.timestep
        bias[2] = -gain[0]
    elif params.motor == "position" and params.max_effort > 0.0:
        gain[0] = inertia * _SERVO_RATE * _SERVO_RATE
        # Critically damped; and where the bound is low, damped so much that from one unit away (rad or m) the bound is
        # enough to brake: at full effort that takes half the root of unit * inertia / effort.
        brake = 0.5 * gain[0] * sqrt(inertia / params.max_effort)
        bias[1], bias[2] = -gain[0], -max(2.0 * inertia * _SERVO_RATE, brake)
    model.actuator_gainprm[motor], model.actuator_biasprm[motor] = gain, bias
    bound = max(params.max_effort, 1e-300)
    model.actuator_forcerange[motor] = (-bound, bound)


@lru_cache(maxsize=64)
def _lone(timestep: float, size: Vector, mass: float, friction: float, restitution: float) -> mujoco.MjModel:
    """Compiles a model of one free body: what the compiler makes of its mass and shape."""
    bodies = {1: Body(1, size, mass, friction, restitution, frozen=False)}
    return _Builder(SceneSpec(timestep=timestep), bodies, {}, span(bodies, ())).build(None, {}, [1]).model


class _Builder:
    """One model in the making."""

    def __init__(self, scene: SceneSpec, bodies: dict[int, Body], joints: dict[int, Joint], forest: Forest) -> None:
        self.scene, self.bodies, self.joints, self.forest = scene, bodies, joints, forest
        self.spec = mujoco.MjSpec()
        self.handles: dict[int, mujoco.MjsBody] = {}
        self.free: dict[int, mujoco.MjsJoint] = {}
        self.made: dict[int, mujoco.MjsJoint] = {}  # joint number -> its (first) joint in the model
        self.twins: dict[int, mujoco.MjsBody] = {}
        self.flipped: set[int] = set()
        self.swings: dict[int, mujoco.MjsTendon] = {}
        twins = Counter(self._stands_for(joint) for joint in forest.loops if joint.form in _TWINNED)
        self.share = {number: 1.0 / (1 + twins[number]) for number in bodies}

    def build(
        self, scenery: Scenery | None, frozen_at: dict[int, tuple[Vector, Quaternion]], roots: Sequence[int]
    ) -> Layout:
        spec = self.spec
        _options(spec, self.scene, len(roots) + len(self.forest.parent))
        if scenery is not None:
            scenery.add(spec)
        places: list[mujoco.MjsBody] = []
        for root in roots:
            if root == SPARE:
                places.append(self._spare(len(places)))
            else:
                for number in self.forest.trees[root]:
                    self._add(self.bodies[number], frozen_at.get(number))
                places.append(self.handles[root])
        for joint in self.forest.loops:
            self._close(joint)
        for joint in self.joints.values():
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
            for number in self.made
            if self.joints[number].params.motor != "off"
        }
        model = spec.compile()
        layout = Layout(model, self.forest, list(roots))
        for place, (root, handle) in enumerate(zip(roots, places, strict=True)):
            layout.place[handle.id] = place
            if root == SPARE:
                layout.spares.append(handle.id)
        for number, handle in self.handles.items():
            layout.body[number] = handle.id
            layout.number[handle.id], layout.key[handle.id] = number, 2 * number
        for number, free in self.free.items():
            layout.free[number] = Slot(int(model.jnt_qposadr[free.id]), 7, int(model.jnt_dofadr[free.id]), 6)
        for number, made in self.made.items():
            nq, nv = _COORDINATES[self.joints[number].form]
            at, dof = int(model.jnt_qposadr[made.id]), int(model.jnt_dofadr[made.id])
            layout.joint[number] = Slot(at, nq, dof, nv, number in self.flipped)
            layout.joint_index[number] = made.id
        for number, actuator in actuators.items():
            layout.actuator[number] = actuator.id
        for number, swing in self.swings.items():
            layout.swing[number] = swing.id
        for number, twin in self.twins.items():
            layout.twin[number] = (twin.id, self._stands_for(self.joints[number]))
            layout.number[twin.id], layout.key[twin.id] = layout.twin[number][1], 2 * number + 1
        return layout

    def _add(self, body: Body, frozen_at: tuple[Vector, Quaternion] | None) -> None:
        """Adds a body to its tree, or begins a tree with it."""
        number = body.number
        link = self.forest.parent.get(number)
        if link is not None:
            parent, joint = link
            handle = self._attach(joint, parent, f"b{number}")
        elif frozen_at is not None:
            position, q = frozen_at
            handle = self.spec.worldbody.add_body(name=f"b{number}", pos=position, quat=_wxyz(q))
        else:
            handle = self.spec.worldbody.add_body(name=f"b{number}")
            self.free[number] = handle.add_freejoint()
        self.handles[number] = handle
        handle.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[edge / 2 for edge in body.size],
            mass=body.mass * self.share[number],
            friction=[body.friction, 0.005, 0.0001],
            solref=_bounce(body.restitution, self.scene.timestep),
            priority=1,  # over the ground, which has no surface of its own
        )

    def _spare(self, place: int) -> mujoco.MjsBody:
        handle = self.spec.worldbody.add_body(name=f"p{place}")
        handle.add_freejoint()
        handle.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.5, 0.5, 0.5], mass=1.0, priority=1)
        return handle

    def _attach(self, joint: Joint, parent: int, name: str) -> mujoco.MjsBody:
        """Adds a child to `parent`, at coordinate zero, with the joint in it."""
        flipped = parent == joint.body2
        axis1 = rotate(joint.zero, joint.axis2)
        if flipped:
            self.flipped.add(joint.number)
            turn, at_parent, at_child, axis_parent, axis = (
                conjugate(joint.zero),
                joint.anchor2,
                joint.anchor1,
                joint.axis2,
                axis1,
            )
        else:
            turn, at_parent, at_child, axis_parent, axis = (
                joint.zero,
                joint.anchor1,
                joint.anchor2,
                axis1,
                joint.axis2,
            )
        arm = rotate(turn, at_child)
        child = self.handles[parent].add_body(
            name=name, pos=[at_parent[i] - arm[i] for i in range(3)], quat=_wxyz(turn)
        )
        # A coordinate is the motion of body2 relative to body1; where body1 is what moves, it moves the other way.
        sign = -1.0 if flipped else 1.0
        if joint.form == "cone":
            u, w = across(joint.axis2)
            axes = [u, w, joint.axis2]
            if flipped:
                axes = [rotate(joint.zero, one) for one in reversed(axes)]
            hinges = [
                child.add_joint(
                    name=f"j{joint.number}" if i == 0 else f"j{joint.number}_{i}",
                    type=mujoco.mjtJoint.mjJNT_HINGE,
                    pos=at_child,
                    axis=[sign * x for x in one],
                )
                for i, one in enumerate(axes)
            ]
            self.made[joint.number] = hinges[0]
            self._swing(joint, self.handles[parent], at_parent, axis_parent, child, at_child, axis)
        elif joint.form != "fixed":
            self.made[joint.number] = child.add_joint(
                name=f"j{joint.number}", type=_KINDS[joint.form], pos=at_child, axis=[sign * x for x in axis]
            )
        return child

    def _swing(
        self,
        joint: Joint,
        parent: mujoco.MjsBody,
        at_parent: Vector,
        axis_parent: Vector,
        child: mujoco.MjsBody,
        at_child: Vector,
        axis_child: Vector,
    ) -> None:
        """Bounds a cone's swing by a tendon between the tips of its axis in either body: the chord of the angle."""
        tendon = self.spec.add_tendon(name=f"w{joint.number}", limited=True, range=[0.0, 1.0])
        for end, body, at, axis in (("p", parent, at_parent, axis_parent), ("c", child, at_child, axis_child)):
            name = f"w{joint.number}{end}"
            body.add_site(name=name, pos=[at[i] + axis[i] for i in range(3)])
            tendon.wrap_site(name)
        self.swings[joint.number] = tendon

    def _stands_for(self, joint: Joint) -> int:
        """The body whose mass a loop joint's twin shares: body2, unless that one is frozen and has no mass to share."""
        return joint.body1 if self.bodies[joint.body2].frozen else joint.body2

    def _close(self, joint: Joint) -> None:
        """Closes a loop: a ball by one connection, a fixed joint by a weld, the others by a twin welded to its cube."""
        softness = {"solref": [2.0 * self.scene.timestep, 1.0], "solimp": _LOOP_SOLIMP}
        if joint.form == "ball":
            # Sites, since between bodies the compiler would take the second anchor from the poses at coordinate zero.
            names = []
            for end, anchor in ((joint.body1, joint.anchor1), (joint.body2, joint.anchor2)):
                names.append(f"s{joint.number}_{end}")
                self.handles[end].add_site(name=names[-1], pos=anchor)
            self.spec.add_equality(
                type=mujoco.mjtEq.mjEQ_CONNECT,
                objtype=mujoco.mjtObj.mjOBJ_SITE,
                name1=names[0],
                name2=names[1],
                **softness,
            )
            return
        if joint.form == "fixed":
            first, second = f"b{joint.body1}", f"b{joint.body2}"
            # The anchor in the frame of the second body, then in that of the first, then how the second is turned.
            data = [*joint.anchor2, *joint.anchor1, *_wxyz(joint.zero), 1.0, 0.0]
        else:
            body = self.bodies[self._stands_for(joint)]
            parent = joint.body2 if body.number == joint.body1 else joint.body1
            first, second = f"t{joint.number}", f"b{body.number}"
            twin = self._attach(joint, parent, first)
            mass = body.mass * self.share[body.number]
            x, y, z = (edge * edge for edge in body.size)
            twin.explicitinertial = True
            twin.ipos, twin.iquat = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]
            twin.mass = mass
            twin.inertia = [mass * (y + z) / 12.0, mass * (x + z) / 12.0, mass * (x + y) / 12.0]
            self.twins[joint.number] = twin
            data = [0.0] * 6 + [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]
        self.spec.add_equality(
            type=mujoco.mjtEq.mjEQ_WELD,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            name1=first,
            name2=second,
            data=data,
            **softness,
        )


def _options(spec: mujoco.MjSpec, scene: SceneSpec, bodies: int) -> None:
    option = spec.option
    option.timestep = scene.timestep
    option.gravity = [0.0, 0.0, 0.0] if scene.planets else list(scene.gravity)
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST  # motors and dampers stay stable at any gain
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 10.0  # friction that holds: at 1 a cube creeps down a slope that should hold it
    disable, enable = mujoco.mjtDisableBit, mujoco.mjtEnableBit
    # AUTORESET: on its own MuJoCo puts a diverged world silently back to its start. FILTERPARENT: only jointed cubes
    # are kept from colliding, and those we name.
    option.disableflags |= disable.mjDSBL_AUTORESET | disable.mjDSBL_FILTERPARENT
    option.enableflags |= enable.mjENBL_SLEEP
    set_options(option, scene.options)
    # And for every cube to overlap every obstacle, and to be carried at 50 points of rough ground.
    rough = 7 * len(scene.boxes) + (1024 if scene.heightfield is not None or scene.arena is not None else 0)
    spec.memory = min(_arena(bodies) + bodies * rough * _KIBIBYTE, 2 << 30)


def _arena(bodies: int) -> int:
    """Returns the bytes for contacts and constraints: address space until it is used.

    There is room for every cube to overlap every other (measured: 6 KiB a pair and direction), up to 2 GiB.
    """
    return min(512 + 7 * bodies * bodies, 2 << 20) * _KIBIBYTE


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


def across(axis: Vector) -> tuple[Vector, Vector]:
    """Returns two directions that make a right-handed frame with a unit axis, always the same for the same axis."""
    least = min(range(3), key=lambda i: abs(axis[i]))
    u = cross(axis, (float(least == 0), float(least == 1), float(least == 2)))
    length = sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    u = (u[0] / length, u[1] / length, u[2] / length)
    return u, cross(axis, u)


def relative(q1: Quaternion, q2: Quaternion) -> Quaternion:
    """Returns the orientation of 2 in the frame of 1."""
    return multiply(conjugate(q1), q2)
