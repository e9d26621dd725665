"""How the shapes of parts are changed: one part becomes a ball, a capsule, a cylinder or a box, about as large."""

from __future__ import annotations

from collections.abc import Sequence

from nmes.backend import Vector
from nmes.backend.shapes import Shape, fitted, volume
from nmes.schemas.documents import JsonObject
from nmes.variation.draw import Draw

__all__ = ["change_shape", "fit"]

_DIGITS = 6


def change_shape(body: JsonObject, draw: Draw, shapes: Sequence[Shape]) -> bool:
    """Gives a part of a body, a cube or a part of its graph, another shape; returns whether there is one.

    Args:
        body: As a document; it is changed, and may then reach below the ground.
        draw: The choices.
        shapes: Those that it may have besides a box.
    """
    graph = body.get("graph")
    part = draw.one_of(body["cubes"] if graph is None else graph["parts"])
    present: Shape = part.get("shape", "box")
    others: list[Shape] = [shape for shape in ("box", *shapes) if shape != present]
    if not others:
        return False
    shape = draw.one_of(others)
    old = part["size"] if isinstance(part["size"], list) else [part["size"]] * 3
    new = fit(shape, old)
    if graph is None:
        ratio = volume(shape, _vector(new)) / volume(present, _vector(old))
        part["mass"] = round(max(part["mass"] * ratio, 0.001), _DIGITS)
    part["size"] = new
    if shape == "box":
        del part["shape"]
    else:
        part["shape"] = shape
    return True


def fit(shape: Shape, size: Sequence[float]) -> list[float]:
    """Returns the edges nearest to some, m, that a shape may have, rounded as documents have them."""
    return [round(edge, _DIGITS) for edge in fitted(shape, _vector(size))]


def _vector(size: Sequence[float]) -> Vector:
    x, y, z = size
    return float(x), float(y), float(z)
