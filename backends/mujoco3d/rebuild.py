"""Brings a running model up to date with the edits of its structure, the cheapest way.

Free bodies that come, go or are moved are taken up in the model as it is, where parked bodies stand ready. For all
other edits the model is compiled again, if its structure changed, and the state transferred.
"""

from __future__ import annotations

from collections.abc import Callable

import mujoco

from nmes.backend import BodyState, SceneSpec
from nmes.backends.mujoco3d.compiler import compile_lone_body, compile_model
from nmes.backends.mujoco3d.forest import spanning_forest
from nmes.backends.mujoco3d.model import SPARE, CompiledModel, occupy, set_mean_inertia, vacate
from nmes.backends.mujoco3d.running import RunningModel
from nmes.backends.mujoco3d.sleep import AWAKE, count_awake, restored_sleep, surviving_sleep
from nmes.backends.mujoco3d.state_transfer import (
    affected_bodies,
    ball_orientations,
    freed_loop_joints,
    place_body,
    rezero,
    transfer_state,
)
from nmes.backends.mujoco3d.structure import Structure
from nmes.errors import SimulationFault

__all__ = ["PARKING_FROM", "apply_edits"]

StateOf = Callable[[int], BodyState]

PARKING_FROM = 64
"""Bodies from which on compiling the model for one more takes too long, and some are parked."""

_AT_ORIGIN = BodyState((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def apply_edits(running: RunningModel, structure: Structure, scene: SceneSpec, state_of: StateOf) -> None:
    """Brings the model up to date with the edits since the last step.

    Args:
        running: The model until now; it runs the new one afterwards.
        structure: The bodies and joints, and their edits, which are cleared.
        scene: Time step, gravity and the rest.
        state_of: Returns the state of a body by its number, edited or not.

    Raises:
        SimulationFault: `engine_failed`, since MuJoCo cannot build the structure.
    """
    running.motors.sync()
    compiled = running.compiled
    room = len(compiled.spares) + len(structure.departed)
    fits = not structure.stale and len(structure.arrived) <= room
    if fits and structure.touched <= structure.lone_bodies(compiled):
        _fill_places(running, structure, scene)
    else:
        _rebuild(running, structure, scene, state_of)
    structure.clear_edits()


def _fill_places(running: RunningModel, structure: Structure, scene: SceneSpec) -> None:
    """Takes up free bodies that came, went or were moved, in the model as it is: parked ones stand ready."""
    compiled, model, data = running.compiled, running.model, running.data
    moved = [body for body in structure.touched if body not in structure.arrived]
    running.wake(*(compiled.body_index[body] for body in [*sorted(moved), *structure.departed]))
    for body in structure.departed:
        slot, index = compiled.free[body], vacate(compiled, body)
        place_body(data, slot, _AT_ORIGIN)
        tree = int(model.body_treeid[index])
        running.asleep[tree] = tree
    for body in structure.arrived:
        lone = compile_lone_body(scene, structure.bodies[body])
        index = occupy(compiled, structure.bodies[body], lone)
        running.asleep[model.body_treeid[index]] = AWAKE
    for body in structure.touched:
        place_body(data, compiled.free[body], structure.overrides[body])
    if structure.arrived or structure.departed:
        set_mean_inertia(compiled)
        running.fluid.install(compiled)
    count_awake(model, data)
    running.depenetration.watch(structure.touched)
    running.forget_kinematics()
    running.replace_senses()


def _rebuild(running: RunningModel, structure: Structure, scene: SceneSpec, state_of: StateOf) -> None:
    """Compiles the model where the structure changed, and transfers the state."""
    old, old_data = running.compiled, running.data
    touched, joints = structure.touched, structure.joints
    states = {body: state_of(body) for body in affected_bodies(touched, structure.bodies, joints.values())}
    recompiles = structure.stale or structure.arrived or structure.departed
    compiled = _compile(running, structure, scene, state_of) if recompiles else old
    balls = ball_orientations(joints.values(), states, state_of)
    sleep = {} if structure.wake_all else surviving_sleep(old, running.asleep, states, structure.bodies)
    running.install(compiled, joints)
    transfer_state(old, old_data, compiled, running.data, joints, states, balls)
    _hold_joints(structure, old, old_data, compiled)
    running.depenetration.watch([body for body in states if body in touched])
    asleep = restored_sleep(compiled, sleep)
    if (asleep >= 0).any():
        running.settle(asleep)
    else:
        running.asleep[:] = asleep


def _hold_joints(structure: Structure, old: CompiledModel, data: mujoco.MjData, new: CompiledModel) -> None:
    """Keeps the coordinates of joints that are in no model any more, and forgets those that are in one again."""
    for number, joint in structure.joints.items():
        if joint.kind in ("hinge", "slide"):
            slot = old.joint.get(number)
            if slot is not None and number not in new.joint:
                structure.hold_joint(joint, float(data.qpos[slot.q]))
            elif joint.held_at and number in new.joint:
                structure.hold_joint(joint, 0.0)


def _compile(running: RunningModel, structure: Structure, scene: SceneSpec, state_of: StateOf) -> CompiledModel:
    old, bodies, joints = running.compiled, structure.bodies, structure.joints
    forest = spanning_forest(bodies, joints.values())
    for joint in freed_loop_joints(forest, old):
        slot = old.joint.get(joint.number)
        coordinate = float(running.qpos[slot.q]) if slot is not None else 0.0
        structure.identity ^= joint.identity
        rezero(joint, state_of(joint.body1), state_of(joint.body2), coordinate)
        structure.identity ^= joint.identity
    frozen = {number: state_of(number) for number, body in bodies.items() if body.frozen}
    frozen_at = {number: (state.position, state.quaternion) for number, state in frozen.items()}
    roots = [*forest.trees, *[SPARE] * _spares(running, structure)]
    try:
        return compile_model(scene, running.scenery, bodies, joints, forest, frozen_at, roots)
    except (ValueError, mujoco.FatalError) as error:
        raise SimulationFault("engine_failed", f"MuJoCo cannot build this structure: {error}") from error


def _spares(running: RunningModel, structure: Structure) -> int:
    """Returns the number of parked bodies of a new model: some where free bodies come into a big world."""
    count = len(structure.bodies)
    sleeps = running.model.opt.enableflags & int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    if not structure.arrived or count < PARKING_FROM or not sleeps:
        return 0
    return max(16, count // 8)
