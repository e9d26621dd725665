"""From a world config's `scene` to the primitives that engines are given, and nothing that moves.

It hides what an obstacle is made of, how a landscape is drawn from a seed or read from an image, and where planets
stand. Everything here follows from config and seed alone; terrain is drawn with sums and products only, and with a
generator whose numbers numpy promises to keep, so that no version of a library changes it. Files are read elsewhere:
an image is part of the config, so that a recording holds it.
"""

from __future__ import annotations

import base64
import binascii
import io
import struct
from collections.abc import Callable, Mapping
from functools import lru_cache
from hashlib import blake2b
from itertools import pairwise, product
from math import atan2, hypot, sqrt
from typing import Any

import numpy as np
from PIL import Image

from nmes.backend import Arena, Array, Heightfield, Medium, Planet, Quaternion, SceneSpec, StaticBox, Vector
from nmes.backend.rotation import normalize, quaternion_from_euler, rotate
from nmes.backend.shapes import ROUND, SHAPES, misfit
from nmes.errors import WorldError
from nmes.schemas.documents import JsonObject
from nmes.world.fields import vector
from nmes.world.groups import CollisionGroups

__all__ = ["medium_of", "needs", "planet_list", "scene_spec"]

_PLANK = 0.1  # m: thickness of a ramp
_PLAIN = 1000.0  # m: how far the ground reaches where it has gaps, and thus an end
_MOST_BOXES = 10_000  # of obstacles
_MOST_GAPS = 64  # what is left of the ground between them is cut along the edges of all
_OCTAVES = 8  # sizes of hills at most, each half the one before
_LARGEST_IMAGE = 1025  # pixels a side
_BIOMES = 5
_RESOURCES, _TREES = 20, 10  # places on a planet of the original


def needs(config: Mapping[str, Any]) -> dict[str, str]:
    """Returns the capabilities that an engine needs for the scene, each with the field of the config that asks."""
    scene = config["scene"]
    fields = {} if scene["type"] == "flat" else {f"scene.{scene['type']}": "scene/type"}
    if scene["obstacles"]:
        fields["scene.obstacles"] = "scene/obstacles"
        for i, obstacle in enumerate(scene["obstacles"]):
            if obstacle["type"] in ROUND:
                fields.setdefault(f"shape.{obstacle['type']}", f"scene/obstacles/{i}/type")
    if any(config.get("damping", {}).values()):
        fields["scene.damping"] = "damping"
    if "medium" in config:
        fields["medium"] = "medium"
    if config.get("collision_groups"):
        fields["collision_groups"] = "collision_groups"
    return fields


def scene_spec(config: Mapping[str, Any], seed: int) -> SceneSpec:
    """Returns the scene that an engine makes for a complete config; `seed` is the world's.

    Raises:
        WorldError: The scene contradicts itself; `path` names the field.
    """
    scene = config["scene"]
    kind = scene["type"]
    steps = sum(obstacle.get("steps", 1) for obstacle in scene["obstacles"])
    if steps > _MOST_BOXES:
        message = f"they are {steps:,} boxes, each step of stairs being one; at most {_MOST_BOXES:,}"
        raise WorldError("invalid", message, "scene/obstacles")
    for i, obstacle in enumerate(scene["obstacles"]):
        problem = misfit(obstacle["type"], _edges(obstacle)) if obstacle["type"] in ROUND else None
        if problem is not None:
            raise WorldError("invalid", problem, f"scene/obstacles/{i}/size")
    boxes = [box for obstacle in scene["obstacles"] for box in _OBSTACLES[obstacle["type"]](obstacle)]
    gaps = [(i, obstacle) for i, obstacle in enumerate(scene["obstacles"]) if obstacle["type"] == "gap"]
    if gaps and kind != "flat":
        raise WorldError("invalid", "only the flat ground can have gaps", f"scene/obstacles/{gaps[0][0]}/type")
    if len(gaps) > _MOST_GAPS:
        raise WorldError("invalid", f"there are {len(gaps):,} gaps, at most {_MOST_GAPS}", "scene/obstacles")
    arena, damping = scene.get("arena"), config.get("damping", {"linear": 0.0, "angular": 0.0})
    return SceneSpec(
        timestep=1.0 / (config["tick_rate"] * config["substeps"]),
        gravity=vector(config["gravity"]),
        max_bodies=config["limits"]["cubes"],
        ground=kind == "flat" and not gaps,
        boxes=(*boxes, *_ground_with_gaps([gap for _, gap in gaps])),
        heightfield=_landscape(scene["heightfield"], seed) if kind == "heightfield" else None,
        planets=tuple(planet for _, planet in _planets(scene["planets"])) if kind == "planets" else (),
        arena=None if arena is None else Arena(**{"seed": seed, **arena}),
        linear_damping=float(damping["linear"]),
        angular_damping=float(damping["angular"]),
        passes=CollisionGroups(config).passes,
        medium=medium_of(config),
        options=config["engine"],
    )


def medium_of(config: Mapping[str, Any]) -> Medium | None:
    """Returns the medium of a world, if it has one.

    Raises:
        WorldError: `invalid`: it cannot be there.
    """
    if "medium" not in config:
        return None
    medium, (across, _, along) = config["medium"], config["gravity"]
    if config["scene"]["type"] == "planets":
        raise WorldError("invalid", "a world of planets has no medium: there is no one way up in it", "medium")
    if "level" in medium and (across or along):
        raise WorldError("invalid", "a level needs gravity straight down, along y, or none", "medium/level")
    level = float(medium["level"]) if "level" in medium else None
    return Medium(float(medium["density"]), float(medium["viscosity"]), level)


# -- obstacles --------------------------------------------------------------------------------------------------------


def _edges(obstacle: JsonObject) -> Vector:
    size = obstacle["size"]
    return vector(size) if isinstance(size, list) else (float(size),) * 3


def _box(obstacle: JsonObject) -> list[StaticBox]:
    turn, kind = obstacle["rotation"], obstacle["type"]
    quaternion = quaternion_from_euler(*turn) if len(turn) == 3 else normalize((turn[0], turn[1], turn[2], turn[3]))
    return [StaticBox(_edges(obstacle), vector(obstacle["position"]), quaternion, kind)]


def _placed(obstacle: JsonObject, size: Vector, along: float, up: float, tilt: float = 0.0) -> StaticBox:
    """Returns a box whose middle is `along` the heading and `up` from the obstacle's position; `tilt` raises it."""
    turn: Quaternion = quaternion_from_euler(0.0, obstacle["heading"], tilt)
    x, y, z = rotate(quaternion_from_euler(0.0, obstacle["heading"], 0.0), (along, up, 0.0))
    at = obstacle["position"]
    return StaticBox(size, (at[0] + x, at[1] + y, at[2] + z), turn)


def _wall(obstacle: JsonObject) -> list[StaticBox]:
    height = obstacle["height"]
    return [_placed(obstacle, (obstacle["length"], height, obstacle["width"]), 0.0, height / 2.0)]


def _ramp(obstacle: JsonObject) -> list[StaticBox]:
    """A plank whose upper face runs from the line at its position up to the height."""
    length, height = obstacle["length"], obstacle["height"]
    slope = hypot(length, height)
    # Down from the middle of the upper face, at a right angle to it.
    along = length / 2.0 + _PLANK / 2.0 * height / slope
    up = height / 2.0 - _PLANK / 2.0 * length / slope
    return [_placed(obstacle, (slope, _PLANK, obstacle["width"]), along, up, atan2(height, length))]


def _stairs(obstacle: JsonObject) -> list[StaticBox]:
    depth, rise = obstacle["length"] / obstacle["steps"], obstacle["height"] / obstacle["steps"]
    return [
        _placed(obstacle, (depth, rise * step, obstacle["width"]), depth * (step - 0.5), rise * step / 2.0)
        for step in range(1, obstacle["steps"] + 1)
    ]


def _gap(obstacle: JsonObject) -> list[StaticBox]:
    return []  # what is left of the ground is made of all gaps together


_OBSTACLES: dict[str, Callable[[JsonObject], list[StaticBox]]] = {
    **dict.fromkeys(SHAPES, _box),
    "wall": _wall,
    "ramp": _ramp,
    "stairs": _stairs,
    "gap": _gap,
}


def _ground_with_gaps(gaps: list[JsonObject]) -> list[StaticBox]:
    """Returns the flat ground as boxes: its floor is as deep as the deepest of the gaps that cover a place."""
    if not gaps:
        return []
    spans = [
        [tuple(min(max(gap["position"][i] + end * gap[size], -_PLAIN), _PLAIN) for end in (-0.5, 0.5)) for gap in gaps]
        for i, size in ((0, "length"), (2, "width"))
    ]
    bottom = -max(gap["depth"] for gap in gaps) - 1.0
    xs, zs = (sorted({-_PLAIN, _PLAIN, *(edge for span in part for edge in span)}) for part in spans)
    boxes = []
    for x1, x2 in pairwise(xs):
        # Neighbours of the same depth become one box: the fewer seams, the better.
        strips: list[tuple[float, float, float]] = []
        for z1, z2 in pairwise(zs):
            over = [
                gap["depth"]
                for gap, across, along in zip(gaps, *spans, strict=True)
                if across[0] <= x1 and x2 <= across[1] and along[0] <= z1 and z2 <= along[1]
            ]
            depth = max(over, default=0.0)
            if strips and strips[-1][2] == depth:
                z1 = strips.pop()[0]
            strips.append((z1, z2, depth))
        for z1, z2, depth in strips:
            height = -depth - bottom
            middle = ((x1 + x2) / 2.0, bottom + height / 2.0, (z1 + z2) / 2.0)
            boxes.append(StaticBox((x2 - x1, height, z2 - z1), middle))
    return boxes


# -- landscapes -------------------------------------------------------------------------------------------------------


def _landscape(field: JsonObject, seed: int) -> Heightfield:
    size = (float(field["size"][0]), float(field["size"][1]))
    if "image" in field and "heights" in field:
        raise WorldError("invalid", "give an image or heights, not both", "scene/heightfield/image")
    if "image" in field:
        return Heightfield(size, _read_image(field["image"]) * float(field["height"]))
    if "heights" in field:
        rows = field["heights"]
        for i, row in enumerate(rows):
            if len(row) != len(rows[0]):
                message = f"expected {len(rows[0])} numbers as in the first row, got {len(row)}"
                raise WorldError("invalid", message, f"scene/heightfield/heights/{i}")
        return Heightfield(size, np.array(rows, float))
    return Heightfield(size, _draw_hills(field, size, field.get("seed", seed)))


def _draw_hills(field: JsonObject, size: tuple[float, float], seed: int) -> Array:
    """Draws hills of sizes from `hill` down to the grid's own, the smaller the lower, and levels the clearing."""
    # RandomState is the one generator of which numpy promises the same numbers for ever.
    draw = np.random.RandomState(np.random.MT19937(np.random.SeedSequence(seed)))
    columns, rows = (int(count) for count in field["samples"])
    x, z = np.linspace(-size[0] / 2.0, size[0] / 2.0, columns), np.linspace(-size[1] / 2.0, size[1] / 2.0, rows)
    finest = min(x[1] - x[0], z[1] - z[0])
    heights = np.zeros((rows, columns))
    extent, weight = float(field["hill"]), 1.0
    for octave in range(_OCTAVES):
        if octave and extent < 2.0 * finest:
            break
        heights += weight * _smooth_noise(draw, x, z, extent)
        extent, weight = extent / 2.0, weight * field["roughness"]
    low, high = heights.min(), heights.max()
    heights = (heights - low) * (field["height"] / (high - low)) if high > low else heights - low
    heights -= heights[rows // 2, columns // 2]
    if field["clearing"] > 0.0:
        far = np.clip((np.sqrt(z[:, None] ** 2 + x[None, :] ** 2) - field["clearing"]) / field["clearing"], 0.0, 1.0)
        heights = heights * _ease(far)
    return np.asarray(heights, np.float64)


def _smooth_noise(draw: np.random.RandomState, x: Array, z: Array, extent: float) -> Array:
    """Returns random heights from 0 to 1 at the knots of a grid with this spacing, and what lies between them."""
    at_x, at_z = ((line - line[0]) / max(extent, line[1] - line[0]) for line in (x, z))
    knots = draw.random_sample((int(at_z[-1]) + 2, int(at_x[-1]) + 2))
    i, k = at_z.astype(int), at_x.astype(int)
    part_z, part_x = _ease(at_z - i)[:, None], _ease(at_x - k)[None, :]
    near = knots[np.ix_(i, k)] * (1.0 - part_x) + knots[np.ix_(i, k + 1)] * part_x
    far = knots[np.ix_(i + 1, k)] * (1.0 - part_x) + knots[np.ix_(i + 1, k + 1)] * part_x
    between: Array = near * (1.0 - part_z) + far * part_z
    return between


def _ease(part: Array) -> Array:
    """Leads from 0 to 1 with no kink at either end."""
    return part * part * (3.0 - 2.0 * part)


def _read_image(text: str) -> Array:
    """Returns a PNG's pixels from 0 (black) to 1 (white)."""
    path = "scene/heightfield/image"
    try:
        data = base64.b64decode(text, validate=True)
    except binascii.Error as error:
        raise WorldError("invalid", f"the image is not base64: {error}", path) from error
    # The header first: a small file may claim to be of any size.
    if len(data) < 24 or not data.startswith(b"\x89PNG\r\n\x1a\n") or data[12:16] != b"IHDR":
        raise WorldError("invalid", "the image is no PNG", path)
    width, height = struct.unpack(">II", data[16:24])
    if not (2 <= width <= _LARGEST_IMAGE and 2 <= height <= _LARGEST_IMAGE):
        raise WorldError("invalid", f"the image is {width} x {height}, not 2 to {_LARGEST_IMAGE} pixels a side", path)
    try:
        with Image.open(io.BytesIO(data), formats=["PNG"]) as image:
            grey = image if image.mode.startswith("I") else image.convert("L")
            return np.asarray(grey, float) / (65535.0 if image.mode.startswith("I") else 255.0)
    except (OSError, SyntaxError, ValueError) as error:
        raise WorldError("invalid", f"the image cannot be read: {error}", path) from error


# -- planets ----------------------------------------------------------------------------------------------------------


def _planets(config: JsonObject) -> list[tuple[str, Planet]]:
    """Returns the planets with their names, the first one at the origin or under it.

    Raises:
        WorldError: They would overlap.
    """
    radius, spacing = float(config["radius"]), float(config["spacing"])
    if spacing < 2.0 * radius:
        message = f"planets of radius {radius:g} m need a spacing of twice that"
        raise WorldError("invalid", message, "scene/planets/spacing")
    side = 1
    while side**3 < config["count"]:
        side += 1
    if config.get("layout") == "corner":
        cells = list(product(range(side), repeat=3))[: config["count"]]
        return [
            (str(cell), Planet((cell[0] * spacing, cell[1] * spacing, cell[2] * spacing), radius)) for cell in cells
        ]
    line = [i - (side - 1) // 2 for i in range(side)]
    cells = sorted(product(line, repeat=3), key=lambda cell: (sum(i * i for i in cell), cell))
    return [
        (f"Planet_{number}", Planet((x * spacing, y * spacing - radius, z * spacing), radius))
        for number, (x, y, z) in enumerate(cells[: config["count"]])
    ]


def planet_list(config: Mapping[str, Any], seed: int) -> list[JsonObject]:
    """Returns the planets of a complete config as `get_planets` tells them, to be read only; `seed` is the world's."""
    scene = config["scene"]
    return _draw_planets(seed, tuple(scene["planets"].items())) if scene["type"] == "planets" else []


@lru_cache(maxsize=16)
def _draw_planets(seed: int, fields: tuple[tuple[str, Any], ...]) -> list[JsonObject]:
    """Returns planets as `get_planets` tells them; in the layout `corner` with signed seeds and locations."""
    config = dict(fields)
    seed, original = config.get("seed", seed), config.get("layout") == "corner"
    planets = []
    for number, (name, planet) in enumerate(_planets(config)):
        digest = blake2b(f"{seed} planet {number}".encode(), digest_size=8).digest()
        drawn = int.from_bytes(digest[:4], "little", signed=original)
        places = _draw_places(int.from_bytes(digest, "little"), _RESOURCES + _TREES) if original else []
        planets.append(
            {
                "Name": name,
                "Position": _place(planet.position),
                "Seed": drawn if original else drawn >> 1,
                "BiomeType": digest[4] % _BIOMES,
                "ResourceLocations": places[:_RESOURCES],
                "TreeLocations": places[_RESOURCES:],
            }
        )
    return planets


def _draw_places(seed: int, count: int) -> list[JsonObject]:
    """Returns places on a planet of diameter 1, from its centre, each direction as likely as any other."""
    draw = np.random.RandomState(np.random.MT19937(np.random.SeedSequence(seed)))
    places: list[JsonObject] = []
    while len(places) < count:
        for x, y, z in (2.0 * draw.random_sample((count, 3)) - 1.0).tolist():
            distance = sqrt(x * x + y * y + z * z)
            if 0.1 < distance <= 1.0:  # of the cube's points those in a ball
                places.append(_place((x * 0.5 / distance, y * 0.5 / distance, z * 0.5 / distance)))
    return places[:count]


def _place(position: Vector) -> JsonObject:
    x, y, z = position
    return {"x": x, "y": y, "z": z}
