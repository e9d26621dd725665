"""Random programs: sequences of calls that the World could make, with which determinism is put to the test.

Run as a program (`python -m nmes.contract.programs MODULE:CLASS FIRST COUNT`), it prints the hashes of such programs:
that is how fresh processes are compared.
"""

from __future__ import annotations

import importlib
import random
import sys
from collections.abc import Sequence
from dataclasses import replace
from hashlib import blake2b
from typing import Any

import numpy as np

from nmes.backend import Array, Backend, BodySpec, BodyState, JointParams, JointSpec, SceneSpec, Simulation, Vector
from nmes.backend.contract.base import KINDS, SUBSTEPS, TIMESTEP, ZERO, about_z, vector
from nmes.errors import SimulationFault

Operation = tuple[str, tuple[Any, ...]]


def random_program(backend: Backend, seed: int) -> list[Operation]:
    """Returns a random sequence of calls of Simulation: edits, pushes and steps that the World could make."""
    rng = random.Random(seed)
    kinds = [kind for kind in KINDS if f"joint.{kind}" in backend.capabilities]
    program: list[Operation] = []
    places: dict[int, Vector] = {}
    joints: dict[int, tuple[str, int, int]] = {}
    numbers = iter(range(10_000))

    def add() -> None:
        place = (rng.uniform(-3, 3), rng.uniform(0.5, 6), rng.uniform(-3, 3) if backend.dims == 3 else 0.0)
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
        places[body := next(numbers)] = place
        program.append(("add_body", (body, spec)))

    def cut(joint: int) -> None:
        del joints[joint]
        program.append(("remove_joint", (joint,)))

    def params(kind: str) -> JointParams:
        result = JointParams()
        if kind not in ("hinge", "slide"):
            return result
        if "motor" in backend.capabilities and rng.random() < 0.5:
            result = replace(result, motor="velocity", target_velocity=rng.uniform(-5, 5), max_effort=10 * rng.random())
        elif "servo" in backend.capabilities and rng.random() < 0.5:
            result = replace(result, motor="position", target_position=rng.uniform(-1, 1), max_effort=20 * rng.random())
        if "spring" in backend.capabilities and rng.random() < 0.3:
            result = replace(result, stiffness=rng.uniform(0, 20), damping=rng.random())
        if "limits" in backend.capabilities and rng.random() < 0.3:
            result = replace(result, limits=(-rng.random(), rng.random()))
        return result

    for _ in range(3):
        add()
    for _ in range(rng.randint(40, 80)):
        choice = rng.random()
        body = rng.choice(list(places))
        if choice < 0.15 and len(places) < 12:
            add()
        elif choice < 0.20 and len(places) > 2:
            for joint in [joint for joint, (_, *pair) in joints.items() if body in pair]:
                cut(joint)
            del places[body]
            program.append(("remove_body", (body,)))
        elif choice < 0.35 and kinds:
            kind, other = rng.choice(kinds), rng.choice(list(places))
            if other != body and all({body, other} != set(pair) for _, *pair in joints.values()):
                anchor = vector((np.array(places[body]) + places[other]) / 2)
                axis = (1.0, 0.0, 0.0) if kind == "slide" else (0.0, 0.0, rng.choice((1.0, -1.0)))
                joints[joint := next(numbers)] = (kind, body, other)
                program.append(("add_joint", (joint, JointSpec(kind, body, other, anchor, axis, params(kind)))))
        elif choice < 0.40 and joints:
            cut(rng.choice(list(joints)))
        elif choice < 0.48:
            program.append(("set_frozen", (body, rng.random() < 0.5)))
        elif choice < 0.62:
            push = [(rng.uniform(-20, 20), rng.uniform(-20, 20), 0.0), (0.0, 0.0, rng.uniform(-5, 5))]
            kick = [(rng.uniform(-2, 2), rng.uniform(-2, 2), 0.0), (0.0, 0.0, rng.uniform(-1, 1))]
            program.append(("apply", (body, *push, *kick)))
        elif choice < 0.68 and all(body not in pair for _, *pair in joints.values()):
            places[body] = (rng.uniform(-3, 3), rng.uniform(0.5, 6), 0.0)
            state = BodyState(places[body], about_z(rng.uniform(-3, 3)), (rng.uniform(-2, 2), 0.0, 0.0), ZERO)
            program.append(("set_body_state", (body, state)))
        elif choice < 0.75 and any(kind in ("hinge", "slide") for kind, *_ in joints.values()):
            joint, (kind, *_) = rng.choice([item for item in joints.items() if item[1][0] in ("hinge", "slide")])
            if backend.capabilities & {"motor", "servo", "spring", "limits"}:
                program.append(("set_joint_params", (joint, params(kind))))
        else:
            program.extend([("step", (SUBSTEPS,))] * rng.choice((1, 1, 1, 2, 5, 10, 30, 90)))
    return program


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
