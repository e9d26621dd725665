"""The planar engine: pymunk (Chipmunk), for quick tests and experiments that stay in the XY plane.

It hides how NMES's joints are put together from Chipmunk's constraints, and what Chipmunk does not do by itself: a
motor along a line, joints between frozen bodies, faults instead of infinities. Motion along z and rotation about x
and y do not exist: they are 0 in every answer and ignored in every argument.

`joints` puts joints together, `scenery` makes what stands still, `fluid` is the medium, `simulation` runs the space.
"""

from __future__ import annotations

import functools
from hashlib import sha256
from pathlib import Path

import numpy as np
import pymunk

from nmes.backend import Backend, SceneSpec
from nmes.backends.pymunk2d.simulation import PymunkSimulation

__all__ = ["PymunkBackend", "PymunkSimulation"]


class PymunkBackend(Backend):
    """The engine as `nmes serve --backend pymunk` finds it."""

    name = "pymunk"
    dims = 2
    capabilities = frozenset(
        {"joint.fixed", "joint.hinge", "joint.slide", "joint.pin", "joint.conetwist", "joint.several", "motor", "servo"}
        | {"limits", "spring", "friction", "restitution", "contacts", "collisions", "collision_groups", "sleep"}
        | {"scene.obstacles", "scene.heightfield", "scene.damping"}
        | {"medium", "shape.sphere", "shape.capsule", "shape.cylinder"}
    )

    def version(self) -> str:
        """Returns pymunk's version."""
        return pymunk.version

    def fingerprint(self) -> dict[str, str]:
        """Returns the versions of pymunk and of its Chipmunk, and the SHA-256 of the compiled engine."""
        return {
            "version": pymunk.version,
            "chipmunk": pymunk.chipmunk_version,
            "numpy": np.__version__,
            "binary_sha256": _binary_hash(),
        }

    def create(self, scene: SceneSpec) -> PymunkSimulation:
        """Creates a space with the scene's ground, obstacles and heightfield."""
        return PymunkSimulation(scene)


@functools.cache
def _binary_hash() -> str:
    (binary,) = Path(pymunk.__file__).parent.glob("_chipmunk.*")
    return sha256(binary.read_bytes()).hexdigest()
