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

from collections.abc import Sequence
from itertools import product
from math import pi

import numpy as np

from nmes.backend.shapes import Shape, axis, moments, volume
from nmes.backend.specs import Array, Medium, Vector

__all__ = ["Immersion"]

_ROUNDING = 0.02  # part of a body's mean edge by which what the level cuts is rounded
_CORNERS = np.array([*product((0.5, -0.5), repeat=3)]).T.reshape(3, 8, 1, 1)  # of a box: parts of its edges
_LEVERS = _CORNERS.swapaxes(0, 1).copy()  # the same, corner by corner
_SIGNS = 8.0 * _CORNERS[0] * _CORNERS[1] * _CORNERS[2]
# Entries of a matrix, row by row, are constant + factor * (first + sign * second), the two of them products of a
# quaternion's components i and j, at 4 i + j: 1 - 2 (yy + zz) on the diagonal, 2 (xy - wz) beside it. To add -0.0
# changes no number, nor the sign of a zero.
_FIRST = np.array([5, 1, 2, 1, 0, 6, 2, 6, 0])
_SECOND = np.array([10, 14, 13, 14, 10, 12, 13, 12, 5])
_SIGN = np.array([1.0, -1.0, 1.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0])[:, None]
_FACTOR, _CONSTANT = np.where(np.eye(3, dtype=bool).reshape(9, 1), [[[-2.0]], [[1.0]]], [[[2.0]], [[-0.0]]])


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
        self._level, self._weight = medium.level, np.array(weight)[:, None, None]
        own = np.array([moments(shape, size) for shape, size in zip(shapes, sizes, strict=True)]).reshape(-1, 3)
        volumes = np.array([volume(shape, size) for shape, size in zip(shapes, sizes, strict=True)])
        self._displaced = -medium.density * volumes
        self._strength = -medium.density * weight[1] * volumes
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
        self._any_ball, self._any_turned = bool(self._balls.any()), bool(self._turned.any())
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
        # What adds up: buoyancy, then drag along each own axis.
        terms = np.empty((4, 2, 3, 1, len(states)))
        terms[0, 0] = self._displaced * part * self._weight
        terms[0, 1] = torque
        terms[1:] = self._drag(columns[7:13].reshape(terms.shape[1:]), turn, part)
        return _sum(terms).reshape(6, len(states))

    def potentials(self, states: Array) -> Array:
        """Returns the energy of what the bodies displace, J, array (k, n), in states of shape (13, k, n)."""
        if self._level is None:
            return np.asarray(-self._displaced * _sum(states[:3] * self._weight))
        depth = self._level - states[1]
        energy = _moments_below(depth, self._extents(_matrix(states[3:7])[1]))[1]
        if self._any_ball:
            energy = np.where(self._balls, _ball_energy(depth, self._radii), energy)
        return np.asarray(self._strength * energy)

    def _drag(self, velocity: Array, turn: Array, part: Array) -> Array:
        """Returns drag along each own axis: what would stop the body alone within a step at the most.

        Args:
            velocity: Of the bodies and of their turning, array (2, 3, 1, n).
            turn: Their matrices.
            part: Of each that is submerged.

        Returns:
            Forces and torques, array (3, 2, 3, 1, n).
        """
        own = _sum((turn * velocity[:, :, None]).swapaxes(0, 1))
        rate = np.minimum(part * (self._quadratic * np.abs(own) + self._viscous), self._most)
        force = -rate * own
        return np.asarray(turn.swapaxes(0, 1)[:, None] * force.swapaxes(0, 1)[:, :, None])

    def _lifted(self, columns: Array, turn: Array) -> tuple[Array, Array]:
        """Returns the submerged part of each volume, and the torques of buoyancy, array (3, 1, n)."""
        torque = np.zeros_like(columns[:3])
        if self._level is None:
            return np.ones_like(columns[0]), torque
        depth = self._level - columns[1]
        rise = turn[1]  # how far each own axis rises
        extents = self._extents(rise)
        part, _, slopes = _moments_below(depth, extents)
        # Of the potential E: dE/d(extent i) times how that changes as the body turns about x and z.
        push = self._strength * slopes / extents
        if self._any_ball:
            part = np.where(self._balls, _ball_part(depth, self._radii), part)
            push = np.where(self._balls, 0.0, push)
        # An extent squared is edge^2 rise^2 and more (a box), or along^2 n^2 + ..., across^2 (1 - n^2) / 2 (turned).
        gradient = push * self._box * self._box * rise
        if self._any_turned:
            along = _sum(self._lies * rise)
            axial = (push[0] * self._along_squared - (push[1] + push[2]) * self._across_squared / 2.0) * along
            gradient = np.where(self._turned, axial * self._lies, gradient)
        # d(rise i)/d(turn about x) = -R[2][i], about z = +R[0][i]
        about_x, about_z = _sum((gradient * turn[::2]).swapaxes(0, 1))[::-1]
        torque[0], torque[2] = about_x, -about_z
        return part, torque

    def _extents(self, rise: Array) -> Array:
        """Returns how far the three edges of each body's box reach in height, rounded, m.

        Args:
            rise: How far their own axes rise, array (3, k, n).
        """
        reach = self._box * rise
        square = reach * reach
        if self._any_turned:
            along = _sum(self._lies * rise)
            turned, part = np.empty_like(square), along * along
            turned[0] = self._along_squared * part
            turned[1:] = self._across_squared * np.maximum(1.0 - part, 0.0) / 2.0
            square = np.where(self._turned, turned, square)
        return np.asarray(np.sqrt(square + self._rounding))


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
    corners = depth + _CORNERS[0] * a
    corners += _CORNERS[1] * b
    corners += _CORNERS[2] * c
    np.maximum(corners, 0.0, out=corners)
    terms = np.empty((8, 5, *depth.shape))  # of each corner to the part, the energy and the slopes
    cubes = np.multiply(_SIGNS, corners, out=terms[:, 0])
    cubes *= corners
    cubes *= corners
    cubes *= scale
    cubes /= 6.0
    terms[:, 1] = cubes * corners / 4.0
    terms[:, 2:] = _LEVERS * cubes[:, None]
    sums = _sum(terms)
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
    products = (q[:, None] * q).reshape(16, -1)
    turn = products[_SECOND] * _SIGN
    turn += products[_FIRST]
    turn *= _FACTOR
    turn += _CONSTANT
    return np.asarray(turn.reshape(3, 3, *q.shape[1:]))


def _sum(terms: Array) -> Array:
    """Adds arrays up along their first axis, from the first to the last."""
    total = terms[0] + terms[1]
    for term in terms[2:]:
        total += term
    return np.asarray(total)
