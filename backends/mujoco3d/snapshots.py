"""A scene's whole state as JSON: structure, and MuJoCo's integration state and sleep in base64."""

from __future__ import annotations

import base64

import mujoco
import numpy as np
import orjson

from nmes.backend import SceneSpec
from nmes.backends.mujoco3d.compiler import compile_model
from nmes.backends.mujoco3d.forest import Body, Joint, spanning_forest
from nmes.backends.mujoco3d.running import RunningModel, Wrenches
from nmes.backends.mujoco3d.sensing import STATE
from nmes.backends.mujoco3d.structure import Structure

__all__ = ["read_snapshot", "write_snapshot"]


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
    return orjson.dumps(
        {
            "bodies": list(structure.bodies.values()),  # orjson writes dataclasses by their fields
            "joints": list(structure.joints.values()),
            "frozen_at": frozen_at,
            "force": list(wrenches.forces.items()),
            "impulse": list(wrenches.impulses.items()),
            "parting": sorted(running.depenetration.bodies),  # its name in the format
            "state": base64.b64encode(running.state().tobytes()).decode(),
            "asleep": running.asleep.tolist(),
            "roots": running.compiled.roots,
        }
    )


def read_snapshot(
    snapshot: bytes, scene: SceneSpec, running: RunningModel, structure: Structure, wrenches: Wrenches
) -> None:
    """Takes up a state that `write_snapshot` returned, in place of all that is here."""
    fields = orjson.loads(snapshot)
    structure.replace([*map(Body.from_json, fields["bodies"])], [*map(Joint.from_json, fields["joints"])])
    wrenches.forces = dict(fields["force"])
    wrenches.impulses = dict(fields["impulse"])
    running.depenetration.bodies = set(fields["parting"])
    bodies, joints = structure.bodies, structure.joints
    frozen_at = {int(number): (tuple(pose[:3]), tuple(pose[3:])) for number, pose in fields["frozen_at"].items()}
    forest = spanning_forest(bodies, joints.values())
    compiled = compile_model(scene, running.scenery, bodies, joints, forest, frozen_at, fields["roots"])
    running.install(compiled, joints)
    state = np.frombuffer(base64.b64decode(fields["state"]))
    mujoco.mj_setState(running.model, running.data, state.copy(), STATE)
    running.settle(np.array(fields["asleep"], running.asleep.dtype))
