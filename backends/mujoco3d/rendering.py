"""Pictures of a MuJoCo scene, drawn off screen.

It hides OpenGL: where a context comes from, and that one belongs to the thread that made it, so that one thread draws
for all worlds. It works on copies, of the model for colours and of the coordinates for poses: a simulation is the same
whether it was drawn or not. What is only there to be looked at, the tiles of the ground, the sky and shadows, is
painted on here and is in no model that is simulated.
"""

from __future__ import annotations

import atexit
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
from nmes.backend.rotation import rotate
from nmes.backends.mujoco3d.model import CompiledModel
from nmes.backends.mujoco3d.scenery import Scenery
from nmes.errors import WorldError

__all__ = ["Renderer", "opengl_context"]

Colors = Mapping[int, tuple[float, float, float, float]]

logger = logging.getLogger(__name__)

_NEAR, _FAR = 0.01, 2000.0  # m
_GREY = (0.5, 0.5, 0.5, 1.0)
_LIGHT = (-0.4, -1.0, -0.6)  # direction in which it shines
_SHADOW = 2048  # pixels a side of the map of shadows
_SHADED = 12.0  # m: how far from what is looked at shadows reach
_TILE = 1.0  # m: edge of a tile of the ground
_PLAIN = 400.0  # m: half the edge of the ground that is drawn of a plane without end
_TILES = ((1.0, 1.0, 1.0), (0.86, 0.87, 0.88), (0.7, 0.71, 0.72))  # two colours, and that of the joints
_ZENITH, _HORIZON, _NADIR = (0.36, 0.52, 0.72), (0.84, 0.88, 0.92), (0.30, 0.32, 0.34)
_EDGE = 0.45  # of the light of a pixel at the edge of a cube
_REMEDY = "install libegl1 or libosmesa6 (Debian's names), or a graphics driver"
# Headless ones, and without a graphics card: a window system's would need a display.
_PLATFORMS = ("egl", "osmesa")

_thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="nmes-mujoco-drawing")


class Renderer:
    """Draws one simulation, whatever its model is at the time.

    What OpenGL holds is made of the scenery and serves all models: only cubes and joints come and go.
    """

    def __init__(self, scenery: Scenery) -> None:
        self._scenery = scenery
        self._context: mujoco.MjrContext | None = None

    def draw(self, camera: CameraSpec, compiled: CompiledModel, qpos: Array, colors: Colors) -> Image:
        """Returns the picture; see `nmes.backend.Simulation.draw`. The compiled model is left as it is."""
        return _thread.submit(self._draw, camera, compiled, qpos, colors).result()

    def close(self) -> None:
        """Gives back what OpenGL holds."""
        if self._context is not None:
            _thread.submit(self._free).result()

    def _free(self) -> None:
        opengl_context().make_current()
        assert self._context is not None
        self._context.free()
        self._context = None

    def _draw(self, camera: CameraSpec, compiled: CompiledModel, qpos: Array, colors: Colors) -> Image:
        gl = opengl_context()
        if gl is None:
            raise WorldError("unsupported", f"this machine has no OpenGL that works without a display; {_REMEDY}")
        gl.make_current()
        model = copy.copy(compiled.model)
        for index, number in compiled.body_number.items():
            first = model.body_geomadr[index]
            model.geom_rgba[first : first + model.body_geomnum[index]] = colors.get(number, _GREY)
        scene = self._scene(model, qpos)
        self._aim(scene, camera)
        context = self._context
        if context is None:
            context = self._context = mujoco.MjrContext(_canvas(self._scenery), mujoco.mjtFontScale.mjFONTSCALE_50)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context)
        if (context.offWidth, context.offHeight) != (camera.width, camera.height):
            mujoco.mjr_resizeOffscreen(camera.width, camera.height, context)
        image = _pixels(scene, context, camera)
        scene.flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = scene.flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = True
        _draw_edges(image, _pixels(scene, context, camera), scene, model)
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
        for geom in scene.geoms[: scene.ngeom]:
            if geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
                # One without end follows the camera, and its tiles would slide along.
                geom.matid, geom.pos, geom.size = 0, (0.0, 0.0, 0.0), (_PLAIN,) * 3
            elif geom.type == mujoco.mjtGeom.mjGEOM_HFIELD:
                geom.matid = 1 + geom.dataid
        return scene

    def _aim(self, scene: mujoco.MjvScene, camera: CameraSpec) -> None:
        top = _NEAR * tan(camera.fov / 2.0)
        forward = np.array(rotate(camera.quaternion, (0.0, 0.0, -1.0)))
        for eye in scene.camera[:2]:
            eye.pos = camera.position
            eye.forward = forward
            eye.up = rotate(camera.quaternion, (0.0, 1.0, 0.0))
            eye.frustum_near, eye.frustum_far = _NEAR, _FAR
            eye.frustum_bottom, eye.frustum_top = -top, top
            eye.frustum_center = eye.frustum_width = 0.0  # as wide as the image's aspect says
        light = scene.lights[0]
        light.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
        light.dir = np.array(_LIGHT) / np.linalg.norm(_LIGHT)
        # Shadows are there around what is looked at: where the view meets the ground, if that is near.
        ahead = -camera.position[1] / forward[1] if forward[1] < -1e-6 and camera.position[1] > 0.0 else _SHADED
        light.pos = np.array(camera.position) + forward * min(ahead, _SHADED) - 4.0 * _SHADED * light.dir
        light.headlight, light.castshadow = 0, camera.shadows
        light.ambient, light.diffuse, light.specular = (0.0,) * 3, (0.5,) * 3, (0.0,) * 3
        sky = scene.lights[1]  # one of its own: what is in the shadow of a light has nothing of its ambience either
        sky.type, sky.dir, sky.headlight, sky.castshadow = light.type, forward, 1, 0
        sky.ambient, sky.diffuse, sky.specular = (0.4,) * 3, (0.12,) * 3, (0.0,) * 3
        scene.nlight = 2


def _pixels(scene: mujoco.MjvScene, context: mujoco.MjrContext, camera: CameraSpec) -> Image:
    """Returns the picture of a scene as OpenGL has it, its lowest row first."""
    window = mujoco.MjrRect(0, 0, camera.width, camera.height)
    image = np.empty((camera.height, camera.width, 3), np.uint8)
    mujoco.mjr_render(window, scene, context)
    mujoco.mjr_readPixels(image, None, window, context)
    return image


def _draw_edges(image: Image, owners: Image, scene: mujoco.MjvScene, model: mujoco.MjModel) -> None:
    """Darkens a picture where a cube ends: where two of one colour touch, nothing else would part them.

    Args:
        image: The picture.
        owners: The number of what each of its pixels shows, as a colour: 0 for the sky.
        scene: What was drawn.
        model: What it is made of: all but the scenery belongs to a body of its own.
    """
    shown = owners.astype(np.int32) @ (1, 1 << 8, 1 << 16)
    cubes = [geom.segid + 1 for geom in scene.geoms[: scene.ngeom] if model.geom_bodyid[geom.objid] > 0]
    is_cube = np.isin(shown, cubes)
    edge = np.zeros(shown.shape, bool)
    for here, there in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        edge[here] |= (shown[here] != shown[there]) & (is_cube[here] | is_cube[there])
    image[edge] = (_EDGE * image[edge]).astype(np.uint8)


def _canvas(scenery: Scenery) -> mujoco.MjModel:
    """Returns a model of the scenery alone, with a sky and tiles: a material for the plane, and one a landscape."""
    spec = mujoco.MjSpec()
    spec.add_texture(
        name="tiles",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        width=256,
        height=256,
        rgb1=_TILES[0],
        rgb2=_TILES[1],
        mark=mujoco.mjtMark.mjMARK_EDGE,
        markrgb=_TILES[2],
    )
    sky = _sky()
    texture = spec.add_texture(
        name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, width=sky.shape[1], height=6 * sky.shape[1], nchannel=3
    )
    texture.data = sky.tobytes()
    scenery.add(spec)
    # How often the texture, two tiles by two, repeats: over the whole of a landscape, but in two metres of a plane.
    for repeat in ([1.0 / _TILE] * 2, *([length / _TILE for length in field.size[:2]] for field in spec.hfields)):
        material = spec.add_material(name=f"ground{len(spec.materials)}", texrepeat=repeat)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "tiles"
    spec.stat.extent = 1.0
    spec.visual.map.shadowclip = _SHADED
    spec.visual.quality.shadowsize = _SHADOW
    return spec.compile()


def _sky() -> Image:
    """Returns the faces of a sky whose zenith is y: +x, -x, +z, -z, -y, +y, turned as MuJoCo, with z up, has them."""
    size = 32
    up = np.linspace(-1.0, 1.0, size)[:, None]
    light = np.where(up > 0.0, np.sqrt(np.abs(up)), np.minimum(1.0, 6.0 * np.abs(up)))
    far = np.where(up > 0.0, np.array([_ZENITH]), np.array([_NADIR]))
    column = (255.0 * (np.array([_HORIZON]) * (1.0 - light) + far * light)).astype(np.uint8)  # from below to above
    faces = np.empty((6, size, size, 3), np.uint8)
    faces[0], faces[1] = column[None, :], column[None, ::-1]
    faces[2], faces[3] = column[::-1, None], column[:, None]
    faces[4], faces[5] = column[0], column[-1]
    return faces


@cache
def opengl_context() -> Any:
    """Returns this thread's OpenGL context, or None if the machine has none; called on the drawing thread."""
    logging.getLogger("OpenGL.acceleratesupport").setLevel(logging.WARNING)  # tells everybody what it could do without
    chosen = os.environ.get("MUJOCO_GL", "").lower()
    for platform in (chosen,) if chosen in _PLATFORMS else _PLATFORMS:
        before = os.environ.get("PYOPENGL_PLATFORM")
        try:
            context = importlib.import_module(f"mujoco.{platform}").GLContext(1, 1)
            atexit.register(context.free)  # when Python ends, its own destructor finds the module's names gone
            return context
        except Exception as error:  # whatever a library that is not quite there does
            logger.debug("no OpenGL through %s: %s", platform, error)
            if before is None:
                os.environ.pop("PYOPENGL_PLATFORM", None)
    return None
