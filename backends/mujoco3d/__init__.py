"""The MuJoCo engine (3.17 or newer) as a backend, in 3D.

`structure` keeps the bodies and joints and their edits, `forest` finds their kinematic trees, `compiler` and `model`
make a compiled model of them, `running` steps it, and `rebuild` brings it up to date after edits, with
`state_transfer` and `sleep` for its state. `motors`, `sensing`, `tracking` and `rendering` are what goes in and comes
out; `scenery` and `arenas` stand still. Nothing else knows of MuJoCo.
"""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path
from typing import ClassVar

import mujoco

from nmes.backend import Backend, SceneSpec, Simulation
from nmes.backends.mujoco3d import arenas, rendering
from nmes.backends.mujoco3d.simulation import MujocoSimulation

__all__ = ["MujocoBackend", "MujocoSimulation"]


def _lacking() -> dict[str, str]:
    missing = {"camera": rendering.missing(), "scene.arena": arenas.missing()}
    return {capability: why for capability, why in missing.items() if why is not None}


class MujocoBackend(Backend):
    """MuJoCo, the first-class engine: cubes in 3D, all kinds of joints, sleep, exact snapshots."""

    name = "mujoco"
    dims = 3
    lacking = _lacking()
    capabilities = frozenset(
        {
            "joint.fixed",
            "joint.hinge",
            "joint.slide",
            "joint.pin",
            "joint.conetwist",
            "joint.several",
            "medium",
            "motor",
            "servo",
            "limits",
            "spring",
            "friction",
            "restitution",
            "collisions",
            "collision_groups",
            "contacts",
            "sensors.inertial",
            "sensors.range",
            "camera",
            "scene.arena",
            "scene.damping",
            "scene.heightfield",
            "scene.obstacles",
            "scene.planets",
            "sleep",
            "shape.capsule",
            "shape.cylinder",
            "shape.sphere",
            "snapshot",
        }
    ).difference(lacking)

    known_defects: ClassVar = {
        "4.0.0": "with a sparse constraint Jacobian (from 60 degrees of freedom on) its Newton solver goes wrong where "
        "branching bodies touch (MuJoCo's issue 3767); install 3.17.0, or 4.0.1 or newer"
    }
    most_joined = 1000  # bodies in a row may be 1,023 deep, less one for the proxy of a loop

    def version(self) -> str:
        """Returns MuJoCo's version."""
        return str(mujoco.__version__)

    def fingerprint(self) -> dict[str, str]:
        """Returns MuJoCo's version and the SHA-256 of its shared library."""
        return {"engine": f"mujoco {mujoco.__version__}", "engine_sha256": _library_hash()}

    def create(self, scene: SceneSpec) -> Simulation:
        """Creates an empty scene."""
        return MujocoSimulation(scene)


@cache
def _library_hash() -> str:
    """Returns the SHA-256 of the library that runs, whatever others lie beside it; "unknown" if it is elsewhere."""
    version = mujoco.mj_versionString()
    for name in (f"libmujoco.so.{version}", f"libmujoco.{version}.dylib", "mujoco.dll"):
        path = Path(mujoco.__file__).with_name(name)
        if path.is_file():
            return hashlib.sha256(path.read_bytes()).hexdigest()
    return "unknown"
