"""Crowds: many bodies that edits left in one place glide out of it, each its own way, until each has a place.

Contacts of many things in one place are as many as their pairs, and all so deep that a solver hardly finds its way:
hundreds of cubes there would take minutes a step. So but for the first of them they touch only what cannot move, and
float off at a walking pace; who comes to where there is room stands still there, and is a body like all others again.

Hides what a place is, when there is room, and which way each goes. Who glides is part of a simulation's state.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import mujoco
import numpy as np
import numpy.typing as npt

from nmes.backend import Array
from nmes.backends.mujoco3d.model import GROUP_BITS, CompiledModel, inner_radii, kept_masks
from nmes.backends.mujoco3d.scenery import Scenery

__all__ = ["Crowds"]

Indices = npt.NDArray[np.intp]

_CROWD = 4  # bodies that edits may have left in others before some glide
_PLACE = 0.57  # m: the edge of a place of boxes that have balls of half a metre within them; below 1 / sqrt(3)
_ROOM = 3.0  # the edge of the cells of which 27 must be empty where there is room, in radii of the ball
_SPEED = 3.0  # m/s
_GLIDING = GROUP_BITS.bit_length()  # bits by which collision masks are shifted of what glides, and of what it meets
_SPREAD = np.array([0.7548776662466927, 0.5698402909980532])  # of the sequence R2 (Roberts, 2018), which is even
_FARTHEST = 2.0**40  # cells from the origin; what is further away is in the last one
_NEAR = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), axis=-1).reshape(27, 3)
_PRIMES = np.array([73856093, 19349663, 83492791])  # Teschner et al. (2003), of hashing cells of space


class Crowds:
    """The bodies that glide out of a crowd; none, and then of no cost, but soon after an edit.

    Attributes:
        gliding: Their numbers.
    """

    def __init__(self, scenery: Scenery) -> None:
        self.gliding: set[int] = set()
        self._scenery = scenery

    def move(self, compiled: CompiledModel, data: mujoco.MjData, edited: Iterable[int]) -> None:
        """Sees who of the edited bodies begins to glide and who comes to an end, and sets how fast they go."""
        self.gliding = self._crowded(compiled, data, edited)
        if not self.gliding:
            return
        mujoco.mj_kinematics(compiled.model, data)  # else others are where they were a step ago, or nowhere yet
        bodies = sorted(self.gliding)
        free = _Free(compiled, bodies)
        arrived = free.arrived(data)
        data.qvel[free.v[:, None] + np.arange(6)] = 0.0
        away = _directions(np.array(bodies), self._scenery.free_falls(free.places(data)))
        going = ~arrived
        data.qvel[free.v[going, None] + np.arange(3)] = _SPEED * away[going]
        self.gliding = {body for body, stays in zip(bodies, arrived.tolist(), strict=True) if not stays}

    @contextmanager
    def apart(self, compiled: CompiledModel, data: mujoco.MjData, edited: Iterable[int]) -> Iterator[None]:
        """While it lasts those that glide, or are about to, touch nothing but what cannot move."""
        gliding = self._crowded(compiled, data, edited)
        if not gliding:
            yield
            return
        model = compiled.model
        trees = model.body_treeid
        theirs = trees[[compiled.body_index[body] for body in gliding]]
        with kept_masks(model) as masks:
            for (kind, affinity), tree in ((masks[:2], trees[model.geom_bodyid]), (masks[2:], trees)):
                fixed, glides = (kind != 0) & (tree < 0), np.isin(tree, theirs)
                affinity[fixed] |= affinity[fixed] << _GLIDING
                kind[glides], affinity[glides] = kind[glides] << _GLIDING, 0
            yield

    def _crowded(self, compiled: CompiledModel, data: mujoco.MjData, edited: Iterable[int]) -> set[int]:
        """Returns the gliding bodies, and the edited bodies that share a place with one before them.

        A place is a cell of a grid, so fine that two boxes which do not overlap are never in one.
        """
        gliding = self.gliding & compiled.free.keys()
        model, index = compiled.model, compiled.body_index
        # Those whose group passes through itself are in no one's way there.
        meets = (model.body_contype & model.body_conaffinity) != 0
        bodies = [body for body in sorted(compiled.free.keys() & edited) if body not in gliding and meets[index[body]]]
        if len(bodies) <= _CROWD:
            return gliding
        free = _Free(compiled, bodies)
        scale = np.frexp(free.radii)[1]
        cells = np.column_stack((_cells(free.places(data), np.ldexp(_PLACE, scale)), scale))
        order = np.lexsort(cells.T)  # which is stable: those in one place stay in the order of their numbers
        again = (cells[order[1:]] == cells[order[:-1]]).all(axis=1)
        return gliding | {bodies[row] for row in order[1:][again].tolist()}


class _Free:
    """Free bodies of a model, in a given order."""

    def __init__(self, compiled: CompiledModel, bodies: Iterable[int]) -> None:
        slots = [compiled.free[body] for body in bodies]
        self.q = np.array([slot.q for slot in slots], np.intp)
        self.v = np.array([slot.v for slot in slots], np.intp)
        self._model = model = compiled.model
        self._index = model.dof_bodyid[self.v]
        self.radii: Array = inner_radii(model, self._index)

    def places(self, data: mujoco.MjData) -> Array:
        places: Array = data.qpos[self.q[:, None] + np.arange(3)]
        return places

    def arrived(self, data: mujoco.MjData) -> npt.NDArray[np.bool_]:
        """Says of each whether it is where there is room, also for those before it."""
        model, places = self._model, self.places(data)
        others = (model.body_treeid >= 0) & (model.body_contype != 0)
        others[self._index] = False
        edges = _ROOM * np.ldexp(0.5, np.frexp(self.radii)[1])
        found = np.zeros(len(places), bool)
        for edge in np.unique(edges).tolist():
            rows = np.flatnonzero(edges == edge)
            near = _hashes(_cells(places[rows], edge)[:, None, :] + _NEAR)
            room = ~_any_of(near, np.sort(_hashes(_cells(data.xipos[others], edge))))
            taken: set[int] = set()
            for row, cells in zip(rows[room].tolist(), near[room].tolist(), strict=True):
                if taken.isdisjoint(cells):
                    taken.add(cells[len(cells) // 2])
                    found[row] = True
        return found


def _cells(places: Array, edge: Array | float) -> npt.NDArray[np.int64]:
    """Returns the cells (n, 3) of a grid that places (n, 3) are in."""
    with np.errstate(all="ignore"):  # in a world that is diverging, which the engine's own step tells of
        cells = np.nan_to_num(np.floor(places / np.reshape(edge, (-1, 1))))
    whole: npt.NDArray[np.int64] = np.clip(cells, -_FARTHEST, _FARTHEST).astype(np.int64)
    return whole


def _hashes(cells: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Returns a number (...) for each cell (..., 3); two cells may have one, which is as if both were taken."""
    hashes: npt.NDArray[np.int64] = np.bitwise_xor.reduce(cells * _PRIMES, axis=-1)
    return hashes


def _any_of(rows: npt.NDArray[np.int64], ascending: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
    """Says of each row (n, k) whether any of it is among the numbers (m,); `numpy.isin` sorts all rows for that."""
    if not len(ascending):
        return np.zeros(len(rows), bool)
    found: npt.NDArray[np.bool_] = (ascending.take(np.searchsorted(ascending, rows), mode="clip") == rows).any(axis=1)
    return found


def _directions(bodies: npt.NDArray[np.int64], falls: Array) -> Array:
    """Returns a direction (n, 3) for each body by its number, spread evenly, none of them the way it falls (n, 3)."""
    height, turn = ((bodies[:, None] * _SPREAD) % 1.0).T
    height = 2.0 * height - 1.0
    half = np.where(turn < 0.5, 1.0, -1.0) * np.sqrt(1.0 - height * height)
    tangent = 4.0 * (turn % 0.5) - 1.0  # of half the angle: no sine is as exact on all machines
    scale = half / (1.0 + tangent * tangent)
    ways = np.column_stack((scale * (1.0 - tangent * tangent), height, scale * 2.0 * tangent))
    squares = (falls * falls).sum(axis=1)
    down = np.maximum((ways * falls).sum(axis=1), 0.0)
    turned: Array = ways - (2.0 / np.where(squares > 0.0, squares, 1.0) * down)[:, None] * falls
    return turned
