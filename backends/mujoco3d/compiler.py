"""From bodies and joints to a compiled MuJoCo model: kinematic trees, loops, motors and their surroundings.

A loop is closed by equality constraints. A hinge or slide that closes one is kept as a real joint all the same, with
its limits, its motor and its reading: it leads to a *proxy*, a body that shares the mass of the box which it stands
for and is welded to it. Splitting the mass instead of adding some keeps the structure's inertia exact and well
conditioned.

Invariant: the model is a function of the scene, the bodies, the joints and the forest alone, never of the current
poses (free roots are placed at the origin), so a restored simulation compiles the very same model. So, too, small
models are kept for whoever asks for the very same one: a world that wakes, is reset, or is like many others.
"""

from __future__ import annotations

import copy
import warnings
from collections import Counter, OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from math import log, pi, sqrt
from threading import Lock

import mujoco
import orjson

from nmes.backend import Medium, Quaternion, SceneSpec, Vector
from nmes.backend.rotation import conjugate, rotate
from nmes.backend.shapes import Shape, moments
from nmes.backends.mujoco3d.fluid import lift
from nmes.backends.mujoco3d.forest import Body, Forest, Joint, perpendicular_axes, spanning_forest
from nmes.backends.mujoco3d.model import GROUP_BITS, SPARE, CompiledModel, Slot, park, set_mean_inertia
from nmes.backends.mujoco3d.scenery import Scenery, set_options, solid

__all__ = ["arena_bytes", "compile_lone_body", "compile_model"]

_KINDS = {
    "hinge": mujoco.mjtJoint.mjJNT_HINGE,
    "slide": mujoco.mjtJoint.mjJNT_SLIDE,
    "ball": mujoco.mjtJoint.mjJNT_BALL,
}
_COORDINATES = {"hinge": (1, 1), "slide": (1, 1), "ball": (4, 3), "cone": (3, 3)}  # nq, nv by form
_BY_PROXY = frozenset({"hinge", "slide", "cone"})  # forms that close a loop by way of a proxy
# Contact softness (MuJoCo's solref, solimp): a contact at rest settles in about 0.02 s.
_CONTACT_TIME = 0.02
# Loops are closed as stiffly as the time step allows.
_LOOP_SOLIMP = [0.95, 0.999, 0.0005, 0.5, 2.0]
_KIBIBYTE = 1 << 10
_SMALL, _MOST = 64, 64  # models of up to so many bodies are kept, the last so many: 30 KB each with ten bodies
_KEY = orjson.OPT_NON_STR_KEYS | orjson.OPT_SERIALIZE_NUMPY

# MuJoCo warns so of masses that are too unequal. A structure of them goes on, or its world faults and says why.
warnings.filterwarnings("ignore", "Inertia matrix is too close to singular", UserWarning)


def compile_model(
    scene: SceneSpec,
    scenery: Scenery,
    bodies: dict[int, Body],
    joints: dict[int, Joint],
    forest: Forest,
    frozen_at: dict[int, tuple[Vector, Quaternion]],
    roots: Sequence[int],
) -> CompiledModel:
    """Compiles the model.

    Args:
        scene: Time step, gravity and the rest.
        scenery: The static surroundings.
        bodies: All bodies by number; `joints` likewise.
        joints: See above.
        forest: Their spanning forest.
        frozen_at: The poses of the frozen bodies.
        roots: The roots of the trees in the order in which the model has them; SPARE stands for a parked body.

    Raises:
        ValueError: MuJoCo refuses what was asked for; or `mujoco.FatalError`.
    """
    if len(bodies) > _SMALL:
        return _compile(scene, scenery, bodies, joints, forest, frozen_at, roots)
    asked = (scene.timestep, scene.gravity, scene.passes, scene.medium, scene.options, len(scene.boxes))
    parts = ([*bodies.values()], [*joints.values()], [*frozen_at.items()], roots)
    key = scenery.identity, orjson.dumps((asked, parts), option=_KEY)
    kept = _recent.find(key)
    if kept is None:
        kept = _compile(scene, scenery, bodies, joints, forest, frozen_at, roots)
        _recent.keep(key, kept)
    return _copy(kept, forest, bodies)


def _compile(
    scene: SceneSpec,
    scenery: Scenery,
    bodies: dict[int, Body],
    joints: dict[int, Joint],
    forest: Forest,
    frozen_at: dict[int, tuple[Vector, Quaternion]],
    roots: Sequence[int],
) -> CompiledModel:
    compiled = _Builder(scene, bodies, joints, forest).build(scenery, frozen_at, roots)
    for index in compiled.spares:
        park(compiled.model, index)
    set_mean_inertia(compiled)
    return compiled


def _copy(kept: CompiledModel, forest: Forest, bodies: dict[int, Body]) -> CompiledModel:
    """Returns a model of its own, for whoever runs a model writes into it."""
    places = {field.name: getattr(kept, field.name) for field in fields(kept)}
    own = {name: value.copy() for name, value in places.items() if isinstance(value, (dict, list))}
    return CompiledModel(**{**places, **own, "model": copy.copy(kept.model), "forest": forest, "bodies": bodies})


class _Recent:
    """The models that were asked for last, by all that they are made of; for many threads."""

    def __init__(self, most: int) -> None:
        self._most, self._models, self._lock = most, OrderedDict[object, CompiledModel](), Lock()

    def find(self, key: object) -> CompiledModel | None:
        with self._lock:
            kept = self._models.get(key)
            if kept is not None:
                self._models.move_to_end(key)
            return kept

    def keep(self, key: object, compiled: CompiledModel) -> None:
        bare = replace(compiled, forest=Forest(), bodies={})  # not the world for which it was compiled
        with self._lock:
            self._models[key] = bare
            if len(self._models) > self._most:
                self._models.popitem(last=False)


_recent = _Recent(_MOST)


def compile_lone_body(scene: SceneSpec, body: Body) -> mujoco.MjModel:
    """Compiles a model of one free body: what the compiler makes of its mass, shape and group."""
    surface = body.friction, body.restitution
    kind = body.group, body.shape, scene.medium
    return _lone_body(scene.timestep, scene.passes, body.size, body.mass, *surface, *kind)


@lru_cache(maxsize=64)
def _lone_body(
    timestep: float,
    passes: tuple[int, ...],
    size: Vector,
    mass: float,
    friction: float,
    restitution: float,
    group: int,
    shape: Shape,
    medium: Medium | None,
) -> mujoco.MjModel:
    bodies = {1: Body(1, size, mass, friction, restitution, frozen=False, group=group, shape=shape)}
    builder = _Builder(
        SceneSpec(timestep=timestep, passes=passes, medium=medium), bodies, {}, spanning_forest(bodies, ())
    )
    return builder.build(None, {}, [1]).model


@dataclass(frozen=True, slots=True)
class _Link:
    """A joint in the direction of its tree, from parent to child; `flipped` where that is from body2 to body1."""

    flipped: bool
    turn: Quaternion
    at_parent: Vector
    at_child: Vector
    axis_parent: Vector
    axis_child: Vector

    @classmethod
    def of(cls, joint: Joint, *, flipped: bool) -> _Link:
        axis1 = rotate(joint.zero, joint.axis2)
        if flipped:
            return cls(True, conjugate(joint.zero), joint.anchor2, joint.anchor1, joint.axis2, axis1)
        return cls(False, joint.zero, joint.anchor1, joint.anchor2, axis1, joint.axis2)


class _Builder:
    """One model in the making."""

    def __init__(self, scene: SceneSpec, bodies: dict[int, Body], joints: dict[int, Joint], forest: Forest) -> None:
        self.scene, self.bodies, self.joints, self.forest = scene, bodies, joints, forest
        self.spec = mujoco.MjSpec()
        self.handles: dict[int, mujoco.MjsBody] = {}
        self.free: dict[int, mujoco.MjsJoint] = {}
        self.joint_handles: dict[int, mujoco.MjsJoint] = {}  # joint number -> its (first) joint in the model
        self.loop_proxies: dict[int, mujoco.MjsBody] = {}
        self.flipped: set[int] = set()
        self.swing_tendons: dict[int, mujoco.MjsTendon] = {}
        proxies = Counter(self._stands_for(joint) for joint in forest.loops if joint.form in _BY_PROXY)
        self.share = {number: 1.0 / (1 + proxies[number]) for number in bodies}

    def build(
        self, scenery: Scenery | None, frozen_at: dict[int, tuple[Vector, Quaternion]], roots: Sequence[int]
    ) -> CompiledModel:
        spec = self.spec
        _options(spec, self.scene, len(roots) + len(self.forest.parent))
        if scenery is not None:
            scenery.add(spec)
        root_handles: list[mujoco.MjsBody] = []
        for root in roots:
            if root == SPARE:
                root_handles.append(self._spare(len(root_handles)))
            else:
                for number in self.forest.trees[root]:
                    self._add(self.bodies[number], frozen_at.get(number))
                root_handles.append(self.handles[root])
        for joint in self.forest.loops:
            self._close(joint)
        for joint in self.joints.values():
            spec.add_exclude(bodyname1=f"b{joint.body1}", bodyname2=f"b{joint.body2}")
        actuators = {
            number: self._motor(number) for number in self.joint_handles if self.joints[number].params.motor != "off"
        }
        return self._places(spec.compile(), roots, root_handles, actuators)

    def _motor(self, joint: int) -> mujoco.MjsActuator:
        return self.spec.add_actuator(
            name=f"m{joint}",
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            target=f"j{joint}",
            biastype=mujoco.mjtBias.mjBIAS_AFFINE,
            forcelimited=True,
            forcerange=[-1.0, 1.0],
        )

    def _places(
        self,
        model: mujoco.MjModel,
        roots: Sequence[int],
        root_handles: Sequence[mujoco.MjsBody],
        actuators: dict[int, mujoco.MjsActuator],
    ) -> CompiledModel:
        """Looks up where everything is in the compiled model."""
        compiled = CompiledModel(model, self.forest, list(roots), bodies=self.bodies)
        for place, (root, handle) in enumerate(zip(roots, root_handles, strict=True)):
            compiled.root_place[handle.id] = place
            if root == SPARE:
                compiled.spares.append(handle.id)
        for number, handle in self.handles.items():
            compiled.add_body(number, handle.id)
        for number, free in self.free.items():
            compiled.free[number] = Slot(int(model.jnt_qposadr[free.id]), 7, int(model.jnt_dofadr[free.id]), 6)
        for number, first in self.joint_handles.items():
            nq, nv = _COORDINATES[self.joints[number].form]
            q, v = int(model.jnt_qposadr[first.id]), int(model.jnt_dofadr[first.id])
            compiled.joint[number] = Slot(q, nq, v, nv, number in self.flipped)
            compiled.joint_index[number] = first.id
        for number, actuator in actuators.items():
            compiled.actuator[number] = actuator.id
        for number, tendon in self.swing_tendons.items():
            compiled.swing_tendon[number] = tendon.id
        for number, proxy in self.loop_proxies.items():
            compiled.add_loop_proxy(number, proxy.id, self._stands_for(self.joints[number]))
        return compiled

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
        if body.shape != "box":
            self._set_inertia(handle, body)  # along the body's own axes: the geom's may be others
        handle.gravcomp = lift(self.scene, body)
        handle.add_geom(
            **solid(body.shape, body.size),
            mass=body.mass * self.share[number],
            friction=[body.friction, 0.005, 0.0001],
            solref=_bounce(body.restitution, self.scene.timestep),
            priority=1,  # over the ground, which has no surface of its own
            **self._masks(body),
        )

    def _masks(self, body: Body) -> dict[str, int]:
        """Returns the collision masks of a body in a group; all others, and the scenery, have bit 0 alone in both."""
        if not body.group:
            return {}
        meets = ~self.scene.passes[body.group - 1] & GROUP_BITS
        return {"contype": 1 << body.group, "conaffinity": meets}

    def _spare(self, place: int) -> mujoco.MjsBody:
        handle = self.spec.worldbody.add_body(name=f"p{place}")
        handle.gravcomp = float(self.scene.medium is not None and self.scene.medium.level is None)
        handle.add_freejoint()
        handle.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.5, 0.5, 0.5], mass=1.0, priority=1)
        return handle

    def _attach(self, joint: Joint, parent: int, name: str) -> mujoco.MjsBody:
        """Adds a child to `parent`, at coordinate zero, with the joint in it."""
        link = _Link.of(joint, flipped=parent == joint.body2)
        if link.flipped:
            self.flipped.add(joint.number)
        arm = rotate(link.turn, link.at_child)
        position = [link.at_parent[i] - arm[i] for i in range(3)]
        child = self.handles[parent].add_body(name=name, pos=position, quat=_wxyz(link.turn))
        # A coordinate is the motion of body2 relative to body1; where body1 is what moves, it moves the other way.
        sign = -1.0 if link.flipped else 1.0
        if joint.form == "cone":
            self.joint_handles[joint.number] = self._cone(joint, link, sign, child)
            self._swing(joint, link, self.handles[parent], child)
        elif joint.form != "fixed":
            self.joint_handles[joint.number] = child.add_joint(
                name=f"j{joint.number}",
                type=_KINDS[joint.form],
                pos=link.at_child,
                axis=[sign * x for x in link.axis_child],
            )
        return child

    def _cone(self, joint: Joint, link: _Link, sign: float, child: mujoco.MjsBody) -> mujoco.MjsJoint:
        """Adds the three hinges of a cone; returns the first."""
        axes = [*perpendicular_axes(joint.axis2), joint.axis2]
        if link.flipped:
            axes = [rotate(joint.zero, axis) for axis in reversed(axes)]
        hinges = [
            child.add_joint(
                name=f"j{joint.number}" if i == 0 else f"j{joint.number}_{i}",
                type=mujoco.mjtJoint.mjJNT_HINGE,
                pos=link.at_child,
                axis=[sign * x for x in axis],
            )
            for i, axis in enumerate(axes)
        ]
        return hinges[0]

    def _swing(self, joint: Joint, link: _Link, parent: mujoco.MjsBody, child: mujoco.MjsBody) -> None:
        """Bounds a cone's swing by a tendon between the tips of its axis in either body: the chord of the angle."""
        tendon = self.spec.add_tendon(name=f"w{joint.number}", limited=True, range=[0.0, 1.0])
        for end, body, at, axis in (
            ("p", parent, link.at_parent, link.axis_parent),
            ("c", child, link.at_child, link.axis_child),
        ):
            name = f"w{joint.number}{end}"
            body.add_site(name=name, pos=[at[i] + axis[i] for i in range(3)])
            tendon.wrap_site(name)
        self.swing_tendons[joint.number] = tendon

    def _stands_for(self, joint: Joint) -> int:
        """Returns the body whose mass a loop joint's proxy shares: body2, or body1 where that one is frozen."""
        return joint.body1 if self.bodies[joint.body2].frozen else joint.body2

    def _close(self, joint: Joint) -> None:
        """Closes a loop: a ball by a connection, a fixed joint by a weld, the others by a proxy welded to its cube."""
        if joint.form == "ball":
            self._connect(joint)
        elif joint.form == "fixed":
            # The anchor in the frame of the second body, then in that of the first, then how the second is turned.
            data = [*joint.anchor2, *joint.anchor1, *_wxyz(joint.zero), 1.0, 0.0]
            self._weld(f"b{joint.body1}", f"b{joint.body2}", data)
        else:
            body = self.bodies[self._stands_for(joint)]
            name = f"t{joint.number}"
            self.loop_proxies[joint.number] = self._proxy(joint, body, name)
            self._weld(name, f"b{body.number}", [0.0] * 6 + [1.0, 0.0, 0.0, 0.0, 1.0, 0.0])

    def _proxy(self, joint: Joint, body: Body, name: str) -> mujoco.MjsBody:
        proxy = self._attach(joint, joint.body2 if body.number == joint.body1 else joint.body1, name)
        self._set_inertia(proxy, body)
        proxy.gravcomp = lift(self.scene, body)
        return proxy

    def _set_inertia(self, handle: mujoco.MjsBody, body: Body) -> None:
        """Gives a body of the model the mass and the inertia of a body, or its share of them."""
        mass = body.mass * self.share[body.number]
        handle.explicitinertial = True
        handle.ipos, handle.iquat = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]
        handle.mass = mass
        handle.inertia = [mass * moment for moment in moments(body.shape, body.size)]

    def _connect(self, joint: Joint) -> None:
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
            **self._softness(),
        )

    def _weld(self, first: str, second: str, data: list[float]) -> None:
        self.spec.add_equality(
            type=mujoco.mjtEq.mjEQ_WELD,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            name1=first,
            name2=second,
            data=data,
            **self._softness(),
        )

    def _softness(self) -> dict[str, list[float]]:
        return {"solref": [2.0 * self.scene.timestep, 1.0], "solimp": _LOOP_SOLIMP}


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
    spec.memory = min(arena_bytes(bodies) + bodies * rough * _KIBIBYTE, 2 << 30)


def arena_bytes(bodies: int) -> int:
    """Returns the bytes for contacts and constraints: address space until it is used.

    There is room for every cube to overlap every other (measured: 6 KiB a pair and direction), up to 2 GiB.
    """
    return min(512 + 7 * bodies * bodies, 2 << 20) * _KIBIBYTE


def _bounce(restitution: float, timestep: float) -> list[float]:
    """Returns the time constant and damping ratio of contacts that give back `restitution` times the speed of impact.

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
