"""A medium about the bodies of a space, as forces on them in each engine step: Chipmunk has none itself."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from nmes.backend import Array, SceneSpec
from nmes.backend.medium import Immersion
from nmes.backends.pymunk2d.joints import Body

__all__ = ["Fluid"]


class Fluid:
    """The medium of one scene.

    Attributes:
        acts: Whether there is one.
    """

    def __init__(self, scene: SceneSpec) -> None:
        self._scene, self.acts = scene, scene.medium is not None
        self._immersion: Immersion | None = None  # None: the bodies are to be looked up

    def forget(self) -> None:
        """Looks the bodies up again, since some came or went."""
        self._immersion = None

    def act(self, bodies: Mapping[int, Body], states: Array) -> None:
        """Adds the forces of the medium to those that act on bodies in the engine step that follows.

        Args:
            bodies: All of them.
            states: Theirs, array (n, 13) as `Simulation.states` has them.
        """
        wrenches = self._immersed(bodies).wrenches(states)
        for b, (x, y, _, _, _, turn) in zip(bodies.values(), wrenches.T.tolist(), strict=True):
            if not b.frozen and not b.body.is_sleeping and (x or y or turn):
                b.body.force, b.body.torque = (b.force[0] + x, b.force[1] + y), b.torque + turn

    def _immersed(self, bodies: Mapping[int, Body]) -> Immersion:
        if self._immersion is None:
            scene, specs = self._scene, [b.spec for b in bodies.values()]
            assert scene.medium is not None
            shapes, sizes = [spec.shape for spec in specs], [spec.size for spec in specs]
            masses = np.array([spec.mass for spec in specs])
            self._immersion = Immersion(scene.medium, scene.gravity, scene.timestep, shapes, sizes, masses)
        return self._immersion
