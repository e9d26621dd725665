"""The static surroundings of a MuJoCo scene, the gravity of planets, and the settings of the solver.

It hides MuJoCo's own way up: its planes and heightfields face z, ours face y. The model is built anew whenever its
structure changes, so all that can be known before is computed once, in a Scenery, and adding it is cheap.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from math import ceil, hypot, sqrt
from typing import Any

import mujoco
import numpy as np

from nmes.backend import Array, Heightfield, Quaternion, SceneSpec, StaticBox, Vector
from nmes.backend.rotation import multiply
from nmes.backend.shapes import Shape, axis, lying
from nmes.backends.mujoco3d.arenas import Part, parts
from nmes.errors import WorldError

__all__ = ["Scenery", "set_options", "solid"]

_FACE_UP: Quaternion = (-sqrt(0.5), 0.0, 0.0, sqrt(0.5))
_UPRIGHT: Quaternion = (0.0, 0.0, 0.0, 1.0)
_GREY = (0.5, 0.5, 0.5, 1.0)
_GREEN = (0.35, 0.45, 0.3, 1.0)
_BASE = 1.0  # m: how thick a landscape is under its lowest point
# Heights are at most so far apart (m), unless that made more rows than _ROWS: a cube within one of MuJoCo's triangles
# trembles and never sleeps. Not finer than that, for at most 50 points carry a cube.
_CELL, _ROWS = 0.5, 500

_SOLVERS = {
    "newton": mujoco.mjtSolver.mjSOL_NEWTON,
    "cg": mujoco.mjtSolver.mjSOL_CG,
    "pgs": mujoco.mjtSolver.mjSOL_PGS,
}
_CONES = {"elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC, "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL}
_INTEGRATORS = {
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    "implicit": mujoco.mjtIntegrator.mjINT_IMPLICIT,
    "euler": mujoco.mjtIntegrator.mjINT_EULER,
    "rk4": mujoco.mjtIntegrator.mjINT_RK4,
}


class Scenery:
    """The static part of one scene. Two are equal when the same things stand in them.

    Attributes:
        identity: A number that stands for all of it, 0 for the bare flat ground.
        attracts: Whether planets pull at bodies, in place of the engine's own gravity.
    """

    def __init__(self, scene: SceneSpec) -> None:
        static = [*_ground(scene), *_obstacles(scene), *(parts(scene.arena) if scene.arena is not None else ())]
        # What is converted here is not converted at every build.
        self._geoms = [
            {
                "type": part.type,
                "size": list(part.size)[:3],
                "pos": list(part.position),
                "quat": [part.quaternion[3], *part.quaternion[:3]],
                "rgba": list(part.color),
            }
            for part in static
        ]
        self._fields = {
            i: (part.size, part.heights.shape, part.heights.astype(np.float32).ravel())
            for i, part in enumerate(static)
            if part.heights is not None
        }
        self.attracts = bool(scene.planets)
        self._centres = np.array([planet.position for planet in scene.planets]).reshape(-1, 3)
        self._gravity = scene.gravity
        self._strength = hypot(*scene.gravity)
        digest = hashlib.blake2b(repr((self._geoms, scene.planets)).encode(), digest_size=16)
        for _, _, heights in self._fields.values():
            digest.update(heights.tobytes())
        plain = scene.ground and len(static) == 1
        self.identity = 0 if plain else int.from_bytes(digest.digest(), "little")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Scenery) and self.identity == other.identity

    def __hash__(self) -> int:
        return self.identity

    def add(self, spec: mujoco.MjSpec) -> None:
        """Adds the scenery to the world body of a model that is being built."""
        if self._fields:
            # Boxes meet nothing but landscapes by this algorithm, and it finds one point where a face lies on a
            # triangle: a cube smaller than the grid's cells would tumble for ever. Its predecessor finds the corners.
            spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_NATIVECCD
        for i, geom in enumerate(self._geoms):
            field = self._fields.get(i)
            if field is None:
                spec.worldbody.add_geom(**geom)
                continue
            size, (rows, columns), heights = field
            name = f"heights{i}"
            spec.add_hfield(name=name, nrow=rows, ncol=columns, size=list(size), userdata=heights)
            spec.worldbody.add_geom(**{**geom, "size": [0.0, 0.0, 0.0]}, hfieldname=name)

    def free_fall(self, position: Vector) -> Vector:
        """Returns the acceleration of free fall at a place, m/s^2."""
        if not self.attracts:
            return self._gravity
        x, y, z = self.free_falls(np.array([position]))[0].tolist()
        return (x, y, z)

    def free_falls(self, places: Array) -> Array:
        """Returns the accelerations of free fall (n, 3) at places (n, 3), m/s^2."""
        if not self.attracts:
            return np.tile(np.array(self._gravity), (len(places), 1))
        away, distance = self._nearest(places)
        return np.asarray(away * (-self._strength / distance)[:, None])

    def pull(self, model: Any, data: Any) -> None:
        """Adds to the wrenches on all bodies their weights towards the planet nearest to each.

        Kinematics are computed first: after a step, or after a query, they belong to different moments.
        """
        mujoco.mj_kinematics(model, data)
        data.xfrc_applied[:, :3] += self.weights(model, data)

    def weights(self, model: Any, data: Any) -> Array:
        """Returns the forces (n, 3), N, that pull each body towards the planet nearest to it, from present poses."""
        away, distance = self._nearest(data.xipos)
        mass = np.where(model.body_treeid >= 0, model.body_mass, 0.0)
        return np.asarray((-self._strength * mass / distance)[:, None] * away)

    def _nearest(self, places: Array) -> tuple[Array, Array]:
        """Returns the ways (n, 3) to places (n, 3) from the centre of the planet nearest to each, and how long."""
        away = places.T[:, :, None] - self._centres.T[:, None, :]
        x, y, z = away
        distance = np.sqrt(x * x + y * y + z * z)  # by rows of three, sums take ten times as long
        rows = np.arange(len(places))
        nearest = distance.argmin(axis=1)
        return away[:, rows, nearest].T, np.maximum(distance[rows, nearest], 1e-9)


def _ground(scene: SceneSpec) -> list[Part]:
    ground = []
    if scene.ground:
        plane = mujoco.mjtGeom.mjGEOM_PLANE
        ground.append(Part(plane, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), _FACE_UP, _GREY))
    if scene.heightfield is not None:
        ground.append(_landscape(scene.heightfield))
    return ground


def _landscape(field: Heightfield) -> Part:
    # Turned upright, MuJoCo's rows run against our z. It takes heights from 0 to 1 and stretches them.
    heights = _refined(_refined(field.heights, field.size[1]).T, field.size[0]).T[::-1]
    # Of 0.0 and -0.0 it depends on the processor which one is found: plus zero, both are 0.0.
    low, high = float(heights.min()) + 0.0, float(heights.max())
    rise = max(high - low, 1e-6)  # a level one must have some thickness, too
    size = (field.size[0] / 2.0, field.size[1] / 2.0, rise, _BASE)
    return Part(mujoco.mjtGeom.mjGEOM_HFIELD, size, (0.0, low, 0.0), _FACE_UP, _GREEN, (heights - low) / rise)


def _refined(heights: Array, extent: float) -> Array:
    """Returns more rows, on straight lines between the given ones, where these are far apart."""
    rows = len(heights)
    parts = min(ceil(extent / (rows - 1) / _CELL), _ROWS // rows)
    if parts < 2:
        return heights
    places = np.arange((rows - 1) * parts + 1) / parts
    before = np.minimum(places.astype(int), rows - 2)
    share = (places - before)[:, None]
    return np.asarray(heights[before] * (1.0 - share) + heights[before + 1] * share)


def _obstacles(scene: SceneSpec) -> list[Part]:
    ball = mujoco.mjtGeom.mjGEOM_SPHERE
    return [_obstacle(box) for box in scene.boxes] + [
        Part(ball, (planet.radius, 0.0, 0.0), planet.position, _UPRIGHT, _GREEN) for planet in scene.planets
    ]


def _obstacle(box: StaticBox) -> Part:
    kind, size, turn = _geometry(box.shape, box.size)
    quaternion = box.quaternion if turn == _UPRIGHT else multiply(box.quaternion, turn)
    return Part(kind, size, box.position, quaternion, _GREY)


def solid(shape: Shape, size: Vector) -> dict[str, Any]:
    """Returns the fields of a geom of a shape, in the box of full edge lengths `size` (m) that it just fills."""
    kind, sizes, turn = _geometry(shape, size)
    fields: dict[str, Any] = {"type": kind, "size": list(sizes)}
    return fields if turn == _UPRIGHT else {**fields, "quat": [turn[3], *turn[:3]]}


def _geometry(shape: Shape, size: Vector) -> tuple[Any, Vector, Quaternion]:
    """Returns MuJoCo's type of a shape, its sizes, and how the shape is turned: MuJoCo's own lie along z."""
    if shape == "box":
        return mujoco.mjtGeom.mjGEOM_BOX, (size[0] / 2.0, size[1] / 2.0, size[2] / 2.0), _UPRIGHT
    lies = axis(size)
    radius, half = size[lies - 1] / 2.0, size[lies] / 2.0
    if shape == "sphere":
        return mujoco.mjtGeom.mjGEOM_SPHERE, (radius, 0.0, 0.0), _UPRIGHT
    if shape == "cylinder":
        return mujoco.mjtGeom.mjGEOM_CYLINDER, (radius, half, 0.0), lying(size)
    return mujoco.mjtGeom.mjGEOM_CAPSULE, (radius, half - radius, 0.0), lying(size)


# -- settings ---------------------------------------------------------------------------------------------------------


def set_options(option: Any, settings: Mapping[str, Any]) -> None:
    """Sets a model's options as the world config's `engine` object says; docs/engines.md lists what may be in it.

    Raises:
        WorldError: `invalid`, with the path of the value.
    """
    sleep = settings.get("sleep", True)
    for name, value in settings.items():
        if name == "solver":
            option.solver = _choice(name, value, _SOLVERS)
        elif name == "cone":
            option.cone = _choice(name, value, _CONES)
        elif name == "integrator":
            option.integrator = _choice(name, value, _INTEGRATORS)
            if value == "rk4" and sleep is True:
                raise _invalid("integrator", "rk4 cannot let bodies sleep: set sleep to false with it")
        elif name == "iterations":
            if type(value) is not int or not 1 <= value <= 10_000:
                raise _invalid(name, "expected a whole number from 1 to 10,000")
            option.iterations = value
        elif name == "tolerance":
            option.tolerance = _number(name, value, 0.0, 1.0)
        elif name == "impratio":
            option.impratio = _number(name, value, 0.01, 1000.0)
        elif name == "sleep":
            if type(value) is not bool:
                raise _invalid(name, "expected true or false")
            if not value:
                option.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
        else:
            known = "solver, iterations, tolerance, cone, impratio, integrator, sleep"
            raise _invalid(name, f"there is no such setting of mujoco; there are {known}")


def _choice(name: str, value: Any, choices: Mapping[str, Any]) -> Any:
    if not isinstance(value, str) or value not in choices:
        raise _invalid(name, f"expected one of {', '.join(choices)}")
    return choices[value]


def _number(name: str, value: Any, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise _invalid(name, f"expected a number from {low:g} to {high:g}")
    return float(value)


def _invalid(name: str, message: str) -> WorldError:
    return WorldError("invalid", f"engine/{name}: {message}", f"engine/{name}")
