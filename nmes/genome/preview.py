"""Pictures of bodies at rest, drawn in software: the same pixels on every machine, without a GPU or a window.

Hides an orthographic ray caster over boxes and round shapes: one view from the front right and above (+x, forward, is
to the right), one lamp, a shadow on the ground, thin lines along edges, and a grid on the ground whose lines are a
round number of metres apart. Parts may pass through each other, which drawing them one over the other could not show.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, cos, floor, log10, radians, sin, sqrt

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from nmes.backend import Array
from nmes.backend import Image as Pixels
from nmes.backend.rotation import rotate
from nmes.backend.shapes import axis as axis_of
from nmes.genome.body import PALETTE, Body, BodyCube, corners

__all__ = ["grid_step", "render_body", "render_cutout", "render_text", "sheet"]

_YAW, _PITCH = radians(32.0), radians(24.0)
_BACK = np.array([sin(_YAW) * cos(_PITCH), sin(_PITCH), cos(_YAW) * cos(_PITCH)])  # towards the eye
_RIGHT = np.array([cos(_YAW), 0.0, -sin(_YAW)])
_UP = np.cross(_BACK, _RIGHT)
_LAMP = np.array([0.35, 1.0, 0.55]) / sqrt(0.35**2 + 1.0 + 0.55**2)
_SKY, _GROUND, _GRID, _SHADE = (
    np.array(c, float) for c in ((246, 247, 249), (232, 233, 236), (208, 211, 217), (150, 154, 163))
)
_FAINT = 0.4  # of the colour of parts that are not there at birth, the rest is white
_MARGIN = 0.08  # of the picture, free on each side
_FINE = 2  # rays a pixel, in each direction
_RAMP = " .:-=+*#%@"


def render_body(body: Body, width: int = 720, height: int = 540) -> Pixels:
    """Returns a picture of a body, shape (height, width, 3), rows from the top.

    Args:
        body: The body.
        width: Pixels.
        height: Pixels.
    """
    fine = _Canvas(body, width * _FINE, height * _FINE).draw(lines=True)
    return np.asarray(fine.reshape(height, _FINE, width, _FINE, 3).mean(axis=(1, 3)).round().astype(np.uint8))


def render_cutout(body: Body, width: int, height: int) -> Pixels:
    """Returns a picture of a body alone, to be laid over any colour, shape (height, width, 4): red, green, blue, alpha.

    Args:
        body: The body.
        width: Pixels.
        height: Pixels.
    """
    canvas = _Canvas(body, width * _FINE, height * _FINE, shadow=False)
    seen, fine = canvas.alone()
    parts = np.concatenate([fine * seen[..., None], 255.0 * seen[..., None]], axis=2)
    mean = parts.reshape(height, _FINE, width, _FINE, 4).mean(axis=(1, 3))
    mean[..., :3] *= 255.0 / np.maximum(mean[..., 3:], 1.0)
    return np.asarray(mean.round().clip(0.0, 255.0).astype(np.uint8))


def sheet(bodies: Sequence[tuple[str, Body]], width: int = 320, height: int = 260) -> Pixels:
    """Returns one picture of many bodies side by side, each over its title.

    Args:
        bodies: Titles and bodies.
        width: Of each, pixels.
        height: Of each without its title, pixels.
    """
    columns = min(len(bodies), max(1, ceil(sqrt(len(bodies) * height / width))))
    title, gap = 24, 6
    rows = ceil(len(bodies) / columns)
    whole = Image.new("RGB", (columns * (width + gap) + gap, rows * (height + title + gap) + gap), (255, 255, 255))
    pen, font = ImageDraw.Draw(whole), ImageFont.load_default(14)
    for index, (name, body) in enumerate(bodies):
        x, y = gap + index % columns * (width + gap), gap + index // columns * (height + title + gap)
        whole.paste(Image.fromarray(render_body(body, width, height)), (x, y))
        while name and pen.textlength(name, font=font) > width:
            name = name[:-1]
        pen.text((x + width / 2, y + height + title / 2), name, fill=(40, 42, 48), font=font, anchor="mm")
    return np.asarray(whole)


def render_text(body: Body, columns: int = 72, rows: int = 22) -> list[str]:
    """Returns a picture of a body made of characters: the darker the fuller, `rows` lines of at most `columns`."""
    # A character is twice as high as it is wide.
    canvas = _Canvas(body, columns * 2, rows * 4)
    bright = canvas.draw(lines=False).mean(axis=2)
    solid = canvas.seen >= 0
    lines = []
    for row in range(rows):
        line = ""
        for column in range(columns):
            block = np.s_[4 * row : 4 * row + 4, 2 * column : 2 * column + 2]
            if solid[block].sum() * 2 < solid[block].size:
                line += " "
            else:
                dark = 1.0 - bright[block][solid[block]].mean() / 255.0
                line += _RAMP[min(len(_RAMP) - 1, max(2, int(dark * len(_RAMP) * 1.2)))]
        lines.append(line.rstrip())
    return lines


def grid_step(body: Body) -> float:
    """Returns the distance between the lines on the ground, m: 1, 2 or 5 times a power of ten."""
    low, high = body.bounds
    target = max(high[0] - low[0], high[2] - low[2], high[1] - low[1]) / 4.0
    power = 10.0 ** floor(log10(target))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= target * (1.0 + 1e-9)))


class _Canvas:
    """One picture in the making; `seen` is the face (6 * cube + face) at each pixel, or -1."""

    def __init__(self, body: Body, width: int, height: int, shadow: bool = True) -> None:
        self._width, self._height, self._body = width, height, body
        points = np.concatenate([corners(cube) for cube in body.cubes])
        if shadow:
            points = np.concatenate([points, _on_ground(points)])
        across, upward = points @ _RIGHT, points @ _UP
        room = 1.0 - 2.0 * _MARGIN
        span = max(float(np.ptp(across)) / (width * room), float(np.ptp(upward)) / (height * room))
        self._pixel = span  # m
        self._left = float(across.max() + across.min()) / 2.0 - span * width / 2.0
        self._top = float(upward.max() + upward.min()) / 2.0 + span * height / 2.0
        self.seen = np.full((height, width), -1)
        self._depth = np.full((height, width), np.inf)

    def draw(self, lines: bool) -> Array:
        """Returns the pixels as floats, shape (height, width, 3)."""
        image = self._ground()
        for number, cube in enumerate(self._body.cubes):
            self._cast(image, number, cube)
        if lines:
            self._outline(image)
        return image

    def alone(self) -> tuple[Array, Array]:
        """Returns where the body is, booleans of shape (height, width), and its pixels as `draw` does."""
        image = np.zeros((self._height, self._width, 3))
        for number, cube in enumerate(self._body.cubes):
            self._cast(image, number, cube)
        self._outline(image)
        return np.asarray(self.seen >= 0), np.asarray(image)

    def _origins(self, area: tuple[slice, slice]) -> Array:
        """Returns the points where the rays of an area begin, shape (h, w, 3)."""
        rows, columns = area
        upward = self._top - (np.arange(rows.start, rows.stop) + 0.5) * self._pixel
        across = self._left + (np.arange(columns.start, columns.stop) + 0.5) * self._pixel
        return np.asarray(upward[:, None, None] * _UP + across[None, :, None] * _RIGHT)

    def _area(self, points: Array) -> tuple[slice, slice]:
        """Returns the part of the picture in which points lie."""
        across, upward = points @ _RIGHT, points @ _UP
        left, right = (float(across.min()) - self._left) / self._pixel, (float(across.max()) - self._left) / self._pixel
        top, bottom = (self._top - float(upward.max())) / self._pixel, (self._top - float(upward.min())) / self._pixel
        return (
            slice(max(0, floor(top) - 1), min(self._height, ceil(bottom) + 1)),
            slice(max(0, floor(left) - 1), min(self._width, ceil(right) + 1)),
        )

    def _ground(self) -> Array:
        """Paints the ground with its grid and the shadows on it."""
        whole = (slice(0, self._height), slice(0, self._width))
        places = self._landing(whole)
        step = grid_step(self._body)
        image = np.broadcast_to(_GROUND, places.shape).copy()
        for axis in (0, 2):
            along = places[..., axis] / step
            image[abs(along - np.round(along)) * step < 0.7 * self._pixel] = _GRID
        shaded = np.zeros(image.shape[:2], bool)
        for cube in self._body.cubes:
            area = self._area(_on_ground(corners(cube)))
            if area[0].stop > area[0].start and area[1].stop > area[1].start:
                near, far, *_ = _meet(cube, self._landing(area), _LAMP)
                shaded[area] |= (near <= far) & (far > 0.0)
        image[shaded] = 0.45 * image[shaded] + 0.55 * _SHADE
        fade = np.linspace(0.55, 0.0, self._height)[:, None, None]
        return np.asarray(image * (1.0 - fade) + _SKY * fade)

    def _landing(self, area: tuple[slice, slice]) -> Array:
        origins = self._origins(area)
        return np.asarray(origins - (origins[..., 1] / _BACK[1])[..., None] * _BACK)

    def _cast(self, image: Array, number: int, cube: BodyCube) -> None:
        """Paints a cube where nothing is in front of it."""
        area = self._area(corners(cube))
        near, far, face, lit = _meet(cube, self._origins(area), -_BACK)
        visible = (near <= far) & (near < self._depth[area])
        self._depth[area][visible] = near[visible]
        self.seen[area][visible] = 6 * number + face[visible]
        base = 255.0 * np.array(cube.color[:3] if cube.color is not None else PALETTE[number % len(PALETTE)])
        if cube.id in self._body.later:
            base = _FAINT * base + (1.0 - _FAINT) * 255.0
        image[area][visible] = base * lit[visible][:, None]

    def _outline(self, image: Array) -> None:
        """Draws lines where one face ends and another begins."""
        edge = np.zeros(self.seen.shape, bool)
        edge[:, 1:] |= self.seen[:, 1:] != self.seen[:, :-1]
        edge[1:] |= self.seen[1:] != self.seen[:-1]
        image[edge] *= 0.45


def _normals(cube: BodyCube) -> Array:
    """Returns the directions of the six faces: -x, +x, -y, +y, -z, +z."""
    axes = [rotate(cube.quaternion, unit) for unit in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))]
    return np.array([[sign * part for part in axis] for axis in axes for sign in (-1.0, 1.0)])


def _meet(cube: BodyCube, origins: Array, direction: Array) -> tuple[Array, Array, Array, Array]:
    """Returns where rays meet a cube.

    Returns:
        The distances at which they enter and leave it (a miss leaves first), the faces by which they enter, and how
        light it is there, from 0 to 1.
    """
    axes = _normals(cube)[1::2]
    start = (origins - np.array(cube.position)) @ axes.T
    slope = axes @ direction
    slope = np.where(abs(slope) < 1e-9, 1e-9, slope)
    if cube.shape != "box":
        near, far, face, normals = _meet_round(cube, start, slope)
        return near, far, face, 0.42 + 0.58 * np.maximum(normals @ (axes @ _LAMP), 0.0)
    shades = np.array([0.42 + 0.58 * max(0.0, float(normal @ _LAMP)) for normal in _normals(cube)])
    half = np.array(cube.size) / 2.0
    first, second = (-half - start) / slope, (half - start) / slope
    entries = np.minimum(first, second)
    axis = entries.argmax(axis=-1)
    face = 2 * axis + (slope < 0.0)[axis]
    return entries.max(axis=-1), np.maximum(first, second).min(axis=-1), face, shades[face]


def _meet_round(cube: BodyCube, start: Array, slope: Array) -> tuple[Array, Array, Array, Array]:
    """Returns the depths, face and normals at which rays meet a round shape; see `_meet`.

    Args:
        cube: Of a round shape.
        start: Where the rays begin, along its own axes, shape (h, w, 3).
        slope: Their direction there.
    """
    lies = axis_of(cube.size)
    radius, half = cube.size[lies - 1] / 2.0, cube.size[lies] / 2.0
    if cube.shape != "cylinder":
        half -= radius
    across = np.array([float(i != lies) for i in range(3)])
    near, far = _cut(start * across, slope * across, radius)  # a cylinder without ends
    first, second = ((end - start[..., lies]) / slope[lies] for end in (-half, half))
    enter, leave = np.minimum(first, second), np.maximum(first, second)
    capped, face = enter > near, np.zeros(near.shape, int)
    near, far = np.maximum(near, enter), np.minimum(far, leave)
    if cube.shape == "cylinder":
        face[capped] = 1
        normals = (start + np.where(near <= far, near, 0.0)[..., None] * slope) * across / radius
        normals[capped] = -np.sign(slope) * (1.0 - across)
        return near, far, face, normals
    near = np.where(near <= far, near, np.inf)
    far = np.where(near <= far, far, -np.inf)
    for end in (-half, half):
        ball = start - end * (1.0 - across)
        into, out = _cut(ball, slope, radius)
        near = np.where(into <= out, np.minimum(near, into), near)
        far = np.where(into <= out, np.maximum(far, out), far)
    points = start + np.where(np.isfinite(near), near, 0.0)[..., None] * slope
    middle = np.clip(points[..., lies], -half, half)[..., None] * (1.0 - across)
    return near, far, face, (points - middle) / radius


def _cut(start: Array, slope: Array, radius: float) -> tuple[Array, Array]:
    """Returns the depths at which lines enter and leave a ball about the origin, or a cylinder without its axis."""
    a, b = float((slope * slope).sum()), (start * slope).sum(axis=-1)
    square = b * b - a * ((start * start).sum(axis=-1) - radius * radius)
    root = np.sqrt(np.maximum(square, 0.0))
    return np.where(square < 0.0, np.inf, (-b - root) / a), np.where(square < 0.0, -np.inf, (root - b) / a)


def _on_ground(points: Array) -> Array:
    """Returns the shadows of points on the ground, shape (n, 3)."""
    return np.asarray(points - (points[:, 1] / _LAMP[1])[:, None] * _LAMP)
