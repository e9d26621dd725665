"""Pictures of a MuJoCo scene, drawn off screen.

It hides OpenGL: where a context comes from, and that one belongs to the thread that made it, so that one thread draws
for all worlds. It works on copies, of the model for colours and of the coordinates for poses: a simulation is the same
whether it was drawn or not.
"""

from __future__ import annotations

import copy
import importlib
import logging
import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from math import tan
from typing import Any

import mujoco
import numpy as np

from nmes.backend import Array, CameraSpec, Image
from nmes.backends.mujoco3d.layout import Layout
from nmes.errors import WorldError
from nmes.rotation import rotate

__all__ = ["Painter"]

Colors = Mapping[int, tuple[float, float, float, float]]

logger = logging.getLogger(__name__)

_NEAR, _FAR = 0.01, 2000.0  # m
_GREY = (0.5, 0.5, 0.5, 1.0)
_LIGHT = (-0.4, -1.0, -0.6)  # direction in which it shines
# Headless ones, and without a graphics card: a window system's would need a display.
_PLATFORMS = ("egl", "osmesa")

_thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="nmes-mujoco-drawing")


class Painter:
    """Draws one simulation, whatever its model is at the time.

    What OpenGL holds is made for the first model and serves the later ones: only cubes and joints come and go.
    """

    def __init__(self) -> None:
        self._context: mujoco.MjrContext | None = None

    def draw(self, camera: CameraSpec, layout: Layout, qpos: Array, colors: Colors) -> Image:
        """Returns the picture; see `nmes.backend.Simulation.draw`. The layout's model is left as it is."""
        return _thread.submit(self._draw, camera, layout, qpos, colors).result()

    def close(self) -> None:
        """Gives back what OpenGL holds."""
        if self._context is not None:
            _thread.submit(self._free).result()

    def _free(self) -> None:
        _gl().make_current()
        assert self._context is not None
        self._context.free()
        self._context = None

    def _draw(self, camera: CameraSpec, layout: Layout, qpos: Array, colors: Colors) -> Image:
        gl = _gl()
        if gl is None:
            raise WorldError("unsupported", "this machine has no OpenGL that works without a display")
        gl.make_current()
        model = copy.copy(layout.model)
        for index, number in layout.number.items():
            first = model.body_geomadr[index]
            model.geom_rgba[first : first + model.body_geomnum[index]] = colors.get(number, _GREY)
        scene = self._scene(model, qpos)
        self._aim(scene, camera)
        context = self._context
        if context is None:
            model.vis.quality.shadowsize = 0
            context = self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context)
        if (context.offWidth, context.offHeight) != (camera.width, camera.height):
            mujoco.mjr_resizeOffscreen(camera.width, camera.height, context)
        window = mujoco.MjrRect(0, 0, camera.width, camera.height)
        image = np.empty((camera.height, camera.width, 3), np.uint8)
        mujoco.mjr_render(window, scene, context)
        mujoco.mjr_readPixels(image, None, window, context)
        return image[::-1]  # OpenGL's rows begin at the bottom

    def _scene(self, model: mujoco.MjModel, qpos: Array) -> mujoco.MjvScene:
        data = mujoco.MjData(model)
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        option = mujoco.MjvOption()
        option.sitegroup[:] = 0  # sites are marks of ours
        scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 16)
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(model, data, option, None, mujoco.MjvCamera(), everything, scene)
        return scene

    def _aim(self, scene: mujoco.MjvScene, camera: CameraSpec) -> None:
        top = _NEAR * tan(camera.fov / 2.0)
        for eye in scene.camera[:2]:
            eye.pos = camera.position
            eye.forward = rotate(camera.quaternion, (0.0, 0.0, -1.0))
            eye.up = rotate(camera.quaternion, (0.0, 1.0, 0.0))
            eye.frustum_near, eye.frustum_far = _NEAR, _FAR
            eye.frustum_bottom, eye.frustum_top = -top, top
            eye.frustum_center = eye.frustum_width = 0.0  # as wide as the image's aspect says
        light = scene.lights[0]
        light.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
        light.dir = np.array(_LIGHT) / np.linalg.norm(_LIGHT)
        light.headlight = light.castshadow = 0
        light.ambient, light.diffuse, light.specular = (0.45,) * 3, (0.55,) * 3, (0.0,) * 3
        scene.nlight = 1


@cache
def _gl() -> Any:
    """Returns this thread's OpenGL context, or None if there is none to be had; to be asked on the drawing thread."""
    logging.getLogger("OpenGL.acceleratesupport").setLevel(logging.WARNING)  # tells everybody what it could do without
    wanted = os.environ.get("MUJOCO_GL", "").lower()
    for platform in (wanted,) if wanted in _PLATFORMS else _PLATFORMS:
        chosen = os.environ.get("PYOPENGL_PLATFORM")
        try:
            return importlib.import_module(f"mujoco.{platform}").GLContext(1, 1)
        except Exception as error:  # whatever a library that is not quite there does
            logger.debug("no OpenGL through %s: %s", platform, error)
            if chosen is None:
                os.environ.pop("PYOPENGL_PLATFORM", None)
    return None
