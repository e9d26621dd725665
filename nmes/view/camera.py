"""The cameras of films: where each moment is seen from.

It hides what is worth looking at, and how a camera follows it without shaking.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import product
from math import hypot, pi, radians, sqrt
from typing import Literal

import numpy as np

from nmes.backend import Array, CameraSpec, Vector
from nmes.errors import FilmError
from nmes.view.moments import Moment

__all__ = ["Way", "cameras"]

Way = Literal["follow", "orbit", "fixed"]

_FOV = radians(40.0)
_ELEVATION, _AZIMUTH = radians(20.0), radians(30.0)  # of the camera; a planar world is looked at from its front
_FRONT = radians(4.0)
_CALM = 0.4  # s before and after a moment, over which a camera that follows smooths what it follows
_ROUND = 24.0  # s that an orbit takes
_NEAREST = 1.0  # m: the smallest radius that is looked at
_MOVES, _BESIDE = 0.02, 1.5  # m: how far a cube gets that moves; how near to it a neighbour is
_CELL = 2.0  # m: edges of cells in which neighbours are looked for; longer than neighbours are apart
_BEHIND = 3.0  # m: how far what came to rest is left behind before it is looked at no more
_NEAR = 6.0  # m: how near a creature's target is to what is looked at, to be looked at too
_MARK = 0.6  # m: how much room its flag takes
_FLAT = 1e-9  # m, and parts of a quaternion: a world in which nothing leaves the plane by more is planar


def cameras(
    moments: Sequence[Moment], way: Way, target: str | None, fps: float, size: tuple[int, int]
) -> list[CameraSpec]:
    """Returns the camera for each moment.

    Args:
        moments: The moments that are shown, at least one.
        way: How the camera moves.
        target: The cube to look at, or the beginning of the names of several; None for those that move.
        fps: How many moments are shown in a second.
        size: Width and height of the picture, pixels.

    Raises:
        FilmError: `cube_not_found`: no cube's name begins with `target`.
    """
    planar = all(np.abs(moment.poses[:, (2, 3, 4)]).max(initial=0.0) < _FLAT for moment in moments)
    names = _looked_at(moments, target)
    middles, radii = _middles(moments, names, flags=target is None)
    if way == "fixed":
        low, high = middles.min(axis=0), middles.max(axis=0)
        radii[:] = np.linalg.norm(high - low) / 2.0 + radii.max()
        middles[:] = (low + high) / 2.0
    else:
        middles, radii = _smooth(middles, fps), _smooth(radii[:, None], fps)[:, 0]
    elevation, azimuth = (_FRONT, 0.0) if planar else (_ELEVATION, _AZIMUTH)
    specs = []
    for i, (middle, radius) in enumerate(zip(middles.tolist(), radii.tolist(), strict=True)):
        turn = azimuth + (2.0 * pi * i / (_ROUND * fps) if way == "orbit" else 0.0)
        around = (middle[0], middle[1], middle[2]), max(radius, _NEAREST)
        specs.append(CameraSpec.looking_at(*around, size, fov=_FOV, elevation=elevation, turn=turn, shadows=True))
    return specs


def _smooth(values: Array, fps: float) -> Array:
    """Returns the running mean of an array (n, k) over the time before and after, without lag."""
    reach = round(_CALM * fps)
    padded = np.pad(values, ((reach, reach), (0, 0)), mode="edge")
    smooth: Array = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=0).mean(axis=-1)
    return smooth


def _looked_at(moments: Sequence[Moment], target: str | None) -> set[str]:
    """Returns the names of the cubes to look at: the target's, else those that move and their neighbours, else all.

    What comes later beside any of them is looked at too: parts that grow.
    """
    if target is not None:
        names = {name for moment in moments for name in moment.shapes if name.startswith(target)}
        if not names:
            present = ", ".join(list(moments[-1].shapes)[:8]) or "none"
            raise FilmError("cube_not_found", f"no cube's name begins with {target!r} (there are: {present})")
        return names
    first: dict[str, Array] = {}
    moved: dict[str, None] = {}
    for moment in moments:
        for name, pose in zip(moment.shapes, moment.poses, strict=True):
            if np.abs(pose[:3] - first.setdefault(name, pose[:3])).max() > _MOVES:
                moved[name] = None
    spots = _Spots(first[name] for name in moved)
    beside = {name for name, at in first.items() if spots.beside(at)}
    for name in beside - moved.keys():
        spots.add(first[name])
    for name in [name for name in first if name not in moments[0].shapes]:
        if name not in beside and spots.beside(first[name]):
            beside.add(name)
            spots.add(first[name])
    return beside or set(first)


class _Spots:
    """Places by cells of space: what is beside one is found without a look at all, of which there may be thousands."""

    def __init__(self, places: Iterable[Array]) -> None:
        self._cells: dict[Vector, list[Vector]] = {}
        for place in places:
            self.add(place)

    def add(self, place: Array) -> None:
        x, y, z = place.tolist()
        self._cells.setdefault((x // _CELL, y // _CELL, z // _CELL), []).append((x, y, z))

    def beside(self, place: Array) -> bool:
        """Whether one of the places is beside another place."""
        x, y, z = place.tolist()
        around = ((at // _CELL - 1.0, at // _CELL, at // _CELL + 1.0) for at in (x, y, z))
        return any(
            sqrt((a - x) * (a - x) + (b - y) * (b - y) + (c - z) * (c - z)) < _BESIDE
            for cell in product(*around)
            for a, b, c in self._cells.get(cell, ())
        )


def _near(place: Array, others: Array) -> bool:
    return bool(np.linalg.norm(others - place, axis=1).min(initial=np.inf) < _BEHIND)


def _rests(moments: Sequence[Moment], names: set[str]) -> dict[str, int]:
    """Returns from which moment on each cube moves no more."""
    ends: dict[str, Array] = {}
    rests: dict[str, int] = {}
    for i in range(len(moments) - 1, -1, -1):
        for name, pose in zip(moments[i].shapes, moments[i].poses, strict=True):
            if name in names and name not in rests:
                if np.abs(pose[:3] - ends.setdefault(name, pose[:3])).max() > _MOVES:
                    rests[name] = i + 1
    return rests


def _middles(moments: Sequence[Moment], names: set[str], *, flags: bool) -> tuple[Array, Array]:
    """Returns the middle of some cubes at each moment, and how far they reach from there, m.

    With `flags`, the targets of creatures that are near belong to them. What came to rest for good, as a limb that was
    lost, is left behind by what moves. Where no cube is there, they are as at the moment before.
    """
    rests = _rests(moments, names)
    middles, radii = np.zeros((len(moments), 3)), np.full(len(moments), _NEAREST)
    last = -1
    for i, moment in enumerate(moments):
        shown = {row: name for row, name in enumerate(moment.shapes) if name in names}
        going = moment.poses[[row for row, name in shown.items() if rests.get(name, 0) > i], :3]
        rows = [
            row
            for row, name in shown.items()
            if not (0 < rests.get(name, 0) <= i and len(going)) or _near(moment.poses[row, :3], going)
        ]
        if rows:
            places, sizes = moment.poses[rows, :3], [size for size, *_ in moment.shapes.values()]
            halves = [hypot(*sizes[row]) / 2.0 for row in rows]
            targets = np.array(moment.targets if flags else ()).reshape(-1, 3)
            near = targets[np.linalg.norm(targets - places.mean(axis=0), axis=1) < _NEAR]
            places, halves = np.concatenate([places, near]), halves + [_MARK] * len(near)
            middles[i] = (places.min(axis=0) + places.max(axis=0)) / 2.0
            radii[i] = (np.linalg.norm(places - middles[i], axis=1) + halves).max()
            if last < 0:
                middles[:i], radii[:i] = middles[i], radii[i]
            last = i
        elif last >= 0:
            middles[i], radii[i] = middles[last], radii[last]
    return middles, radii
