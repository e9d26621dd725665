"""A digest of what this machine computes, by which machines are compared instead of by their processors' names.

It is taken of a fixed set of computations that really reach worlds: the C library's functions as Python's `math` has
them, numpy's sums and sums of products, and short reference episodes of the engine, in which everything moves that its
capabilities promise. Where two probes are equal, the same recordings are expected to come out the same; where they
differ, nothing is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cache
from hashlib import blake2b
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy._core.multiarray import c_einsum

from nmes.backend.registry import Backend
from nmes.backend.simulation import Simulation
from nmes.backend.specs import (
    Array,
    BodySpec,
    Heightfield,
    JointParams,
    JointSpec,
    Planet,
    SceneSpec,
    StaticBox,
    Vector,
)
from nmes.errors import NmesError

__all__ = ["probe"]

_COUNT = 2000  # inputs of each function: of those of the C library, variants differ in one of some hundred
_TICKS, _SUBSTEPS, _TIMESTEP = 12, 4, 1.0 / 240.0
_REST: Vector = (0.0, 0.0, 0.0)
_Z: Vector = (0.0, 0.0, 1.0)

_OF_ANY: Final[tuple[Callable[[float], float], ...]] = (
    *(math.sin, math.cos, math.tan, math.atan, math.sinh, math.cosh, math.tanh, math.exp, math.expm1),
)
_OF_PARTS: Final[tuple[Callable[[float], float], ...]] = (math.asin, math.acos)  # of -1 to 1
_OF_POSITIVE: Final[tuple[Callable[[float], float], ...]] = (math.log, math.log2, math.log10, math.log1p, math.cbrt)
_OF_TWO: Final[tuple[Callable[[float, float], float], ...]] = (math.pow, math.atan2, math.fmod, math.hypot)

_probes: dict[type[Backend], str] = {}


def probe(backend: Backend) -> str:
    """Returns the digest for an engine, hexadecimal: computed once in a process, in some hundredths of a second.

    It does not depend on thread, process or order.
    """
    kind = type(backend)
    if kind not in _probes:
        with np.errstate(all="ignore"):  # whatever the program says that numpy is to raise
            digest = blake2b(_arithmetic(), digest_size=16)
            for episode in _episodes(backend):
                digest.update(episode)
        _probes[kind] = digest.hexdigest()
    return _probes[kind]


@cache
def _arithmetic() -> bytes:
    """Returns the bits of the C library's functions and of numpy's sums over fixed inputs."""
    # Multiples of the golden ratio, modulo 1: spread evenly, and exact on every machine.
    parts = [(i * 0x9E3779B97F4A7C15 % 2**64 >> 11) / 2.0**53 for i in range(1, _COUNT + 1)]
    anything, positive = [40.0 * part - 20.0 for part in parts], [1000.0 * part for part in parts]
    values = [list(map(function, anything)) for function in _OF_ANY]
    values += [list(map(function, (2.0 * part - 1.0 for part in parts))) for function in _OF_PARTS]
    values += [list(map(function, positive)) for function in _OF_POSITIVE]
    values += [list(map(function, parts, positive[::-1])) for function in _OF_TWO]
    table = np.array(values)
    sums = []
    for width in (1, 7, 8, 30, 200):
        left, right = table[:, :width], table[:, -width:]
        sums += [np.add.reduce(left * right, axis=-1), c_einsum("ij,ij->i", left, right)]
    return b"".join(array.tobytes() for array in (table, np.sqrt(np.abs(table)), *sums))


def _episodes(backend: Backend) -> Iterator[bytes]:
    """Yields how each reference episode comes out."""
    plain, *others = _scenes(backend)
    for scene, build in [(plain, _few), (plain, _many), (plain, _machine), *((scene, _few) for scene in others)]:
        try:
            yield _play(backend, scene, build)
        except NmesError as error:  # of an engine that faults here, or refuses what it promises
            yield error.code.encode()


def _scenes(backend: Backend) -> Iterator[SceneSpec]:
    yield SceneSpec(_TIMESTEP)
    tilted = StaticBox((4.0, 1.0, 4.0), (0.5, 0.2, 0.0), (0.0, 0.0, math.sqrt(0.02), math.sqrt(0.98)))
    hills = np.array([[(3 * x + 5 * z) % 7 / 10.0 for x in range(8)] for z in range(8)])
    if "scene.obstacles" in backend.capabilities:
        yield SceneSpec(_TIMESTEP, boxes=(tilted,))
    if "scene.heightfield" in backend.capabilities:
        yield SceneSpec(_TIMESTEP, ground=False, heightfield=Heightfield((12.0, 12.0), hills))
    if "scene.planets" in backend.capabilities:
        yield SceneSpec(_TIMESTEP, ground=False, planets=(Planet((0.3, -5.0, 0.0), 5.0), Planet((9.0, 4.0, 1.0), 3.0)))


Build = Callable[[Simulation, Backend], tuple[int, list[int]]]


def _play(backend: Backend, scene: SceneSpec, build: Build) -> bytes:
    """Runs an episode; returns its last digest, and what is read of its bodies and joints then."""
    simulation = backend.create(scene)
    try:
        bodies, joints = build(simulation, backend)
        for tick in range(_TICKS):
            push = (3.0 * (tick % 3) - 3.0, 0.5 * tick, 0.0 if backend.dims == 2 else 1.0)
            simulation.apply(tick % bodies, push, (0.0, 0.0, 0.2), _REST, (0.0, 0.0, -0.1))
            simulation.step(_SUBSTEPS)
        readings = [*_readings(simulation, backend, list(range(bodies)), joints)]
        return simulation.digest() + b"".join(np.asarray(reading, np.float64).tobytes() for reading in readings)
    finally:
        simulation.close()


def _readings(
    simulation: Simulation, backend: Backend, bodies: list[int], joints: list[int]
) -> Iterator[Array | list[float]]:
    yield simulation.states(bodies)
    yield simulation.joint_readings(joints)
    if "contacts" in backend.capabilities:
        yield [contact.force for body in bodies for contact in simulation.contacts(body)]
    if "sensors.inertial" in backend.capabilities:
        yield simulation.proper_accelerations(bodies)
    if "sensors.range" in backend.capabilities:
        ways = np.array([(0.6, -0.8, 0.0), (-0.8, -0.6, 0.0)])
        hits = [hit for body in bodies[:3] for hit in simulation.hits(body, ways, 20.0)]
        yield [-1.0 if hit is None else hit.distance for hit in hits]


# -- what moves -------------------------------------------------------------------------------------------------------


def _box(number: int, position: Vector, dims: int, **changes: Any) -> BodySpec:
    """Returns one of many boxes that all differ."""
    part = number * 0.618034 % 1.0
    size = (0.4 + 0.3 * part, 0.5 - 0.2 * part, 0.4 + 0.2 * part)
    sine = 0.3 * part - 0.1
    return BodySpec(
        size=size,
        mass=0.5 + 2.0 * part,
        friction=0.2 + part,
        restitution=0.0 if number % 3 else 0.4,
        position=position,
        quaternion=(0.0, 0.0, sine, math.sqrt(1.0 - sine * sine)),
        linear_velocity=_REST if changes else (0.5 - part, -1.0, 0.0 if dims == 2 else 0.3 * part),
        angular_velocity=_REST if changes else (0.0 if dims == 2 else part, 0.0, 2.0 * part - 1.0),
        **changes,
    )


def _heap(simulation: Simulation, backend: Backend, count: int) -> tuple[int, list[int]]:
    for number in range(count):
        depth = 0.0 if backend.dims == 2 else 0.2 * (number % 3)
        place = (0.4 * (number % 3) - 0.4, 0.3 + 0.4 * (number // 3), depth)
        simulation.add_body(number, _box(number, place, backend.dims))
    return count, []


def _few(simulation: Simulation, backend: Backend) -> tuple[int, list[int]]:
    """Adds boxes that fall on each other."""
    return _heap(simulation, backend, 4)


def _many(simulation: Simulation, backend: Backend) -> tuple[int, list[int]]:
    """Adds so many that engines which treat large systems otherwise do."""
    return _heap(simulation, backend, 11)


def _machine(simulation: Simulation, backend: Backend) -> tuple[int, list[int]]:
    """Adds a frozen base with a chain of all kinds of joints on it, driven, sprung and limited as can be."""
    kinds = [
        kind for kind in ("hinge", "slide", "fixed", "pin", "conetwist") if f"joint.{kind}" in backend.capabilities
    ]
    kinds += [kind for kind in kinds if kind in ("hinge", "slide")]
    places: list[Vector] = [(0.7 * number, 2.0 + 0.1 * number, 0.0) for number in range(len(kinds) + 1)]
    for number, place in enumerate(places):
        simulation.add_body(number, _box(number, place, backend.dims, frozen=number == 0))
    moving = []
    for number, (kind, (one, other)) in enumerate(zip(kinds, pairwise(places), strict=True)):
        anchor = ((one[0] + other[0]) / 2.0, (one[1] + other[1]) / 2.0, 0.0)
        axis = (1.0, 0.0, 0.0) if kind == "slide" else _Z
        params = _params(kind, backend, number)
        simulation.add_joint(number, JointSpec(kind, number, number + 1, anchor, axis, params))
        if kind in ("hinge", "slide"):
            moving.append(number)
    return len(places), moving


def _params(kind: str, backend: Backend, number: int) -> JointParams:
    """Returns a motor, a spring and limits for a hinge or a slide, as far as the engine has them."""
    can = backend.capabilities
    if kind not in ("hinge", "slide"):
        return JointParams()
    stiffness, damping = (3.0, 0.2) if "spring" in can else (0.0, 0.0)
    limits = (-0.7, 0.4) if "limits" in can else None
    if number % 2 and "servo" in can:
        return JointParams("position", 0.0, 0.3, 20.0, stiffness, damping, limits)
    if "motor" in can:
        return JointParams("velocity", -1.5, 0.0, 10.0, stiffness, damping, limits)
    return JointParams(stiffness=stiffness, damping=damping, limits=limits)
