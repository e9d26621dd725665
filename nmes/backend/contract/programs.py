"""Random programs: sequences of calls that the World could make, with which determinism is put to the test.

Run as a program (`python -m nmes.backend.contract.programs MODULE:CLASS FIRST COUNT`), it prints the hashes of such
programs: that is how fresh processes are compared.
"""

from __future__ import annotations

import importlib
import itertools
import random
import sys
from collections.abc import Sequence
from dataclasses import replace
from hashlib import blake2b
from typing import Any

import numpy as np

from nmes.backend import Array, Backend, BodySpec, BodyState, JointParams, JointSpec, SceneSpec, Simulation, Vector
from nmes.backend.contract.base import KINDS, SUBSTEPS, TIMESTEP, ZERO, about_z, vector
from nmes.backend.shapes import ROUND, Shape, fitted
from nmes.errors import SimulationFault

Operation = tuple[str, tuple[Any, ...]]


class _Generator:
    """A random program in the making, and what exists by then in the world that would run it."""

    def __init__(self, backend: Backend, seed: int) -> None:
        self.random = random.Random(seed)
        self.capabilities, self.dims = backend.capabilities, backend.dims
        self.kinds = [kind for kind in KINDS if f"joint.{kind}" in backend.capabilities]
        self.shapes: list[Shape] = [shape for shape in ROUND if f"shape.{shape}" in backend.capabilities]
        self.forms = random.Random(~seed)  # of its own: programs are what they were, but for shapes
        self.program: list[Operation] = []
        self.places: dict[int, Vector] = {}  # by body
        self.joints: dict[int, tuple[str, int, int]] = {}  # kind and bodies
        self.numbers = itertools.count()

    def call(self, name: str, *arguments: Any) -> None:
        self.program.append((name, arguments))

    def add_body(self) -> None:
        rng = self.random
        place = (rng.uniform(-3, 3), rng.uniform(0.5, 6), rng.uniform(-3, 3) if self.dims == 3 else 0.0)
        spec = BodySpec(
            size=(rng.uniform(0.3, 1.5), rng.uniform(0.3, 1.5), rng.uniform(0.3, 1.5)),
            mass=rng.uniform(0.5, 5),
            friction=rng.uniform(0, 1.5),
            restitution=rng.choice((0.0, 0.0, rng.random())),
            position=place,
            quaternion=about_z(rng.uniform(-3, 3)),
            linear_velocity=(rng.uniform(-3, 3), rng.uniform(-3, 3), 0.0),
            angular_velocity=(0.0, 0.0, rng.uniform(-3, 3)),
            frozen=rng.random() < 0.1,
        )
        if self.shapes and self.forms.random() < 0.3:
            shape = self.forms.choice(self.shapes)
            spec = replace(spec, shape=shape, size=fitted(shape, spec.size))
        body = next(self.numbers)
        self.places[body] = place
        self.call("add_body", body, spec)

    def remove_body(self, body: int) -> None:
        for joint in [joint for joint, (_, *pair) in self.joints.items() if body in pair]:
            self.remove_joint(joint)
        del self.places[body]
        self.call("remove_body", body)

    def add_joint(self, body: int) -> None:
        rng = self.random
        kind, other = rng.choice(self.kinds), rng.choice(list(self.places))
        if other != body and not self.joined(body, other):
            anchor = vector((np.array(self.places[body]) + self.places[other]) / 2)
            axis = (1.0, 0.0, 0.0) if kind == "slide" else (0.0, 0.0, rng.choice((1.0, -1.0)))
            joint = next(self.numbers)
            self.joints[joint] = (kind, body, other)
            self.call("add_joint", joint, JointSpec(kind, body, other, anchor, axis, self.params(kind)))

    def joined(self, *bodies: int) -> bool:
        """Tells whether a joint holds all of these bodies."""
        return any(set(bodies) <= set(pair) for _, *pair in self.joints.values())

    def remove_joint(self, joint: int) -> None:
        del self.joints[joint]
        self.call("remove_joint", joint)

    def set_joint_params(self) -> None:
        driven = [(joint, kind) for joint, (kind, *_) in self.joints.items() if kind in ("hinge", "slide")]
        joint, kind = self.random.choice(driven)
        if self.capabilities & {"motor", "servo", "spring", "limits"}:
            self.call("set_joint_params", joint, self.params(kind))

    def params(self, kind: str) -> JointParams:
        rng, able, params = self.random, self.capabilities, JointParams()
        if kind not in ("hinge", "slide"):
            return params
        if "motor" in able and rng.random() < 0.5:
            params = replace(params, motor="velocity", target_velocity=rng.uniform(-5, 5), max_effort=10 * rng.random())
        elif "servo" in able and rng.random() < 0.5:
            params = replace(params, motor="position", target_position=rng.uniform(-1, 1), max_effort=20 * rng.random())
        if "spring" in able and rng.random() < 0.3:
            params = replace(params, stiffness=rng.uniform(0, 20), damping=rng.random())
        if "limits" in able and rng.random() < 0.3:
            params = replace(params, limits=(-rng.random(), rng.random()))
        return params

    def apply(self, body: int) -> None:
        rng = self.random
        push = [(rng.uniform(-20, 20), rng.uniform(-20, 20), 0.0), (0.0, 0.0, rng.uniform(-5, 5))]
        kick = [(rng.uniform(-2, 2), rng.uniform(-2, 2), 0.0), (0.0, 0.0, rng.uniform(-1, 1))]
        self.call("apply", body, *push, *kick)

    def move(self, body: int) -> None:
        rng = self.random
        self.places[body] = (rng.uniform(-3, 3), rng.uniform(0.5, 6), 0.0)
        state = BodyState(self.places[body], about_z(rng.uniform(-3, 3)), (rng.uniform(-2, 2), 0.0, 0.0), ZERO)
        self.call("set_body_state", body, state)

    def step(self) -> None:
        for _ in range(self.random.choice((1, 1, 1, 2, 5, 10, 30, 90))):
            self.call("step", SUBSTEPS)

    def any_operation(self) -> None:
        """Draws the next operation; where one cannot be, time passes or nothing happens."""
        rng, joints = self.random, self.joints
        choice, body = rng.random(), rng.choice(list(self.places))
        if choice < 0.15 and len(self.places) < 12:
            self.add_body()
        elif choice < 0.20 and len(self.places) > 2:
            self.remove_body(body)
        elif choice < 0.35 and self.kinds:
            self.add_joint(body)
        elif choice < 0.40 and joints:
            self.remove_joint(rng.choice(list(joints)))
        elif choice < 0.48:
            self.call("set_frozen", body, rng.random() < 0.5)
        elif choice < 0.62:
            self.apply(body)
        elif choice < 0.68 and not self.joined(body):
            self.move(body)
        elif choice < 0.75 and any(kind in ("hinge", "slide") for kind, *_ in joints.values()):
            self.set_joint_params()
        else:
            self.step()


def random_program(backend: Backend, seed: int) -> list[Operation]:
    """Returns a random sequence of calls of Simulation: edits, pushes and steps that the World could make."""
    generator = _Generator(backend, seed)
    for _ in range(3):
        generator.add_body()
    for _ in range(generator.random.randint(40, 80)):
        generator.any_operation()
    return generator.program


def program_digest(backend: Backend, program: Sequence[Operation]) -> str:
    """Returns the hash of the digests after each of a program's calls, in a new simulation."""
    sim = backend.create(SceneSpec(TIMESTEP))
    total = blake2b(digest_size=16)
    for name, arguments in program:
        try:
            getattr(sim, name)(*arguments)
        except SimulationFault as fault:
            total.update(fault.code.encode())
            break
        total.update(sim.digest())
    sim.close()
    return total.hexdigest()


def execute(sim: Simulation, program: Sequence[Operation]) -> None:
    """Makes a program's calls."""
    for name, arguments in program:
        getattr(sim, name)(*arguments)


def all_states(sim: Simulation, program: Sequence[Operation]) -> Array:
    """Returns the states of all bodies that a program leaves."""
    gone = {arguments[0] for name, arguments in program if name == "remove_body"}
    return sim.states([args[0] for name, args in program if name == "add_body" and args[0] not in gone])


def _main(target: str, first: str, count: str) -> None:
    module, _, name = target.partition(":")
    factory: Any = importlib.import_module(module)
    for part in name.split("."):
        factory = getattr(factory, part)
    backend = factory()
    for seed in range(int(first), int(first) + int(count)):
        print(program_digest(backend, random_program(backend, seed)))


if __name__ == "__main__":
    _main(*sys.argv[1:])
