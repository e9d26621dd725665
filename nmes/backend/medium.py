"""What a medium does to bodies in it: drag and buoyancy, by formulas that are the same on every engine.

Drag is that of MuJoCo's inertia box (its documentation, "Fluid forces"): the box of the same moments of inertia as the
body is slowed along each of its axes by 1/2 rho A |v| v, with A its face across that axis, and by 3 pi d mu v as a ball
of the box's mean edge d; it turns likewise. Buoyancy lifts what the submerged volume would weigh of the medium, in that
volume's middle, and drag is by the part of the volume that is submerged.

Of a body that a level cuts, the volume beneath is that of a solid whose parts lie, in height, as those of the body do:
exactly that of a ball; exactly that of a box, but for a rounding of 2% of its mean edge, so that it is smooth; of a
capsule or a cylinder that of the box of its second moments with an edge upwards, which is within 4% of the volume. The
force and the torque follow from one potential, so that no body gains by floating.

Sums, products and square roots, each in one order: the same bits everywhere. Arrays are about few bodies, so that calls
cost more than numbers: axes and corners are done at once, and added up one by one.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import reduce
from itertools import product
from math import pi
from operator import add

import numpy as np

from nmes.backend.shapes import Shape, axis, moments, volume
from nmes.backend.specs import Array, Medium, Vector

__all__ = ["Immersion"]

_ROUNDING = 0.02  # part of a body's mean edge by which what the level cuts is rounded
_CORNERS = np.array([*product((0.5, -0.5), repeat=3)]).T.reshape(3, 8, 1, 1)  # of a box: parts of its edges
_SIGNS = 8.0 * _CORNERS[0] * _CORNERS[1] * _CORNERS[2]
# Of quaternions' products in their matrices: yy + zz, xx + zz, xx + yy on the diagonal; xy, xz, yz beside it.
_TWICE = np.array([[1, 0, 0], [2, 2, 1]])
_FIRST, _SECOND = np.array([0, 0, 1]), np.array([1, 2, 2])


class Immersion:
    """Some bodies in a medium.

    Args:
        medium: It.
        weight: How strongly what is immersed is lifted: the acceleration of free fall, m/s^2.
        timestep: Of the engine, s: drag is bounded so that it turns nothing round within one.
        shapes: The bodies' shapes.
        sizes: Their edge lengths, m.
        masses: Array (n,), kg.
    """

    def __init__(
        self,
        medium: Medium,
        weight: Vector,
        timestep: float,
        shapes: Sequence[Shape],
        sizes: Sequence[Vector],
        masses: Array,
    ) -> None:
        self._medium, self._weight = medium, np.array(weight)
        own = np.array([moments(shape, size) for shape, size in zip(shapes, sizes, strict=True)]).reshape(-1, 3)
        self._volumes = np.array([volume(shape, size) for shape, size in zip(shapes, sizes, strict=True)])
        a, b, c = own.T
        box = np.sqrt(6.0 * np.stack([b + c - a, a + c - b, a + b - c]))  # its edges, shape (3, n)
        # Of axes, moments of time and bodies, shape (3, 1, n); those of drag for forces and for torques, (2, 3, 1, n).
        self._box = box[:, None]
        x, y, z = box
        rho, mu, mean = medium.density, medium.viscosity, (x + y + z) / 3.0
        xx, yy, zz = x * x * x * x, y * y * y * y, z * z * z * z
        pushed = 0.5 * rho * np.stack([y * z, x * z, x * y])
        turned = rho / 64.0 * np.stack([x * (yy + zz), y * (xx + zz), z * (xx + yy)])
        self._quadratic = np.stack([pushed, turned])[:, :, None]
        self._viscous = np.stack([3.0 * pi * mu * mean, pi * mu * mean * mean * mean])[:, None, None]
        self._most = np.stack([np.broadcast_to(masses, box.shape), own.T * masses])[:, :, None] / timestep
        self._balls = np.array([shape == "sphere" for shape in shapes], bool)
        self._radii = np.array([size[0] / 2.0 for size in sizes])
        lies = [axis(size) for size in sizes]
        self._turned = np.array([shape in ("capsule", "cylinder") for shape in shapes], bool)
        self._lies = np.array([[float(i == each) for each in lies] for i in range(3)])[:, None]
        across = np.array([box[each - 1, i] for i, each in enumerate(lies)])
        along = np.array([box[each, i] for i, each in enumerate(lies)])
        self._across_squared, self._along_squared = across * across, along * along
        rounding = _ROUNDING * mean
        self._rounding = rounding * rounding

    def wrenches(self, states: Array) -> Array:
        """Returns the forces (N) and torques (N m) about the centres that the medium exerts, array (6, n).

        Args:
            states: Of the bodies, array (n, 13) as `Simulation.states` has them.
        """
        columns = np.ascontiguousarray(states.T)[:, None]
        turn = _matrix(columns[3:7])
        part, torque = self._lifted(columns, turn)
        lift = -self._medium.density * self._volumes * part
        out = np.empty((2, 3, *lift.shape))
        out[0] = lift * self._weight[:, None, None]
        out[1] = torque
        self._slow(out, columns[7:13].reshape(out.shape), turn, part)
        return out.reshape(6, len(states))

    def potentials(self, states: Array) -> Array:
        """Returns the energy of what the bodies displace, J, array (k, n), in states of shape (13, k, n)."""
        density, level = self._medium.density, self._medium.level
        if level is None:
            heights = _sum(states[i] * self._weight[i] for i in range(3))
            return np.asarray(density * self._volumes * heights)
        depth = level - states[1]
        energy = _moments_below(depth, self._extents(_matrix(states[3:7])))[1]
        balls = self._balls
        if balls.any():
            energy = np.where(balls, _ball_energy(depth, self._radii), energy)
        return np.asarray(-density * self._weight[1] * self._volumes * energy)

    def _slow(self, out: Array, velocity: Array, turn: Array, part: Array) -> None:
        """Adds drag against velocities: of each own axis what would stop the body alone within a step at the most.

        Args:
            out: Forces and torques, array (2, 3, 1, n).
            velocity: Of the bodies and of their turning, likewise.
            turn: Their matrices.
            part: Of each that is submerged.
        """
        own = _sum(turn[j] * velocity[:, j, None] for j in range(3))
        rate = np.minimum(part * (self._quadratic * np.abs(own) + self._viscous), self._most)
        force = -rate * own
        for i in range(3):
            out += turn[:, i] * force[:, i, None]

    def _lifted(self, columns: Array, turn: Array) -> tuple[Array, Array]:
        """Returns the submerged part of each volume, and the torques of buoyancy, array (3, 1, n)."""
        level, torque = self._medium.level, np.zeros_like(columns[:3])
        if level is None:
            return np.ones_like(columns[0]), torque
        depth = level - columns[1]
        extents = self._extents(turn)
        part, _, slopes = _moments_below(depth, extents)
        if self._balls.any():
            part = np.where(self._balls, _ball_part(depth, self._radii), part)
        # Of the potential E: dE/d(extent i) times how that changes as the body turns about x and z.
        strength = -self._medium.density * self._weight[1] * self._volumes
        rise = turn[1]  # how far each own axis rises
        push = np.where(self._balls, 0.0, strength * slopes / extents)
        # An extent squared is edge^2 rise^2 and more (a box), or along^2 n^2 + ..., across^2 (1 - n^2) / 2 (turned).
        along = _sum(self._lies * rise)
        axial = (push[0] * self._along_squared - (push[1] + push[2]) * self._across_squared / 2.0) * along
        gradient = np.where(self._turned, axial * self._lies, push * self._box * self._box * rise)
        # d(rise i)/d(turn about x) = -R[2][i], about z = +R[0][i]
        torque[0], torque[2] = _sum(gradient * turn[2]), -_sum(gradient * turn[0])
        return part, torque

    def _extents(self, turn: Array) -> Array:
        """Returns how far the three edges of each body's box reach in height, rounded, m."""
        along, box = _sum(self._lies * turn[1]), self._box * turn[1]
        square = along * along
        turned = np.empty_like(box)
        turned[0] = self._along_squared * square
        turned[1:] = self._across_squared * np.maximum(1.0 - square, 0.0) / 2.0
        return np.asarray(np.sqrt(np.where(self._turned, turned, box * box) + self._rounding))


def _moments_below(depth: Array, extents: Array) -> tuple[Array, Array, Array]:
    """Returns the part of boxes below a level, whose edges reach so far in height, and its mean depth.

    Args:
        depth: How far beneath the level the middles are, m, array (k, n).
        extents: Of the three edges, m, none of them 0, array (3, k, n).

    Returns:
        The part of each volume; the mean over the whole volume of how deep what is below lies, m; and the derivatives
        of that by the three extents.
    """
    a, b, c = extents
    scale = 1.0 / (a * b * c)
    corners = np.maximum(depth + _CORNERS[0] * a + _CORNERS[1] * b + _CORNERS[2] * c, 0.0)
    terms = np.empty((5, *corners.shape))  # of the part, the energy and the slopes
    terms[0] = cubes = _SIGNS * corners * corners * corners * scale / 6.0
    terms[1] = cubes * corners / 4.0
    terms[2:] = _CORNERS * cubes
    sums = reduce(add, terms.swapaxes(0, 1), 0.0 * depth)
    part, energy, slopes = sums[0], sums[1], sums[2:]
    # Deep enough, it is all below; sums of large numbers would say so less exactly.
    whole = depth >= (a + b + c) / 2.0
    part, energy = np.where(whole, 1.0, part), np.where(whole, depth, energy)
    return part, energy, np.where(whole, 0.0, slopes - energy / extents)


def _ball_part(depth: Array, radii: Array) -> Array:
    """Returns the parts of the volumes of balls that are below a level."""
    height = np.minimum(np.maximum(depth + radii, 0.0), 2.0 * radii)
    return np.asarray(height * height * (3.0 * radii - height) / (4.0 * radii * radii * radii))


def _ball_energy(depth: Array, radii: Array) -> Array:
    """Returns the mean over whole balls of how deep what is below lies, m."""
    height = np.minimum(np.maximum(depth + radii, 0.0), 2.0 * radii)
    cube = height * height * height
    below = cube * (radii - height / 4.0) / (4.0 * radii * radii * radii)
    return np.asarray(np.where(depth >= radii, depth, below))


def _matrix(q: Array) -> Array:
    """Returns the matrices of quaternions, shape (4, ...): rows are the world's axes, columns the body's own."""
    products = q[:, None] * q
    squares = products[_TWICE, _TWICE]
    same, other = products[_FIRST, _SECOND], products[3, 2::-1]  # xy, xz, yz; wz, wy, wx
    less, more = 2.0 * (same - other), 2.0 * (same + other)
    turn = np.empty((3, 3, *q.shape[1:]))
    turn[0, 0], turn[1, 1], turn[2, 2] = 1.0 - 2.0 * (squares[0] + squares[1])
    turn[0, 1], turn[2, 0], turn[1, 2] = less
    turn[1, 0], turn[0, 2], turn[2, 1] = more
    return turn


def _sum(terms: Iterable[Array]) -> Array:
    """Adds arrays up from the first to the last."""
    return reduce(add, terms)
