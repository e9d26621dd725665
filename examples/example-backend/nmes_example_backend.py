"""An engine in 100 lines: boxes in the plane that fly, turn, and stop where they touch the ground.

It promises nothing beyond that (`capabilities` is empty): no joints, no friction, no contacts. It keeps one numpy
array with a row for each body: x, y, angle and their velocities.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from hashlib import blake2b, sha256
from pathlib import Path

import numpy as np

from nmes.backend import (
    Array,
    Backend,
    BodySpec,
    BodyState,
    Contact,
    JointParams,
    JointSpec,
    JointState,
    SceneSpec,
    Simulation,
    Vector,
)
from nmes.errors import SimulationFault, WorldError

__all__ = ["ExampleBackend"]


class ExampleSimulation(Simulation):
    """One scene."""

    def __init__(self, scene: SceneSpec) -> None:
        for option in scene.options:
            raise WorldError("invalid", f"this engine has no settings, so no {option!r}", f"engine/{option}")
        self._scene = scene
        self._specs: dict[int, BodySpec] = {}
        self._frozen: dict[int, bool] = {}
        self._rows: dict[int, Array] = {}  # x, y, angle, vx, vy, angular velocity
        self._acting: dict[int, Array] = {}  # what acts in the next step: fx, fy, torque, then the impulses

    def add_body(self, body: int, spec: BodySpec) -> None:
        self._specs[body], self._frozen[body] = spec, spec.frozen
        self._acting[body] = np.zeros(6)
        state = BodyState(spec.position, spec.quaternion, spec.linear_velocity, spec.angular_velocity)
        self.set_body_state(body, state)

    def remove_body(self, body: int) -> None:
        for table in (self._specs, self._frozen, self._rows, self._acting):
            del table[body]

    def set_frozen(self, body: int, frozen: bool) -> None:
        self._frozen[body] = frozen
        self._rows[body][3:] = self._acting[body][:] = 0.0

    def set_body_state(self, body: int, state: BodyState) -> None:
        angle = 2 * math.atan2(state.quaternion[2], state.quaternion[3])
        velocity = (*state.linear_velocity[:2], state.angular_velocity[2])
        self._rows[body] = np.array((*state.position[:2], angle, *((0, 0, 0) if self._frozen[body] else velocity)))

    def apply(self, body: int, force: Vector, torque: Vector, impulse: Vector, angular_impulse: Vector) -> None:
        if not self._frozen[body]:
            self._acting[body] += (*force[:2], torque[2], *impulse[:2], angular_impulse[2])

    def states(self, bodies: Sequence[int]) -> Array:
        states = np.zeros((len(bodies), 13))
        for state, body in zip(states, bodies, strict=True):
            x, y, angle, vx, vy, w = self._rows[body]
            state[:] = x, y, 0, 0, 0, math.sin(angle / 2), math.cos(angle / 2), vx, vy, 0, 0, 0, w
        return states

    def body_state(self, body: int) -> BodyState:
        row = self.states([body])[0].tolist()
        return BodyState(tuple(row[:3]), tuple(row[3:7]), tuple(row[7:10]), tuple(row[10:]))

    def step(self, substeps: int) -> None:
        before = {body: row.copy() for body, row in self._rows.items()}
        h, (gx, gy, _) = self._scene.timestep, self._scene.gravity
        for body, spec in self._specs.items():
            if self._frozen[body]:
                continue
            row, acting, (width, height, _) = self._rows[body], self._acting[body], spec.size
            inertia = np.array((spec.mass, spec.mass, spec.mass * (width**2 + height**2) / 12))
            acceleration = (gx, gy, 0.0) + acting[:3] / inertia
            row[3:] += acting[3:] / inertia
            for _ in range(substeps):
                row[:3] += h * row[3:] + h * h / 2 * acceleration
                row[3:] += h * acceleration
                reach = (abs(math.sin(row[2])) * width + abs(math.cos(row[2])) * height) / 2
                if self._scene.ground and row[1] < reach:
                    row[1], row[4], row[5] = reach, max(row[4], 0.0), 0.0
            acting[:] = 0.0
            if not np.abs(row).max() < 1e10:
                self._rows = before
                raise SimulationFault("diverged", "a body moves too fast or is too far away", body)

    def digest(self) -> bytes:
        state = blake2b(digest_size=16)
        for body, spec in self._specs.items():
            fields = (body, *spec.size, spec.mass, spec.friction, spec.restitution, self._frozen[body])
            state.update(np.concatenate([fields, self._rows[body], self._acting[body]]).tobytes())
        return state.digest()

    # What it does not promise, it must still answer or refuse.

    def sleeping(self, body: int) -> bool:
        return False

    def contacts(self, body: int) -> list[Contact]:
        return []

    def add_joint(self, joint: int, spec: JointSpec) -> None:
        raise WorldError("unsupported", "this engine has no joints", "joint_type")

    def remove_joint(self, joint: int) -> None:
        raise NotImplementedError

    def set_joint_params(self, joint: int, params: JointParams) -> None:
        raise NotImplementedError

    def joint_state(self, joint: int) -> JointState:
        raise NotImplementedError


class ExampleBackend(Backend):
    """The engine that the entry point names."""

    name = "example"
    dims = 2
    capabilities = frozenset()

    def version(self) -> str:
        """Returns this engine's version."""
        return "0.1.0"

    def fingerprint(self) -> dict[str, str]:
        """Returns the facts that another installation must share for its runs to give the same results."""
        source = sha256(Path(__file__).read_bytes()).hexdigest()
        return {"version": self.version(), "numpy": np.__version__, "binary_sha256": source}

    def create(self, scene: SceneSpec) -> ExampleSimulation:
        """Creates an empty scene."""
        return ExampleSimulation(scene)
