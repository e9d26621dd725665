"""Pictures of a MuJoCo scene, drawn off screen.

It hides OpenGL: where a context comes from, and that one belongs to the thread that made it, so that one thread draws
for all worlds. It works on copies, of the model for colours and of the coordinates for poses: a simulation is the same
whether it was drawn or not. What is only there to be looked at, the tiles of the ground, the sky, shadows, outlines and
the tones of steps, is painted on here and is in no model that is simulated.

Most machines that make films draw in software, where several samples a pixel and a second pass cost more than all else.
So a scene is drawn once, each pixel once, and outlines are lines in it.
"""

from __future__ import annotations

import atexit
import copy
import ctypes
import importlib
import logging
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from math import hypot, tan
from typing import Any

import mujoco
import numpy as np

from nmes.backend import Array, CameraSpec, Image
from nmes.backend.rotation import rotate
from nmes.backends.mujoco3d.model import CompiledModel
from nmes.backends.mujoco3d.scenery import Scenery
from nmes.errors import WorldError

__all__ = ["Renderer", "missing", "opengl_context"]

Color = tuple[float, float, float]
Colors = Mapping[int, tuple[float, float, float, float]]

logger = logging.getLogger(__name__)

_NEAR, _FAR = 0.01, 2000.0  # m
_GREY = (0.5, 0.5, 0.5, 1.0)
_LIGHT = (-0.4, -1.0, -0.6)  # direction in which it shines
_SHADOW = 1024  # pixels a side of the map of shadows
_SHADED = 0.6  # of the way to what is looked at: how far around it shadows reach
_AHEAD = 12.0  # m: how far away what is looked at is taken to be, at most
_TILE = 1.0  # m: edge of a tile of the ground
_PLAIN = 400.0  # m: half the edge of the ground that is drawn of a plane without end
_TILES = ((1.0, 1.0, 1.0), (0.92, 0.93, 0.94), (0.72, 0.74, 0.77))  # two colours, and that of the joints
_FLOOR = (0.88, 0.89, 0.91, 1.0)
_STONE = ((0.80, 0.82, 0.85, 1.0), (0.66, 0.69, 0.74, 1.0))  # of boxes of the scenery, in turn: steps are told apart
_PIT = (0.36, 0.38, 0.42, 1.0)  # of boxes that end at the ground's level or below: walls and floors of gaps
_LEVEL = 1e-6  # m: how near to the ground's level the top of a box is that is part of it
_BELOW = 0.05  # m: how far such a box is drawn below its tiles
_MEADOW = (0.60, 0.72, 0.52, 1.0)
_DAY = (0.36, 0.52, 0.72), (0.84, 0.88, 0.92), (0.62, 0.66, 0.71)  # of the sky: zenith, horizon and below
_SPACE = (0.09, 0.11, 0.17), (0.15, 0.18, 0.26), (0.09, 0.11, 0.17)  # where planets are, and no ground
_INK = 0.12  # of a thing's colour: its outline
_SHADOWLESS = 0.98  # opacity of outlines: what is seen through, if hardly so, casts no shadow and has none
_TINY = 5.0  # pixels: half the longest edge of a box, below which outlines would hide it
_NEARER = 0.004  # of the way to the eye: how far outlines are before what they belong to
_ON_PLANE, _ON_REST, _ON_FIELDS = range(3)  # materials: tiles of the plane, of what gaps leave, of the first landscape
_NO_OPENGL = (
    "this machine has no OpenGL that works without a display; install libegl1 or libosmesa6 (Debian's names), or a "
    "graphics driver"
)
# Headless ones, and without a graphics card: a window system's would need a display.
_PLATFORMS = {"egl": "libEGL.so", "osmesa": "libOSMesa.so"}

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
            raise WorldError("unsupported", _NO_OPENGL)
        gl.make_current()
        model = copy.copy(compiled.model)
        for index, number in compiled.body_number.items():
            first = model.body_geomadr[index]
            model.geom_rgba[first : first + model.body_geomnum[index]] = colors.get(number, _GREY)
        scene, edged = self._scene(model, qpos)
        context = self._context
        if context is None:
            context = self._context = mujoco.MjrContext(_canvas(self._scenery), mujoco.mjtFontScale.mjFONTSCALE_50)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context)
        if (context.offWidth, context.offHeight) != (camera.width, camera.height):
            mujoco.mjr_resizeOffscreen(camera.width, camera.height, context)
        self._aim(scene, camera, context)
        _outline(scene, edged, camera)
        window = mujoco.MjrRect(0, 0, camera.width, camera.height)
        image = np.empty((camera.height, camera.width, 3), np.uint8)
        mujoco.mjr_render(window, scene, context)
        mujoco.mjr_readPixels(image, None, window, context)
        return image[::-1]  # OpenGL's rows begin at the bottom

    def _scene(self, model: mujoco.MjModel, qpos: Array) -> tuple[mujoco.MjvScene, list[mujoco.MjvGeom]]:
        """Returns the scene to draw, and the things in it that get outlines."""
        data = mujoco.MjData(model)
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        option = mujoco.MjvOption()
        option.sitegroup[:] = 0  # sites are marks of ours
        scene = mujoco.MjvScene(model, maxgeom=3 * model.ngeom + 16)
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(model, data, option, None, mujoco.MjvCamera(), everything, scene)
        things = scene.geoms[: scene.ngeom]
        return scene, [thing for thing in things if model.geom_bodyid[thing.objid] or _paint(scene, thing)]

    def _aim(self, scene: mujoco.MjvScene, camera: CameraSpec, context: mujoco.MjrContext) -> None:
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
        ahead = -camera.position[1] / forward[1] if forward[1] < -1e-6 and camera.position[1] > 0.0 else _AHEAD
        ahead = min(ahead, _AHEAD)
        context.shadowClip = _SHADED * ahead
        light.pos = np.array(camera.position) + forward * ahead - 4.0 * context.shadowClip * light.dir
        light.headlight, light.castshadow = 0, camera.shadows
        light.ambient, light.diffuse, light.specular = (0.0,) * 3, (0.5,) * 3, (0.0,) * 3
        sky = scene.lights[1]  # one of its own: what is in the shadow of a light has nothing of its ambience either
        sky.type, sky.dir, sky.headlight, sky.castshadow = light.type, forward, 1, 0
        sky.ambient, sky.diffuse, sky.specular = (0.4,) * 3, (0.12,) * 3, (0.0,) * 3
        scene.nlight = 2


def _paint(scene: mujoco.MjvScene, geom: mujoco.MjvGeom) -> bool:
    """Gives a thing of the scenery its colour, and tiles to what is ground; returns whether it gets an outline."""
    if geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
        # One without end follows the camera, and its tiles would slide along.
        geom.matid, geom.pos, geom.size, geom.rgba = _ON_PLANE, (0.0, 0.0, 0.0), (_PLAIN,) * 3, _FLOOR
        return False
    if geom.type == mujoco.mjtGeom.mjGEOM_HFIELD:
        geom.matid, geom.rgba = _ON_FIELDS + geom.dataid, _MEADOW
        return False
    if geom.type != mujoco.mjtGeom.mjGEOM_BOX:
        geom.rgba = _STONE[geom.objid % len(_STONE)] if np.array_equal(geom.rgba, _GREY) else _MEADOW
        return False
    top = geom.pos[1] + np.abs(geom.mat[1]) @ geom.size
    if top > _LEVEL:
        geom.rgba = _STONE[geom.objid % len(_STONE)]
        return True
    geom.rgba = _PIT
    if abs(top) < _LEVEL and geom.mat[1, 1] > 1.0 - _LEVEL:
        _tile(scene, geom)
    return False  # what gaps leave of the ground is many boxes: their edges would be seams in it


def _tile(scene: mujoco.MjvScene, ground: mujoco.MjvGeom) -> None:
    """Lays tiles on a box that gaps have left of the ground, and lowers it a little, out of their way."""
    width, height, length = ground.size
    # A plane lies across its own z: here, across what is up.
    size, mat = np.array([width, length, 1.0]), ground.mat[:, (0, 2, 1)] * (1.0, -1.0, 1.0)
    place = ground.pos + ground.mat[:, 1] * height
    tiles = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(tiles, mujoco.mjtGeom.mjGEOM_PLANE, size, place, mat.ravel(), np.array(_FLOOR, np.float32))
    tiles.matid = _ON_REST
    scene.ngeom += 1
    ground.pos = ground.pos - ground.mat[:, 1] * _BELOW


def _outline(scene: mujoco.MjvScene, things: Sequence[mujoco.MjvGeom], camera: CameraSpec) -> None:
    """Draws the edges of boxes: where two of one colour touch, nothing else would part them."""
    eye, pixel = np.array(camera.position), 2.0 * tan(camera.fov / 2.0) / camera.height  # m, one metre away
    for box in things:
        if box.type != mujoco.mjtGeom.mjGEOM_BOX or box.rgba[3] == 0.0:
            continue
        away = box.pos - eye
        if box.size.max() < _TINY * pixel * hypot(*away):
            continue
        ink = np.array([*(_INK * box.rgba[:3]), _SHADOWLESS * box.rgba[3]], np.float32)
        # Drawn smaller and nearer to the eye, it covers the same pixels, and is before the faces that it bounds.
        place, size = eye + away * (1.0 - _NEARER), box.size * (1.0 - _NEARER)
        line = scene.geoms[scene.ngeom]
        mujoco.mjv_initGeom(line, mujoco.mjtGeom.mjGEOM_LINEBOX, size, place, box.mat.ravel(), ink)
        scene.ngeom += 1


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
    sky = _sky(*(_SPACE if scenery.attracts else _DAY))
    texture = spec.add_texture(
        name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, width=sky.shape[1], height=6 * sky.shape[1], nchannel=3
    )
    texture.data = sky.tobytes()
    scenery.add(spec)
    # How often the texture, two tiles by two, repeats: in two metres, but over the whole of a landscape.
    repeats = [[1.0 / _TILE] * 2] * _ON_FIELDS + [
        [length / _TILE for length in field.size[:2]] for field in spec.hfields
    ]
    for number, repeat in enumerate(repeats):
        material = spec.add_material(name=f"ground{number}", texrepeat=repeat, texuniform=number == _ON_REST)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "tiles"
    spec.stat.extent = 1.0
    spec.visual.quality.shadowsize, spec.visual.quality.offsamples = _SHADOW, 0
    return spec.compile()


def _sky(zenith: Color, horizon: Color, nadir: Color) -> Image:
    """Returns the faces of a sky whose zenith is y: +x, -x, +z, -z, -y, +y, turned as MuJoCo, with z up, has them."""
    size = 32
    up = np.linspace(-1.0, 1.0, size)[:, None]
    light = np.where(up > 0.0, np.sqrt(np.abs(up)), np.minimum(1.0, 6.0 * np.abs(up)))
    far = np.where(up > 0.0, np.array([zenith]), np.array([nadir]))
    column = (255.0 * (np.array([horizon]) * (1.0 - light) + far * light)).astype(np.uint8)  # from below to above
    faces = np.empty((6, size, size, 3), np.uint8)
    faces[0], faces[1] = column[None, :], column[None, ::-1]
    faces[2], faces[3] = column[::-1, None], column[:, None]
    faces[4], faces[5] = column[0], column[-1]
    return faces


def _platforms() -> list[str]:
    """Returns through what OpenGL may draw, the best first."""
    chosen = os.environ.get("MUJOCO_GL", "").lower()
    return [chosen] if chosen in _PLATFORMS else list(_PLATFORMS)


def missing() -> str | None:
    """Returns why no pictures can be drawn on this machine; None if it has a library that may.

    To load one takes a millisecond. Whether it works, which takes a hundred, is seen with the first picture.
    """
    for platform in _platforms():
        for version in ("", *(f".{number}" for number in range(10))):  # PyOpenGL takes whichever there is
            try:
                ctypes.CDLL(f"{_PLATFORMS[platform]}{version}")
                return None
            except OSError:
                pass
    return _NO_OPENGL


@cache
def opengl_context() -> Any:
    """Returns this thread's OpenGL context, or None if the machine has none; called on the drawing thread."""
    logging.getLogger("OpenGL.acceleratesupport").setLevel(logging.WARNING)  # tells everybody what it could do without
    for platform in _platforms():
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
