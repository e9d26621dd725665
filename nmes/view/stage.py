"""A stage for pictures: an engine that can draw shows cubes at the poses that any engine computed.

It hides that the stage is a simulation of its own, which is stepped by so little that nothing moves.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from nmes.backend import BodySpec, BodyState, CameraSpec, Image, Quaternion, Simulation, Vector, load_backend
from nmes.backend.rotation import normalize, plus
from nmes.recording.viewer_messages import Shape
from nmes.view.moments import Moment
from nmes.view.part_colors import visible_shapes
from nmes.world.scenery import scene_spec

__all__ = ["Stage"]

_DRAWN_BY = "mujoco"
_STILL = 1e-6  # s: one step of the stage, in which nothing gets anywhere
_JAGGED = 28  # levels of green between two pixels, from which the step between them is smoothed
_ZERO: Vector = (0.0, 0.0, 0.0)
_UPRIGHT: Quaternion = (0.0, 0.0, 0.0, 1.0)
_RED, _WHITE = (0.9, 0.15, 0.1, 1.0), (0.97, 0.97, 0.97, 1.0)
# The parts of a flag: where they are from the target, m, and their edge lengths and colours.
_FLAG: tuple[tuple[Vector, Shape], ...] = (
    ((0.0, 0.4, 0.0), ((0.05, 1.2, 0.05), _WHITE, "box")),
    ((0.2, 0.85, 0.0), ((0.36, 0.26, 0.03), _RED, "box")),
)
_FOOD: Shape = (0.16, 0.16, 0.16), (0.95, 0.75, 0.1, 1.0), "box"


class Stage:
    """A scene that an engine can draw: cubes at any poses, in the scenery of a world.

    Args:
        config: The world's complete config.

    Raises:
        BackendNotFound: The engine that draws is not installed.
    """

    def __init__(self, config: dict[str, Any]) -> None:
        self._config = config
        self._build(config["seed"])

    def _build(self, seed: int) -> None:
        scene = replace(scene_spec(self._config, seed), timestep=_STILL, gravity=(0.0, 0.0, 0.0), options={})
        self._simulation: Simulation = load_backend(_DRAWN_BY).create(scene)
        self._bodies: dict[str, tuple[int, Shape]] = {}
        self._made, self._seed = 0, seed

    def show(self, moment: Moment) -> None:
        """Puts all cubes where they are at a moment, a flag at each target, and a small cube where food is."""
        if moment.seed != self._seed:
            self.close()
            self._build(moment.seed)
        simulation, bodies = self._simulation, self._bodies
        places = [((x, y, z), normalize((a, b, c, w))) for x, y, z, a, b, c, w in moment.poses.tolist()]
        things = dict(zip(visible_shapes(moment.shapes).items(), places, strict=True))
        for number, target in enumerate(moment.targets):
            for part, (offset, shape) in enumerate(_FLAG):
                things[f"\0{number}.{part}", shape] = plus(target, offset), _UPRIGHT
        for x, y, z in moment.food:
            things[f"\0{x},{y},{z}", _FOOD] = (x, y + _FOOD[0][1] / 2.0, z), _UPRIGHT
        for name, (body, shape) in list(bodies.items()):
            if (name, shape) not in things:
                simulation.remove_body(body)
                del bodies[name]
        for (name, shape), (position, quaternion) in things.items():
            if name in bodies:
                simulation.set_body_state(bodies[name][0], BodyState(position, quaternion, _ZERO, _ZERO))
            else:
                self._made += 1
                bodies[name] = (self._made, shape)
                simulation.add_body(self._made, _spec(shape, position, quaternion))
        simulation.step(1)

    def draw(self, camera: CameraSpec) -> Image:
        """Returns the picture, an array (height, width, 3) of bytes.

        Raises:
            WorldError: `unsupported`: no OpenGL works here; the message says what to install.
        """
        return _smoothed(self._simulation.draw(camera, {body: shape[1] for body, shape in self._bodies.values()}))

    def close(self) -> None:
        """Frees the scene."""
        self._simulation.close()


def _spec(shape: Shape, position: Vector, quaternion: Quaternion) -> BodySpec:
    size, _, kind = shape
    return BodySpec(size, 1.0, 0.0, 0.0, position, quaternion, shape=kind)


def _smoothed(image: Image) -> Image:
    """Returns a picture in which edges are less jagged: a pixel at a step of light takes on half of its neighbours."""
    light = image[..., 1].astype(np.int16)
    steep = np.zeros(light.shape, bool)
    for here, there in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        jump = np.abs(light[here] - light[there]) > _JAGGED
        steep[here] |= jump
        steep[there] |= jump
    steep[[0, -1]] = steep[:, [0, -1]] = False
    rows, columns = np.nonzero(steep)
    around = sum(image[rows + y, columns + x].astype(np.uint16) for y, x in ((0, 1), (0, -1), (1, 0), (-1, 0)))
    smooth = image.copy()
    smooth[rows, columns] = (around + 4 * image[rows, columns].astype(np.uint16)) // 8
    return smooth
