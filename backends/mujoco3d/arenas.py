"""The arenas of dm_control.locomotion, reduced to what bodies touch.

It hides how dm_control makes arenas and what else is in them: textures, cameras, lights and planes that are only
looked at. What is left are static planes, boxes and heightfields in our frame (Y up), cheap to add to a model again
and again. dm_control's physics is not used (it does not run on this MuJoCo): an arena's MJCF is compiled by MuJoCo
itself.

Invariant: an arena follows from its values alone. numpy's global generator, by which dm_control picks textures, is
neither read nor changed, since there is but one of each to pick.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from math import sqrt
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np

from nmes.backend import Arena, Array, Quaternion, Vector
from nmes.backend.rotation import multiply
from nmes.errors import WorldError

__all__ = ["Part", "missing", "parts"]

_UP = (-sqrt(0.5), 0.0, 0.0, sqrt(0.5))  # from their frame (Z up) to ours: (x, y, z) becomes (x, z, -y)
_CELL = 2.0  # m: a cell of a maze
_START = 2.0  # m: the platform where a corridor with gaps begins is centred on the origin


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A static geom as MuJoCo has them; `heights` (0 to 1, rows along y) are a heightfield's."""

    type: mujoco.mjtGeom
    size: tuple[float, ...]
    position: Vector
    quaternion: Quaternion
    color: tuple[float, ...]
    heights: Array | None = None


def missing() -> str | None:
    """Returns why this installation cannot make arenas: not all that they need has wheels for every Python."""
    if all(find_spec(name) is not None for name in ("dm_control", "labmaze")):
        return None
    return "dm-control is not installed; use Python 3.11 or 3.12 for worlds with arenas"


@functools.lru_cache(maxsize=16)
def parts(arena: Arena) -> tuple[Part, ...]:
    """Returns an arena's parts. It begins at the origin: a corridor's start, a bowl's middle, a maze's free cell."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it looks for a display, which we do not need
            import labmaze
            from dm_control.composer.variation import distributions
            from dm_control.locomotion.arenas import bowl, corridors, mazes
    except ImportError as error:
        raise WorldError("unsupported", f"arenas need the package dm-control: {error}", "scene/type") from error
    draw = np.random.RandomState(np.random.MT19937(np.random.SeedSequence(arena.seed)))
    corridor = {"corridor_length": arena.length, "corridor_width": arena.width}
    start = (0.0, 0.0)
    if arena.name == "bowl":
        dm_arena = bowl.Bowl(size=(20, 20))
    elif arena.name == "corridor":
        dm_arena = corridors.EmptyCorridor(**corridor)
    elif arena.name == "gaps":
        lengths = distributions.Uniform(1.0, 3.0), distributions.Uniform(0.5, 1.5)
        dm_arena = corridors.GapsCorridor(platform_length=lengths[0], gap_length=lengths[1], **corridor)
        start = (_START, 0.0)
    elif arena.name == "walls":
        widths = distributions.Uniform(0.25 * arena.width, 0.75 * arena.width)
        gaps = distributions.Uniform(2.5, 5.0)
        dm_arena = corridors.WallsCorridor(wall_width=widths, wall_gap=gaps, **corridor)
    else:
        side = arena.cells | 1
        maze = labmaze.RandomMaze(
            height=side, width=side, max_rooms=4, room_min_size=3, room_max_size=5,
            random_seed=int(draw.randint(2**31 - 1)),
        )  # fmt: skip
        dm_arena = mazes.MazeWithTargets(maze, xy_scale=_CELL)
    dm_arena.regenerate(draw)
    root = dm_arena.mjcf_model
    model = mujoco.MjModel.from_xml_string(root.to_xml_string(), assets=root.get_assets())
    dm_arena.initialize_episode(_Physics(model), draw)
    if arena.name == "maze":
        start = _free_cell(dm_arena)
    return tuple(_touchable(model, start))


class _Physics:
    """As much of dm_control's physics as an arena asks for when an episode begins: its one heightfield."""

    contexts = None

    def __init__(self, model: Any) -> None:
        self.model = model

    def bind(self, element: object) -> SimpleNamespace:
        m = self.model
        return SimpleNamespace(nrow=m.hfield_nrow[0], ncol=m.hfield_ncol[0], size=m.hfield_size[0], adr=m.hfield_adr[0])


def _touchable(model: Any, start: tuple[float, float]) -> Iterator[Part]:
    """Yields the geoms that collide, turned from Z up to Y up, with `start` at the origin."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for i in range(model.ngeom):
        if not model.geom_contype[i]:
            continue
        kind = mujoco.mjtGeom(model.geom_type[i])
        turn = np.empty(4)
        mujoco.mju_mat2Quat(turn, data.geom_xmat[i])
        w, *axis = turn.tolist()
        x, y, z = data.geom_xpos[i].tolist()
        size, heights = tuple(model.geom_size[i].tolist()), None
        if kind == mujoco.mjtGeom.mjGEOM_HFIELD:
            at = int(model.geom_dataid[i])
            rows, columns, first = model.hfield_nrow[at], model.hfield_ncol[at], model.hfield_adr[at]
            heights = model.hfield_data[first : first + rows * columns].reshape(rows, columns).astype(float)
            size = tuple(model.hfield_size[at].tolist())
            # MuJoCo will stretch the heights to go from 0 to 1; let them reach where they reach.
            low, high = float(heights.min()), float(heights.max())
            z += low * size[2]
            size = (size[0], size[1], (high - low) * size[2], size[3])
        yield Part(
            type=kind,
            size=size,
            position=(x - start[0], z, start[1] - y),
            quaternion=multiply(_UP, (axis[0], axis[1], axis[2], w)),
            color=tuple(model.geom_rgba[i].tolist()),
            heights=heights,
        )


def _free_cell(maze: Any) -> tuple[float, float]:
    """Returns the place (x, y), m, of the free cell nearest to the middle of a maze, in its own frame."""
    layer = maze.maze.entity_layer
    free = [(row, column) for row, line in enumerate(layer) for column, cell in enumerate(line) if cell != "*"]
    rows, columns = layer.shape
    best = min(free, key=lambda cell: ((2 * cell[0] - rows + 1) ** 2 + (2 * cell[1] - columns + 1) ** 2, cell))
    ((x, y, _),) = maze.grid_to_world_positions([best])
    return float(x), float(y)
