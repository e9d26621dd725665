"""The reference engine: exact ballistic motion, a ground, fixed joints, and nothing else.

It hides no library. Bodies fly on exact parabolas, turn about their centre of mass with their angular momentum kept,
and pass through each other; they meet only the ground, with their lowest point, which stops their turning. Bodies held
together by fixed joints are one rigid cluster. Read this file first when writing a backend.

Invariants: bodies are the truth, a cluster is only a list of them, in order of creation, and everything iterates in
that order; all state is immutable tuples, so that nothing returned or saved can alias it.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from hashlib import blake2b, sha256
from pathlib import Path
from typing import Any

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
    Quaternion,
    SceneSpec,
    Simulation,
    Vector,
)
from nmes.backend.rotation import conjugate, cross, multiply, normalize, rotate, total
from nmes.backend.shapes import SHAPES, misfit, moments, reach
from nmes.errors import SimulationFault, WorldError

__all__ = ["BallisticBackend"]

TOO_FAR = 1e10  # m, m/s or rad/s: beyond it a simulation has diverged, as in MuJoCo
ZERO: Vector = (0.0, 0.0, 0.0)
ROW = struct.Struct("<34d")  # what the digest holds of a body


@dataclass(slots=True)
class _Body:
    """A body: its number and making, its state, what acts on it in the next step, the ground's force in the last."""

    number: int
    spec: BodySpec
    position: Vector
    quaternion: Quaternion
    linear: Vector
    angular: Vector
    frozen: bool
    force: Vector = ZERO
    torque: Vector = ZERO
    impulse: Vector = ZERO
    angular_impulse: Vector = ZERO
    ground_force: float = 0.0


class BallisticSimulation(Simulation):
    """Bodies, fixed joints and gravity; the module says what it models."""

    def __init__(self, scene: SceneSpec) -> None:
        for option in scene.options:
            raise WorldError("invalid", f"ballistic has no settings, so no {option!r}", f"engine/{option}")
        self._scene = scene
        self._bodies: dict[int, _Body] = {}
        self._joints: dict[int, JointSpec] = {}  # anchor and axis in body1's frame
        self._clusters: list[list[_Body]] | None = None  # None: they must be found again

    def add_body(self, body: int, spec: BodySpec) -> None:
        linear, angular = (ZERO, ZERO) if spec.frozen else (spec.linear_velocity, spec.angular_velocity)
        self._bodies[body] = _Body(body, spec, spec.position, spec.quaternion, linear, angular, spec.frozen)
        self._clusters = None

    def remove_body(self, body: int) -> None:
        del self._bodies[body]
        self._clusters = None

    def add_joint(self, joint: int, spec: JointSpec) -> None:
        if spec.kind != "fixed":
            raise WorldError("unsupported", f"ballistic has only fixed joints, no {spec.kind!r}", "joint_type")
        body = self._bodies[spec.body1]
        back = _matrix(body.quaternion).T
        anchor = _vector(_apply(back, np.subtract(spec.anchor, body.position)))
        self._joints[joint] = replace(spec, anchor=anchor, axis=_vector(_apply(back, spec.axis)))
        self._clusters = None

    def remove_joint(self, joint: int) -> None:
        del self._joints[joint]
        self._clusters = None

    def set_joint_params(self, joint: int, params: JointParams) -> None:
        raise WorldError("unsupported", "a fixed joint has no parameters", "param_name")

    def set_frozen(self, body: int, frozen: bool) -> None:
        b = self._bodies[body]
        if b.frozen != frozen:
            b.frozen = frozen
            b.linear = b.angular = b.force = b.torque = b.impulse = b.angular_impulse = ZERO

    def set_body_state(self, body: int, state: BodyState) -> None:
        b = self._bodies[body]
        b.position, b.quaternion = state.position, state.quaternion
        if not b.frozen:
            b.linear, b.angular = state.linear_velocity, state.angular_velocity

    def apply(self, body: int, force: Vector, torque: Vector, impulse: Vector, angular_impulse: Vector) -> None:
        b = self._bodies[body]
        if not b.frozen:
            b.force, b.torque = _add(b.force, force), _add(b.torque, torque)
            b.impulse, b.angular_impulse = _add(b.impulse, impulse), _add(b.angular_impulse, angular_impulse)

    def body_state(self, body: int) -> BodyState:
        b = self._bodies[body]
        return BodyState(b.position, b.quaternion, b.linear, b.angular)

    def states(self, bodies: Sequence[int]) -> Array:
        rows = [(*b.position, *b.quaternion, *b.linear, *b.angular) for b in map(self._bodies.__getitem__, bodies)]
        return np.array(rows, dtype=np.float64).reshape(-1, 13)

    def sleeping(self, body: int) -> bool:
        return False

    def joint_state(self, joint: int) -> JointState:
        spec = self._joints[joint]
        body = self._bodies[spec.body1]
        out = _matrix(body.quaternion)
        return JointState(
            0.0, 0.0, 0.0, _vector(_apply(out, spec.anchor) + body.position), _vector(_apply(out, spec.axis))
        )

    def contacts(self, body: int) -> list[Contact]:
        b = self._bodies[body]
        below = (b.position[0], 0.0, b.position[2])
        return [Contact(None, below, (0.0, 1.0, 0.0), b.ground_force)] if b.ground_force else []

    def step(self, substeps: int) -> None:
        before = {number: replace(b) for number, b in self._bodies.items()}
        for cluster in self._find_clusters():
            if any(b.frozen for b in cluster):
                for b in cluster:
                    b.linear = b.angular = ZERO
                    b.ground_force = 0.0
            else:
                for b in cluster:
                    self._kick(b)
                for _ in range(substeps):
                    self._advance(cluster, self._scene.timestep)
                    for b in cluster:
                        if not all(abs(x) < TOO_FAR for x in (*b.position, *b.linear, *b.angular)):
                            self._bodies = before
                            self._clusters = None
                            raise SimulationFault("diverged", "a body moves too fast or is too far away", b.number)
        for b in self._bodies.values():
            b.force = b.torque = b.impulse = b.angular_impulse = ZERO

    def digest(self) -> bytes:
        state = blake2b(digest_size=16)
        for b in self._bodies.values():
            spec = (b.number, *b.spec.size, b.spec.mass, b.spec.friction, b.spec.restitution, b.frozen)
            pose = (*b.position, *b.quaternion, *b.linear, *b.angular)
            state.update(ROW.pack(*spec, *pose, *b.force, *b.torque, *b.impulse, *b.angular_impulse, b.ground_force))
            if b.spec.shape != "box":
                state.update(b.spec.shape.encode())
        for number, joint in self._joints.items():
            state.update(struct.pack("<9d", number, joint.body1, joint.body2, *joint.anchor, *joint.axis))
        return state.digest()

    def snapshot(self) -> bytes:
        # JSON, for Python's floats survive it bit for bit and a stranger's snapshot can do no harm.
        bodies = [asdict(b) for b in self._bodies.values()]
        for body in bodies:
            del body["spec"]["group"]  # there are none without collisions
            if body["spec"]["shape"] == "box":
                del body["spec"]["shape"]
        return json.dumps([bodies, [(n, asdict(spec)) for n, spec in self._joints.items()]]).encode()

    def members(self) -> tuple[dict[int, bool], dict[int, tuple[str, int, int]]]:
        bodies = {number: body.frozen for number, body in self._bodies.items()}
        return bodies, {number: (spec.kind, spec.body1, spec.body2) for number, spec in self._joints.items()}

    def restore(self, snapshot: bytes) -> None:
        try:
            bodies, joints = json.loads(snapshot)
            plain = JointParams()
            self._bodies = {b["number"]: _Body(**_tuples(b | {"spec": BodySpec(**_tuples(b["spec"]))})) for b in bodies}
            self._joints = {number: JointSpec(**_tuples(spec | {"params": plain})) for number, spec in joints}
            self._clusters = None
            self._find_clusters()
            sound = all(map(_sound, self._bodies.values())) and {s.kind for s in self._joints.values()} <= {"fixed"}
            self.digest()  # packs all there is, so all of it are numbers, and as many as there must be
        except (ValueError, TypeError, KeyError, AttributeError, struct.error) as error:
            raise WorldError("bad_snapshot", f"the engine's part of it is not sound: {error!r}") from error
        if not sound:
            raise WorldError("bad_snapshot", "the engine's part of it has numbers that no body can have")

    def _find_clusters(self) -> list[list[_Body]]:
        """Returns the bodies, those that joints hold together in one list; kept until the structure changes."""
        if self._clusters is None:
            cluster_of = {number: [body] for number, body in self._bodies.items()}
            for joint in self._joints.values():
                ours, theirs = cluster_of[joint.body1], cluster_of[joint.body2]
                if ours is not theirs:
                    ours.extend(theirs)
                    cluster_of.update((b.number, ours) for b in theirs)
            self._clusters = [c for number, c in cluster_of.items() if c[0].number == number]
        return self._clusters

    def _kick(self, b: _Body) -> None:
        """Adds the impulses to a body's own motion; `_advance` shares it among the cluster."""
        b.linear = _add(b.linear, b.impulse, 1.0 / b.spec.mass)
        if b.angular_impulse != ZERO:
            b.angular = _add(b.angular, _vector(_apply(_inverse(_inertia(b)), b.angular_impulse)))

    def _advance(self, cluster: list[_Body], h: float) -> None:
        """Moves a cluster by one engine step: the parabola, the rotation, then the ground."""
        first = cluster[0]
        mass, force, velocity = first.spec.mass, first.force, first.linear
        if len(cluster) > 1:
            mass = total(b.spec.mass for b in cluster)
            force = _vector(np.sum([b.force for b in cluster], axis=0))
            velocity = _mean([b.linear for b in cluster], cluster, mass)
        acceleration = _add(self._scene.gravity, force, 1.0 / mass)
        shift = _add(_add(ZERO, velocity, h), acceleration, h * h / 2)
        velocity = _add(velocity, acceleration, h)
        spins = any(b.angular != ZERO or b.torque != ZERO for b in cluster)
        if spins or (len(cluster) > 1 and any(b.force != ZERO or b.linear != first.linear for b in cluster)):
            self._turn(cluster, mass, velocity, h)
        else:
            for b in cluster:
                b.linear = velocity
        for b in cluster:
            b.position, b.ground_force = _add(b.position, shift), 0.0
        depth = max(_reach(b) - b.position[1] for b in cluster)
        if self._scene.ground and depth > 0.0:
            self._land(cluster, depth, velocity, acceleration[1], mass, h)

    def _turn(self, cluster: list[_Body], mass: float, velocity: Vector, h: float) -> None:
        """Turns a cluster about its centre of mass by the angular velocity halfway (the midpoint rule)."""
        centre = _mean([b.position for b in cluster], cluster, mass)
        inertia, spin, torque = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
        for b in cluster:
            arm, own = np.subtract(b.position, centre), _inertia(b)
            inertia += own + b.spec.mass * ((arm * arm).sum() * np.eye(3) - np.outer(arm, arm))
            spin += _apply(own, b.angular) + b.spec.mass * np.array(cross(_vector(arm), b.linear))
            torque += np.add(b.torque, cross(_vector(arm), b.force))
        yielding = _inverse(inertia)
        half = _matrix(_rotation(_apply(yielding, spin), h / 2))
        turn = _rotation(_apply(half, _apply(yielding, _apply(half.T, spin + torque * h / 2))), h)
        matrix = _matrix(turn)
        angular = _vector(_apply(matrix, _apply(yielding, _apply(matrix.T, spin + torque * h))))
        for b in cluster:
            reach = _vector(_apply(matrix, np.subtract(b.position, centre)))
            b.position, b.quaternion = _add(centre, reach), normalize(multiply(turn, b.quaternion))
            b.linear, b.angular = _add(velocity, cross(angular, reach)), angular

    def _land(self, cluster: list[_Body], depth: float, velocity: Vector, fall: float, mass: float, h: float) -> None:
        """Puts a cluster that is `depth` in the ground onto it: a bounce, Coulomb friction, and no more turning."""
        touching = [b for b in cluster if _reach(b) - b.position[1] >= depth - 1e-9]
        x, y, z = velocity
        if y < 0.0:
            # The speed at the moment of touch, by the energy: at the step's end it has fallen on for `depth`.
            up = max(b.spec.restitution for b in touching) * math.sqrt(max(0.0, y * y + 2.0 * fall * depth))
            up = up if up > -fall * h else 0.0  # else it would be back within the next step, for ever
            grip = max(b.spec.friction for b in touching) * (up - y)
            kept = max(0.0, 1.0 - grip / (math.hypot(x, z) or math.inf))
            velocity = (x * kept, up, z * kept)
            for b in touching:
                b.ground_force = mass * (up - y) / h / len(touching)
        for b in cluster:
            b.position, b.linear, b.angular = _add(b.position, (0.0, depth, 0.0)), velocity, ZERO


class BallisticBackend(Backend):
    """The engine as `nmes serve --backend ballistic` finds it."""

    name = "ballistic"
    capabilities = frozenset(
        {"joint.fixed", "joint.several", "friction", "restitution", "contacts", "snapshot"}
        | {"shape.sphere", "shape.capsule", "shape.cylinder"}
    )

    def version(self) -> str:
        """Returns the version of this engine."""
        return "1.0"

    def fingerprint(self) -> dict[str, str]:
        """Returns the versions and the SHA-256 of this file."""
        # numpy turns the bodies, so its version counts as well as our own code.
        source = sha256(Path(__file__).read_bytes()).hexdigest()
        return {"version": self.version(), "numpy": np.__version__, "binary_sha256": source}

    def create(self, scene: SceneSpec) -> BallisticSimulation:
        """Creates an empty scene."""
        return BallisticSimulation(scene)


def _vector(values: Any) -> Vector:
    x, y, z = values
    return float(x), float(y), float(z)


def _add(a: Vector, b: Vector, scale: float = 1.0) -> Vector:
    return a[0] + b[0] * scale, a[1] + b[1] * scale, a[2] + b[2] * scale


def _mean(vectors: list[Vector], cluster: list[_Body], mass: float) -> Vector:
    """Returns the mean of one vector a body, by mass."""
    return _vector((np.array([[b.spec.mass / mass] for b in cluster]) * vectors).sum(axis=0))


def _tuples(fields: dict[str, Any]) -> dict[str, Any]:
    return {name: tuple(value) if isinstance(value, list) else value for name, value in fields.items()}


def _apply(matrix: Array, vector: Any) -> Array:
    """Returns a matrix times a vector; unlike BLAS, in the same order of sums on every processor."""
    return np.asarray((matrix * vector).sum(axis=1))


def _inverse(matrix: Array) -> Array:
    """Returns the inverse of a matrix (3, 3), by Cramer's rule."""
    a, b, c = matrix
    columns = np.array([np.cross(b, c), np.cross(c, a), np.cross(a, b)])
    return np.asarray(columns.T / (a * columns[0]).sum())


def _sound(b: _Body) -> bool:
    spec = b.spec
    wrench = (*b.force, *b.torque, *b.impulse, *b.angular_impulse, b.ground_force)
    state = (*b.position, *b.quaternion, *b.linear, *b.angular, *wrench, spec.friction, spec.restitution)
    qx, qy, qz, qw = b.quaternion
    turn = qx * qx + qy * qy + qz * qz + qw * qw
    solid = all(0.0 < x < TOO_FAR for x in (*spec.size, spec.mass))
    solid = solid and spec.shape in SHAPES and misfit(spec.shape, spec.size) is None
    return solid and all(abs(x) < TOO_FAR for x in state) and abs(turn - 1.0) < 1e-6


def _matrix(q: Quaternion) -> Array:
    x, y, z, w = q
    return np.array(
        [
            (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        ]
    )


def _rotation(velocity: Array, time: float) -> Quaternion:
    """Returns the rotation that a constant angular velocity makes in a time."""
    speed = math.hypot(*velocity)
    factor = math.sin(speed * time / 2) / speed if speed else 0.0
    return (*_vector(velocity * factor), math.cos(speed * time / 2))


def _inertia(b: _Body) -> Array:
    """Returns a body's moment of inertia about its centre, in world directions."""
    turn = _matrix(b.quaternion)
    if b.spec.shape == "box":
        x, y, z = (edge * edge for edge in b.spec.size)
        own = turn * (np.array((y + z, x + z, x + y)) * b.spec.mass / 12.0)
    else:
        own = turn * (np.array(moments(b.spec.shape, b.spec.size)) * b.spec.mass)
    return np.asarray((own[:, None] * turn).sum(axis=2))


def _reach(b: _Body) -> float:
    """Returns how far a body reaches below its centre."""
    if b.spec.shape != "box":
        return reach(b.spec.shape, b.spec.size, rotate(conjugate(b.quaternion), (0.0, -1.0, 0.0)))
    (x, y, z, w), (a, b_, c) = b.quaternion, b.spec.size
    return abs(x * y + w * z) * a + abs(0.5 - x * x - z * z) * b_ + abs(y * z - w * x) * c
