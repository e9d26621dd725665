"""The static surroundings of a Chipmunk space: the ground, the slice of obstacles and landscapes at z = 0."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pymunk

from nmes.backend import SceneSpec
from nmes.backends.pymunk2d.joints import Point

__all__ = ["add_scenery"]

_GROUND = 1e6, 1000.0  # m: half the ground's length, and how deep a body may be in it and still be pushed up


def add_scenery(space: pymunk.Space, scene: SceneSpec) -> None:
    """Adds a scene's ground, landscape and obstacles."""
    if scene.ground:
        half, depth = _GROUND
        _add_shapes(space, [pymunk.Segment(space.static_body, (-half, -depth), (half, -depth), depth)])
    if scene.heightfield is not None:
        _add_shapes(space, _landscape(space, scene.heightfield.profile()))
    corners = [box.section() for box in scene.boxes]
    _add_shapes(space, [pymunk.Poly(space.static_body, section) for section in corners if section])


def _add_shapes(space: pymunk.Space, shapes: Sequence[pymunk.Shape]) -> None:
    for shape in shapes:
        # Chipmunk multiplies the values of the two surfaces: with 1 here, the body's own count.
        shape.friction = shape.elasticity = 1.0
        space.add(shape)


def _landscape(space: pymunk.Space, points: Sequence[Point]) -> list[pymunk.Segment]:
    """Returns thick segments whose upper sides are the line through the points."""
    line = np.array(points)
    ways = np.diff(line, axis=0)
    up = np.column_stack([-ways[:, 1], ways[:, 0]]) / np.sqrt((ways * ways).sum(axis=1))[:, None]
    before, after = np.vstack([up[:1], up]), np.vstack([up, up[-1:]])
    radius = float(ways[:, 0].min()) / 4
    middles = line - radius * (before + after) / (1.0 + np.sum(before * after, axis=1))[:, None]
    ends = [(float(x), float(y)) for x, y in middles]
    segments = [pymunk.Segment(space.static_body, a, b, radius) for a, b in itertools.pairwise(ends)]
    for i, segment in enumerate(segments):  # so that boxes do not catch on the seams
        segment.set_neighbors(ends[max(i - 1, 0)], ends[min(i + 2, len(ends) - 1)])
    return segments
