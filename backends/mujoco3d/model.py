"""A compiled MuJoCo model, where each body and joint is in it, and what may change in it without compiling.

Bodies and joints are known by the numbers that the caller chose; MuJoCo knows bodies, joints, motors and tendons by
indices. A free body may come and go without compiling: some of a big model's bodies are *parked*, they touch nothing
and never wake, until they become the next free body. A loop's joint leads to a *proxy*, a body that stands for one of
the joined boxes, shares its mass and is welded to it (see `compiler`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import inf, sin, sqrt

import mujoco
import numpy as np
import numpy.typing as npt

from nmes.backends.mujoco3d.forest import Body, Forest, Joint

__all__ = [
    "GROUP_BITS",
    "SPARE",
    "CompiledModel",
    "Slot",
    "inner_radii",
    "kept_masks",
    "occupy",
    "park",
    "set_mean_inertia",
    "vacate",
    "write_params",
]

SPARE = -1
"""In place of a root: a parked body, ready to become the next free one without compiling the model anew."""

GROUP_BITS = (1 << 16) - 1
"""The bits of MuJoCo's collision masks that are groups: bit 0 what is in none. The upper half is for what glides."""

# What depends on a free body's mass, shape and group in a model (seen by comparing models; a test does so still).
_OF_BODY = (
    "body_mass",
    "body_inertia",
    "body_invweight0",
    "body_subtreemass",
    "body_contype",
    "body_conaffinity",
    "body_gravcomp",
)
_OF_GEOM = (
    "geom_type",
    "geom_size",
    "geom_quat",
    "geom_sameframe",
    "geom_aabb",
    "geom_rbound",
    "geom_friction",
    "geom_solref",
    "geom_rgba",
    "geom_contype",
    "geom_conaffinity",
)
_OF_DOF = ("dof_M0", "dof_invweight0", "dof_length")
_BOX, _CYLINDER = int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_CYLINDER)
_WIDEST_SWING = 1.4  # rad: a cone's two swinging hinges fall together at a right angle
_SERVO_RATE = 60.0  # 1/s: a strong servo closes 63% of a small error in 1/30 s
_EXPLICIT = (mujoco.mjtIntegrator.mjINT_EULER, mujoco.mjtIntegrator.mjINT_RK4)
# How much of a joint's velocity a motor may take in a step of an explicit integrator: at twice, chains oscillate.
_FIRMEST = 0.5


@dataclass(slots=True)
class Slot:
    """Where in `qpos` and `qvel` a coordinate lives. `flipped`: the tree runs from body2 to body1 there."""

    q: int
    nq: int
    v: int
    nv: int
    flipped: bool = False


@dataclass(slots=True)
class CompiledModel:
    """A model, and the places of bodies and joints in it.

    Attributes:
        model: MuJoCo's.
        forest: The trees that it was compiled from.
        roots: The roots of the trees in the order of the model; SPARE stands for a parked body.
        root_place: The place in `roots` of a root or a parked body, by its index.
        spares: The indices of the parked bodies, ascending.
        body_index: The index of a body, by its number.
        body_number: The number of a body, by its index; of a proxy, that of the body that it stands for.
        stable_key: A name of a body that outlives the model, by its index; proxies have their own.
        free: Where the coordinates of a free root are, by the body's number.
        joint: Where the coordinates of a joint are, by its number.
        joint_index: The (first) joint of the model, by the joint's number.
        actuator: The motor of a joint, by the joint's number.
        loop_proxy: The index of a loop joint's proxy and the number of the body that it stands for.
        bodies: All bodies by number, also those that are in it only from the next step on.
        swing_tendon: The tendon that bounds the swing of a cone, by the joint's number.
    """

    model: mujoco.MjModel
    forest: Forest
    roots: list[int]
    root_place: dict[int, int] = field(default_factory=dict)
    spares: list[int] = field(default_factory=list)
    body_index: dict[int, int] = field(default_factory=dict)
    body_number: dict[int, int] = field(default_factory=dict)
    stable_key: dict[int, int] = field(default_factory=dict)
    free: dict[int, Slot] = field(default_factory=dict)
    joint: dict[int, Slot] = field(default_factory=dict)
    joint_index: dict[int, int] = field(default_factory=dict)
    actuator: dict[int, int] = field(default_factory=dict)
    loop_proxy: dict[int, tuple[int, int]] = field(default_factory=dict)
    swing_tendon: dict[int, int] = field(default_factory=dict)
    bodies: Mapping[int, Body] = field(default_factory=dict)

    def add_body(self, number: int, index: int) -> None:
        """Enters a body that is no proxy."""
        self.body_index[number] = index
        self.body_number[index], self.stable_key[index] = number, 2 * number

    def add_loop_proxy(self, joint: int, index: int, body: int) -> None:
        """Enters the proxy of a loop's joint, which stands for a body."""
        self.loop_proxy[joint] = (index, body)
        self.body_number[index], self.stable_key[index] = body, 2 * joint + 1


# -- free bodies that come and go ------------------------------------------------------------------------------------


def occupy(compiled: CompiledModel, body: Body, lone: mujoco.MjModel) -> int:
    """Lets a free body take the first parked one's place; returns its index. The model is as if compiled with it.

    Args:
        compiled: A model with a parked body.
        body: The free body.
        lone: A model of that body alone (`compiler.compile_lone_body`).
    """
    model, index = compiled.model, compiled.spares.pop(0)
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
    compiled.roots[compiled.root_place[index]] = body.number
    compiled.add_body(body.number, index)
    compiled.free[body.number] = Slot(int(model.jnt_qposadr[joint]), 7, dof, 6)
    return index


def vacate(compiled: CompiledModel, body: int) -> int:
    """Parks a free body that no joint holds; returns its index."""
    index = compiled.body_index.pop(body)
    del compiled.body_number[index], compiled.stable_key[index], compiled.free[body]
    compiled.roots[compiled.root_place[index]] = SPARE
    compiled.spares.append(index)
    compiled.spares.sort()
    park(compiled.model, index)
    return index


def park(model: mujoco.MjModel, index: int) -> None:
    """Makes a body touch nothing, and no ray meet it. It is never woken, so it costs nothing, too."""
    model.geom_rgba[model.body_geomadr[index], 3] = 0.0
    for name in ("contype", "conaffinity"):
        getattr(model, f"geom_{name}")[model.body_geomadr[index]] = 0
        getattr(model, f"body_{name}")[index] = 0


@contextmanager
def kept_masks(model: mujoco.MjModel) -> Iterator[list[npt.NDArray[np.int32]]]:
    """Yields the masks by which things collide: of geoms, then of bodies, `contype` before `conaffinity`.

    They may be changed; afterwards they are as before.
    """
    masks = [model.geom_contype, model.geom_conaffinity, model.body_contype, model.body_conaffinity]
    saved = [mask.copy() for mask in masks]
    try:
        yield masks
    finally:
        for mask, values in zip(masks, saved, strict=True):
            mask[:] = values


def set_mean_inertia(compiled: CompiledModel) -> None:
    """Sets the inertia by which the solver judges its error to that of the bodies in use, as MuJoCo would."""
    model = compiled.model
    used = np.ones(model.nv, bool)
    for index in compiled.spares:
        used[model.body_dofadr[index] : model.body_dofadr[index] + 6] = False
    if used.any():
        model.stat.meaninertia = float(model.dof_M0[used].mean())


def inner_radii(model: mujoco.MjModel, bodies: npt.NDArray[np.intp]) -> npt.NDArray[np.float64]:
    """Returns the radii, m, of the largest balls about the middles of some bodies that are within them."""
    geoms = model.body_geomadr[bodies]
    sizes, types = model.geom_size[geoms], model.geom_type[geoms]
    radii: npt.NDArray[np.float64] = sizes.min(axis=1)
    rounded = types != _BOX
    if rounded.any():
        flat = types[rounded] == _CYLINDER  # whose second size may be the smaller one
        radii[rounded] = np.where(flat, sizes[rounded, :2].min(axis=1), sizes[rounded, 0])
    return radii


# -- parameters of joints --------------------------------------------------------------------------------------------


def write_params(compiled: CompiledModel, joint: Joint) -> None:
    """Writes a joint's motor, spring and limits into the model; a motor's target is a control of the data."""
    if joint.form == "cone":
        _write_cone(compiled, joint)
    elif joint.form != "ball":
        model, params = compiled.model, joint.params
        index, dof = compiled.joint_index[joint.number], compiled.joint[joint.number].v
        model.jnt_stiffness[index] = params.stiffness
        model.dof_damping[dof] = params.damping
        model.jnt_limited[index] = params.limits is not None
        model.jnt_range[index] = params.limits or (0.0, 0.0)
        if joint.number in compiled.actuator:
            _write_motor(compiled, joint, dof)


def _write_cone(compiled: CompiledModel, joint: Joint) -> None:
    model = compiled.model
    assert joint.params.limits is not None
    swing, twist = joint.params.limits
    # In the order of the tree the twist comes last, or first where the tree runs from body2 to body1.
    twisting = compiled.joint_index[joint.number] + (0 if compiled.joint[joint.number].flipped else 2)
    model.jnt_limited[twisting] = True
    model.jnt_range[twisting] = (-twist, twist)
    chord = 2.0 * sin(min(max(swing, 0.0), _WIDEST_SWING) / 2.0)
    model.tendon_range[compiled.swing_tendon[joint.number]] = (0.0, max(chord, 1e-6))


def _write_motor(compiled: CompiledModel, joint: Joint, dof: int) -> None:
    model, params, motor = compiled.model, joint.params, compiled.actuator[joint.number]
    # What the two sides weigh against each other along this joint.
    inertia = 1.0 / max(float(model.dof_invweight0[dof]), 1e-12)
    firmest = _FIRMEST * inertia / model.opt.timestep if model.opt.integrator in _EXPLICIT else inf
    gain, bias = np.zeros(model.actuator_gainprm.shape[1]), np.zeros(model.actuator_biasprm.shape[1])
    if params.motor == "velocity" and params.max_effort > 0.0:
        # As stiff as can be without overshooting when the bound on the effort is what stops it: one step at the
        # bound then ends within the band in which the drive is linear. And no stiffer than what the integrator bears.
        gain[0] = min(2.0 * inertia / model.opt.timestep, firmest)
        bias[2] = -gain[0]
    elif params.motor == "position" and params.max_effort > 0.0:
        gain[0] = inertia * _SERVO_RATE * _SERVO_RATE
        # Critically damped; and where the bound is low, damped so much that from one unit away (rad or m) the bound is
        # enough to brake: at full effort that takes half the root of unit * inertia / effort.
        brake = 0.5 * gain[0] * sqrt(inertia / max(params.max_effort, 1e-200))  # a product within floats
        bias[1], bias[2] = -gain[0], -min(max(2.0 * inertia * _SERVO_RATE, brake), firmest)
    model.actuator_gainprm[motor], model.actuator_biasprm[motor] = gain, bias
    bound = max(params.max_effort, 1e-300)
    model.actuator_forcerange[motor] = (-bound, bound)
