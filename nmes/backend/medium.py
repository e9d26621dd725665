"""What a medium does to bodies in it: drag and buoyancy, by formulas that are the same on every engine.

Drag is that of MuJoCo's inertia box (its documentation, "Fluid forces"): the box of the same moments of inertia as the
body is slowed along each of its axes by 1/2 rho A |v| v, with A its face across that axis, and by 3 pi d mu v as a ball
of the box's mean edge d; it turns likewise. Buoyancy lifts what the submerged volume would weigh of the medium, in that
volume's middle, and drag is by the part of the volume that is submerged.

Of a body that a level cuts, the volume beneath is that of a solid whose parts lie, in height, as those of the body do:
exactly that of a ball; exactly that of a box, but for a rounding of 2% of its mean edge, so that it is smooth; of a
capsule or a cylinder that of the box of its second moments with an edge upwards, which is within 4% of the volume. The
force and the torque follow from one potential, so that no body gains by floating.

Sums, products and square roots, each in one order: the same bits everywhere.
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
_SIGNS = tuple(product((0.5, -0.5), repeat=3))  # of the corners of a box


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
        self._medium, self._weight, self._step = medium, np.array(weight), timestep
        own = np.array([moments(shape, size) for shape, size in zip(shapes, sizes, strict=True)]).reshape(-1, 3)
        self._volumes = np.array([volume(shape, size) for shape, size in zip(shapes, sizes, strict=True)])
        a, b, c = own.T
        box = np.sqrt(6.0 * np.stack([b + c - a, a + c - b, a + b - c]))  # its edges, shape (3, n)
        self._box, self._masses, self._moments = box, masses, own.T * masses
        x, y, z = box
        rho, mu, mean = medium.density, medium.viscosity, (x + y + z) / 3.0
        self._quadratic = 0.5 * rho * np.stack([y * z, x * z, x * y])
        self._viscous = 3.0 * pi * mu * mean
        xx, yy, zz = x * x * x * x, y * y * y * y, z * z * z * z
        self._quadratic_turn = rho / 64.0 * np.stack([x * (yy + zz), y * (xx + zz), z * (xx + yy)])
        self._viscous_turn = pi * mu * mean * mean * mean
        self._balls = np.array([shape == "sphere" for shape in shapes], bool)
        self._radii = np.array([size[0] / 2.0 for size in sizes])
        lies = [axis(size) for size in sizes]
        self._turned = np.array([shape in ("capsule", "cylinder") for shape in shapes], bool)
        self._lies = np.array([[float(i == each) for each in lies] for i in range(3)])
        self._across = np.array([box[each - 1, i] for i, each in enumerate(lies)])
        self._along = np.array([box[each, i] for i, each in enumerate(lies)])
        self._rounding = _ROUNDING * mean

    def wrenches(self, states: Array) -> Array:
        """Returns the forces (N) and torques (N m) about the centres that the medium exerts, array (6, n).

        Args:
            states: Of the bodies, array (n, 13) as `Simulation.states` has them.
        """
        columns = np.ascontiguousarray(states.T)
        turn = _matrix(columns[3:7])
        part, torque = self._lifted(columns, turn)
        lift = -self._medium.density * self._volumes * part
        out = np.empty((6, len(states)))
        for i in range(3):
            out[i], out[3 + i] = lift * self._weight[i], torque[i]
        self._slow(out[:3], columns[7:10], turn, part, self._quadratic, self._viscous, self._masses)
        self._slow(out[3:], columns[10:13], turn, part, self._quadratic_turn, self._viscous_turn, self._moments)
        return out

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

    def _slow(
        self,
        out: Array,
        velocity: Array,
        turn: list[list[Array]],
        part: Array,
        quadratic: Array,
        viscous: Array,
        inert: Array,
    ) -> None:
        """Adds drag against a velocity: of each own axis what would stop the body alone within a step at the most."""
        own = [_sum(turn[j][i] * velocity[j] for j in range(3)) for i in range(3)]
        inertia = np.broadcast_to(inert, quadratic.shape)
        for i, speed in enumerate(own):
            rate = np.minimum(part * (quadratic[i] * np.abs(speed) + viscous), inertia[i] / self._step)
            force = -rate * speed
            for j in range(3):
                out[j] += turn[j][i] * force

    def _lifted(self, columns: Array, turn: list[list[Array]]) -> tuple[Array, list[Array]]:
        """Returns the submerged part of each volume, and the torques of buoyancy."""
        level, count = self._medium.level, columns.shape[1]
        none = np.zeros(count)
        if level is None:
            return np.ones(count), [none, none, none]
        depth = level - columns[1]
        extents = self._extents(turn)
        part, _, slopes = _moments_below(depth, extents)
        if self._balls.any():
            part = np.where(self._balls, _ball_part(depth, self._radii), part)
        # Of the potential E: dE/d(extent i) times how that changes as the body turns about x and z.
        strength = -self._medium.density * self._weight[1] * self._volumes
        rise = turn[1]  # how far each own axis rises
        push = [
            np.where(self._balls, 0.0, strength * slope / extent) for slope, extent in zip(slopes, extents, strict=True)
        ]
        # An extent squared is edge^2 rise^2 and more (a box), or along^2 n^2 + ..., across^2 (1 - n^2) / 2 (turned).
        along = _sum(self._lies[i] * rise[i] for i in range(3))
        axial = (push[0] * self._along**2 - (push[1] + push[2]) * self._across**2 / 2.0) * along
        gradient = [
            np.where(self._turned, axial * self._lies[i], push[i] * self._box[i] * self._box[i] * rise[i])
            for i in range(3)
        ]
        # d(rise i)/d(turn about x) = -R[2][i], about z = +R[0][i]
        about_x = _sum(gradient[i] * turn[2][i] for i in range(3))
        about_z = _sum(gradient[i] * turn[0][i] for i in range(3))
        return part, [about_x, none, -about_z]

    def _extents(self, turn: list[list[Array]]) -> list[Array]:
        """Returns how far the three edges of each body's box reach in height, rounded, m."""
        rounding, rise = self._rounding * self._rounding, turn[1]
        along = _sum(self._lies[i] * rise[i] for i in range(3))
        square = along * along
        aside = self._across * self._across * np.maximum(1.0 - square, 0.0) / 2.0
        squares = []
        for i in range(3):
            box = self._box[i] * rise[i]
            turned = self._along * self._along * square if i == 0 else aside
            squares.append(np.where(self._turned, turned, box * box))
        return [np.sqrt(each + rounding) for each in squares]


def _moments_below(depth: Array, extents: list[Array]) -> tuple[Array, Array, list[Array]]:
    """Returns what is below a level of even boxes whose edges reach so far in height: their part and its mean depth.

    Args:
        depth: How far beneath the level the middles are, m.
        extents: Of the three edges, m, none of them 0.

    Returns:
        The part of each volume; the mean over the whole volume of how deep what is below lies, m; and the derivatives
        of that by the three extents.
    """
    a, b, c = extents
    scale = 1.0 / (a * b * c)
    part, energy, slopes = 0.0 * depth, 0.0 * depth, [0.0 * depth, 0.0 * depth, 0.0 * depth]
    for signs in _SIGNS:
        corner = np.maximum(depth + signs[0] * a + signs[1] * b + signs[2] * c, 0.0)
        cube = 8.0 * signs[0] * signs[1] * signs[2] * corner * corner * corner * scale / 6.0
        part = part + cube
        energy = energy + cube * corner / 4.0
        slopes = [slope + sign * cube for slope, sign in zip(slopes, signs, strict=True)]
    # Deep enough, it is all below; sums of large numbers would say so less exactly.
    whole = depth >= (a + b + c) / 2.0
    part, energy = np.where(whole, 1.0, part), np.where(whole, depth, energy)
    slopes = [np.where(whole, 0.0, slope - energy / extent) for slope, extent in zip(slopes, extents, strict=True)]
    return part, energy, slopes


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


def _matrix(q: Array) -> list[list[Array]]:
    """Returns the matrices of quaternions, shape (4, ...): rows are the world's axes, columns the body's own."""
    x, y, z, w = q
    return [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]


def _sum(terms: Iterable[Array]) -> Array:
    """Adds arrays up from the first to the last."""
    return reduce(add, terms)
