"""Rows of states kept while a MuJoCo scene runs, at the cost of a few copies a tick.

MuJoCo's arrays of a body (its pose, and its velocity at the centre of mass of its tree) are copied as they are. States
are made of them when they are asked for, many rows at a time, element by element, so to the same bits as
`MujocoSimulation.states`. Rows of a structure that the model does not have yet are kept in the same form.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np
import numpy.typing as npt

from nmes.backend import Array, Simulation, Track
from nmes.backends.mujoco3d.motors import WorkLog, compact
from nmes.backends.mujoco3d.structure import Structure

if TYPE_CHECKING:
    from nmes.backends.mujoco3d.running import RunningModel

__all__ = ["MujocoTrack", "states_of"]


class MujocoTrack(Track):
    """See `nmes.backend.Track`.

    Args:
        simulation: The scene.
        bodies: The bodies whose states are kept.
        joints: The joints whose positions are kept.
        motors: The joints the powers of whose motors are kept.
        rows: The number of rows that there is room for.
        running: The scene's model, which has all bodies and joints where `structure` has no edits.
        structure: The scene's bodies and joints.
    """

    def __init__(
        self,
        simulation: Simulation,
        bodies: Sequence[int],
        joints: Sequence[int],
        motors: Sequence[int],
        rows: int,
        running: RunningModel,
        structure: Structure,
    ) -> None:
        super().__init__(simulation, bodies, joints, motors)
        n, m = len(bodies), len(joints)
        self._placed = n > 0 or m > 0  # whether more than powers are kept
        self._running, self._structure = running, structure
        self._data: mujoco.MjData | None = None  # that of which the views are
        self._pose, self._turn = np.empty((rows, n, 3)), np.empty((rows, n, 4))
        self._motion, self._centre = np.empty((rows, n, 6)), np.empty((rows, n, 3))
        self._position, self._work = np.empty((rows, m)), WorkLog(motors, rows)
        # Where the rows come from: views of what lies in one piece in the engine's arrays, and what must be gathered.
        self._views: list[tuple[Array, Array]] = []
        self._gathered: list[tuple[Array, Array, npt.NDArray[np.intp]]] = []

    def note(self) -> None:
        """Keeps the present states and readings as the next row."""
        row, running = self.rows, self._running
        if self._placed:
            if self._structure.edited:
                self._note_slowly(row)
            else:
                if self._bodies:
                    running.refresh()
                if running.data is not self._data:
                    self._locate()
                for rows, view in self._views:
                    rows[row] = view
                for rows, array, index in self._gathered:
                    rows[row] = array[index]
                if not self._modelled:
                    self._read_positions(row)
        if self._motors:
            self._work.note(running.motors)
        self.rows = row + 1

    def _locate(self) -> None:
        """Looks up where bodies and joints are in the model."""
        compiled, data = self._running.compiled, self._running.data
        self._data = data
        bodies = [compiled.body_index[body] for body in self._bodies]
        roots = compiled.model.body_rootid[bodies].tolist()
        # Bodies of one tree share its centre of mass, which numpy then copies to them all.
        roots = roots[:1] if len(set(roots)) == 1 else roots
        # A joint between frozen bodies is in no model: then all are read one by one.
        self._modelled = all(joint in compiled.joint for joint in self._joints)
        slots = [compiled.joint[joint].q for joint in self._joints] if self._modelled else []
        self._views, self._gathered = [], []
        for rows, array, places in (
            (self._pose, data.xpos, bodies),
            (self._turn, data.xquat, bodies),
            (self._motion, data.cvel, bodies),
            (self._centre, data.subtree_com, roots),
            *([(self._position, data.qpos, slots)] if slots else []),
        ):
            index = compact(places)
            if isinstance(index, slice):
                self._views.append((rows, array[index]))
            else:
                self._gathered.append((rows, array, index))

    def _note_slowly(self, row: int) -> None:
        states = self._simulation.states(self._bodies)
        # As if each were a tree of its own: no arm from the centre of mass to the body.
        self._pose[row] = self._centre[row] = states[:, 0:3]
        self._turn[row] = states[:, (6, 3, 4, 5)]
        self._motion[row, :, :3], self._motion[row, :, 3:] = states[:, 10:13], states[:, 7:10]
        self._read_positions(row)

    def _read_positions(self, row: int) -> None:
        self._position[row] = self._simulation.joint_readings(self._joints)[:, 0]

    def states(self, begin: int, end: int) -> Array:
        """Returns the states of rows, array (rows, n, 13)."""
        rows = slice(begin, end)
        return states_of(self._pose[rows], self._turn[rows], self._motion[rows], self._centre[rows])

    def positions(self, begin: int, end: int) -> Array:
        """Returns the joints' positions in rows, array (rows, m)."""
        return self._position[begin:end]

    def powers(self, begin: int, end: int) -> Array:
        """Returns the powers of the motors in rows, array (rows, 2, m)."""
        return self._work.powers(begin, end)


def states_of(pose: Array, turn: Array, motion: Array, centre: Array) -> Array:
    """Returns states as `Simulation.states` has them, array (..., n, 13), from MuJoCo's arrays of bodies.

    Args:
        pose: `xpos`, shape (..., n, 3).
        turn: `xquat`, shape (..., n, 4).
        motion: `cvel`, the velocity at the centre of mass of the body's tree, shape (..., n, 6).
        centre: That centre of mass, shape (..., n, 3).
    """
    out = np.empty((*pose.shape[:-1], 13))
    out[..., 0:3] = pose
    out[..., 3:6], out[..., 6] = turn[..., 1:], turn[..., 0]
    arm = pose - centre
    x, y, z = arm[..., 0], arm[..., 1], arm[..., 2]
    wx, wy, wz = motion[..., 0], motion[..., 1], motion[..., 2]
    out[..., 7:10] = motion[..., 3:]
    out[..., 7] += wy * z - wz * y
    out[..., 8] += wz * x - wx * z
    out[..., 9] += wx * y - wy * x
    out[..., 10:13] = motion[..., :3]
    return out
