"""A scene's whole state as JSON: structure, and MuJoCo's integration state and sleep in base64."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import orjson

from nmes.backend import SceneSpec
from nmes.backend.rotation import total
from nmes.backend.shapes import SHAPES, misfit
from nmes.backends.mujoco3d.compiler import compile_model
from nmes.backends.mujoco3d.forest import Body, Joint, spanning_forest
from nmes.backends.mujoco3d.model import SPARE, CompiledModel
from nmes.backends.mujoco3d.running import HUGE, RunningModel, Wrenches
from nmes.backends.mujoco3d.sensing import STATE
from nmes.backends.mujoco3d.sleep import AWAKE
from nmes.backends.mujoco3d.structure import Structure
from nmes.errors import WorldError

__all__ = ["read_snapshot", "write_snapshot"]

_FIELDS = frozenset("bodies joints frozen_at force impulse parting state asleep roots".split())
_LATER: dict[str, Any] = {"gliding": [], "heaped": False}  # not in older snapshots: left out where they are so
_KINDS = frozenset({"fixed", "hinge", "slide", "pin", "conetwist"})


def write_snapshot(running: RunningModel, structure: Structure, wrenches: Wrenches) -> bytes:
    """Returns the state of a scene without edits that its model does not have.

    The live scene then does what a restored one would: it computes its readings (contacts, efforts) from the state
    alone.
    """
    running.motors.sync()
    running.settle(running.asleep.copy())
    frozen_at = {}
    for body in structure.bodies.values():
        if body.frozen:
            state = running.body_state(running.compiled.body_index[body.number], frozen=True)
            frozen_at[str(body.number)] = [*state.position, *state.quaternion]
    later = {"gliding": sorted(running.depenetration.crowds.gliding), "heaped": running.heaped}
    return orjson.dumps(
        {
            "bodies": [body.to_json() for body in structure.bodies.values()],
            "joints": [joint.to_json() for joint in structure.joints.values()],
            "frozen_at": frozen_at,
            "force": list(wrenches.forces.items()),
            "impulse": list(wrenches.impulses.items()),
            "parting": sorted(running.depenetration.bodies),  # its name in the format
            "state": base64.b64encode(running.state().tobytes()).decode(),
            "asleep": running.asleep.tolist(),
            "roots": running.compiled.roots,
            **{name: value for name, value in later.items() if value != _LATER[name]},
        }
    )


def read_snapshot(
    snapshot: bytes, scene: SceneSpec, running: RunningModel, structure: Structure, wrenches: Wrenches
) -> None:
    """Takes up a state that `write_snapshot` returned, in place of all that is here.

    Raises:
        WorldError: `bad_snapshot`: something in it is out of range, or belongs to nothing that is in it.
    """
    try:
        _take_up(orjson.loads(snapshot), scene, running, structure, wrenches)
    except (ValueError, TypeError, KeyError, AttributeError, mujoco.FatalError) as error:
        raise WorldError("bad_snapshot", f"the engine's part of it is not sound: {error!r}") from error


def _take_up(
    fields: dict[str, Any], scene: SceneSpec, running: RunningModel, structure: Structure, wrenches: Wrenches
) -> None:
    _require(fields.keys() - _LATER.keys() == _FIELDS, "these fields alone: " + ", ".join(sorted(_FIELDS | {*_LATER})))
    fields = {**_LATER, **fields}
    structure.replace([*map(Body.from_json, fields["bodies"])], [*map(Joint.from_json, fields["joints"])])
    bodies, joints = structure.bodies, structure.joints
    _check_structure(fields, bodies, joints)
    groups = range(len(scene.passes) + 1)
    _require(all(type(body.group) is int and body.group in groups for body in bodies.values()), "groups of the scene")
    movable = {number for number, body in bodies.items() if not body.frozen}
    frozen_at = {int(number): _numbers(pose, 7) for number, pose in fields["frozen_at"].items()}
    _require(frozen_at.keys() == bodies.keys() - movable, "a place for each frozen body, and for no other")
    for name, wrench in (("force", wrenches.forces), ("impulse", wrenches.impulses)):
        wrench.clear()
        wrench.update((number, [*_numbers(values, 6)]) for number, values in fields[name])
        _require(wrench.keys() <= bodies.keys(), "forces on bodies alone")  # in older ones also on frozen ones
    parting, gliding = set(fields["parting"]), set(fields["gliding"])
    # One may be frozen before the step in which it would have been let apart, and be watched until then.
    _require(gliding <= parting & movable and parting <= bodies.keys(), "only bodies are let apart")
    running.depenetration.bodies, running.depenetration.crowds.gliding = parting, gliding
    forest, roots = spanning_forest(bodies, joints.values()), fields["roots"]
    used = [root for root in roots if root != SPARE]
    _require(len(used) == len(forest.trees) and set(used) == forest.trees.keys(), "the root of each tree")
    _require(len(roots) <= 2 * scene.max_bodies, "no more parked bodies than there may be")
    poses = {number: ((x, y, z), (a, b, c, w)) for number, (x, y, z, a, b, c, w) in frozen_at.items()}
    _require(type(fields["heaped"]) is bool, "whether there is a heap")
    running.heaped = fields["heaped"]
    compiled = compile_model(scene, running.scenery, bodies, joints, forest, poses, roots)
    running.install(compiled, joints)
    state = np.frombuffer(base64.b64decode(fields["state"], validate=True))
    _require(state.shape == running.state().shape, "a state of the model's size")
    _require(bool((np.abs(state) <= HUGE).all()), "a state of numbers that the engine can compute with")
    asleep = fields["asleep"]
    _check_sleep(compiled, asleep)
    mujoco.mj_setState(running.model, running.data, state.copy(), STATE)
    running.settle(np.array(asleep, running.asleep.dtype))


def _check_structure(fields: dict[str, Any], bodies: dict[int, Body], joints: dict[int, Joint]) -> None:
    """Raises ValueError unless bodies and joints have numbers of their own, and are what a world can make."""
    _require(len(bodies) == len(fields["bodies"]) and len(joints) == len(fields["joints"]), "each number only once")
    for body in bodies.values():
        _require(type(body.number) is int and type(body.frozen) is bool, "numbers and flags of bodies")
        _require(min(*_numbers(body.size, 3), *_numbers((body.mass,), 1)) > 0.0, "sizes and masses above zero")
        _require(body.shape in SHAPES and misfit(body.shape, body.size) is None, "shapes, each of a size it may have")
        _require(min(_numbers((body.friction, body.restitution), 2)) >= 0.0, "friction and restitution of bodies")
    for joint in joints.values():
        _require(type(joint.number) is int and joint.kind in _KINDS, "numbers and kinds of joints")
        _require({joint.body1, joint.body2} <= bodies.keys() and joint.body1 != joint.body2, "joints of two bodies")
        _numbers((*joint.anchor1, *joint.anchor2, joint.held_at), 7)
        for direction, length in ((joint.axis2, 3), (joint.zero, 4)):
            _require(abs(total(x * x for x in _numbers(direction, length)) - 1.0) < 1e-6, "directions of unit length")
        params = joint.params
        _require(params.motor in ("off", "velocity", "position"), "modes of motors")
        efforts = (params.max_effort, params.stiffness, params.damping)
        _require(min(_numbers(efforts, 3)) >= 0.0, "efforts, springs and dampers that are not negative")
        _numbers((params.target_velocity, params.target_position, *(params.limits or (0.0, 0.0))), 4)


def _check_sleep(compiled: CompiledModel, asleep: list[int]) -> None:
    """Raises ValueError unless each tree is awake or in a ring of sleeping ones."""
    _require(
        len(asleep) == compiled.model.ntree and all(type(link) is int for link in asleep), "a number for each tree"
    )
    sleeping = {tree for tree, link in enumerate(asleep) if link >= 0}
    _require({asleep[tree] for tree in sleeping} == sleeping, "rings of sleeping trees")
    _require(min(asleep, default=0) >= AWAKE, "counts of ticks awake")


def _numbers(values: Sequence[float], count: int) -> tuple[float, ...]:
    """Returns values as a tuple; raises ValueError unless they are so many, and the engine can compute with them."""
    _require(len(values) == count, f"{count} numbers where there are {len(values)}")
    _require(all(type(value) in (int, float) and abs(value) <= HUGE for value in values), "finite numbers")
    return tuple(values)


def _require(holds: bool, what: str) -> None:
    if not holds:
        raise ValueError(f"it needs {what}")
