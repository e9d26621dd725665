"""The bodies and joints of a scene, and the kinematic trees that they make.

The joint graph's spanning forest becomes MuJoCo's kinematic trees; the joints that are left over close loops. Each
joint keeps its own frames, fixed when it is made, in the direction from `body1` to `body2`: its coordinate means the
same whichever way the tree happens to run, so re-rooting a structure never flips a sign or moves a zero.

Invariant: the forest is stable, adding a joint never takes another one out of a tree.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from math import sqrt
from typing import Any

from nmes.backend import BodySpec, BodyState, JointParams, JointSpec, Quaternion, Vector
from nmes.backend.rotation import conjugate, cross, minus, multiply, normalize, rotate
from nmes.backend.shapes import Shape

__all__ = ["Body", "Forest", "Joint", "perpendicular_axes", "relative_orientation", "spanning_forest"]


def _hash(*parts: object) -> int:
    # By their texts: the names and fields of the dataclasses below are part of every digest.
    return int.from_bytes(hashlib.blake2b(repr(parts).encode(), digest_size=16).digest(), "little")


@dataclass(slots=True)
class Body:
    """A body as the model needs it; see `nmes.backend.BodySpec` for units and shapes."""

    number: int
    size: Vector
    mass: float
    friction: float
    restitution: float
    frozen: bool
    group: int = field(default=0, repr=False)
    shape: Shape = field(default="box", repr=False)

    @classmethod
    def from_spec(cls, number: int, spec: BodySpec) -> Body:
        """Returns the body that a spec describes."""
        return cls(number, spec.size, spec.mass, spec.friction, spec.restitution, spec.frozen, spec.group, spec.shape)

    @classmethod
    def from_json(cls, fields: dict[str, Any]) -> Body:
        """Returns the body of a snapshot."""
        return cls(**{**fields, "size": tuple(fields["size"])})

    def to_json(self) -> dict[str, Any]:
        """Returns the fields for a snapshot: `group` only where it is in one, `shape` only where it is no box."""
        fields = {name: getattr(self, name) for name in self.__slots__}
        left_out = [*([] if self.group else ["group"]), *(["shape"] if self.shape == "box" else [])]
        return {name: value for name, value in fields.items() if name not in left_out}

    @property
    def identity(self) -> int:
        """A hash of all that MuJoCo's state does not hold."""
        later = [*([self.group] if self.group else []), *([] if self.shape == "box" else [self.shape])]
        return _hash("body", self.number, self, *later)


@dataclass(slots=True)
class Joint:
    """A joint in its bodies' own frames, in one canonical direction.

    Attributes:
        anchor1: Anchor in the frame of body1, m; `anchor2` the same point in the frame of body2.
        axis2: Axis in the frame of body2 (where body2 is turned about the axis, it is the same in both).
        zero: Orientation of body2 relative to body1 at coordinate zero.
        held_at: The coordinate of a hinge or slide that is in no model, since both its bodies are frozen: poses do not
            tell whole turns. 0 while a model has it.
    """

    number: int
    kind: str
    body1: int
    body2: int
    anchor1: Vector
    anchor2: Vector
    axis2: Vector
    zero: Quaternion
    params: JointParams
    held_at: float = field(default=0.0, repr=False)

    @classmethod
    def from_spec(cls, number: int, spec: JointSpec, one: BodyState, two: BodyState) -> Joint:
        """Returns the joint that a spec describes, for bodies in these states, which become its zero."""
        back1, back2 = conjugate(one.quaternion), conjugate(two.quaternion)
        return cls(
            number=number,
            kind=spec.kind,
            body1=spec.body1,
            body2=spec.body2,
            anchor1=rotate(back1, minus(spec.anchor, one.position)),
            anchor2=rotate(back2, minus(spec.anchor, two.position)),
            axis2=rotate(back2, spec.axis),
            zero=normalize(relative_orientation(one.quaternion, two.quaternion)),
            params=spec.params,
        )

    @classmethod
    def from_json(cls, fields: dict[str, Any]) -> Joint:
        """Returns the joint of a snapshot."""
        vectors = {name: tuple(value) for name, value in fields.items() if isinstance(value, list)}
        params: dict[str, Any] = dict(fields["params"])
        if params["limits"] is not None:
            params["limits"] = tuple(params["limits"])
        return cls(**{**fields, **vectors, "params": JointParams(**params)})

    def to_json(self) -> dict[str, Any]:
        """Returns the fields for a snapshot: `held_at` only where it is not 0."""
        fields = {name: getattr(self, name) for name in self.__slots__}
        return {name: value for name, value in fields.items() if name != "held_at" or value}

    @property
    def identity(self) -> int:
        """A hash of all that MuJoCo's state does not hold."""
        # A motor's targets are in the state as controls; leaving them out here keeps setting one cheap.
        plain = replace(self, params=replace(self.params, target_velocity=0.0, target_position=0.0))
        return _hash("joint", plain, *([self.held_at] if self.held_at else []))

    @property
    def form(self) -> str:
        """The kind of joint in the model: `fixed`, `hinge`, `slide`, `ball`, or `cone`, a ball with limits.

        A cone is three hinges, two that swing the axis and one that twists about it, so that swing and twist have
        limits of their own; it has no freedom to lose while the swing stays under a right angle.
        """
        if self.kind in ("pin", "conetwist"):
            return "ball" if self.params.limits is None else "cone"
        return self.kind


@dataclass(slots=True)
class Forest:
    """The kinematic trees, and the joints that close loops between or within them.

    Attributes:
        trees: The bodies of each tree by its root; parents come before their children.
        parent: Each body that is not a root, with its parent and the joint between them.
        loops: The joints that are part of no tree.
    """

    trees: dict[int, list[int]] = field(default_factory=dict)
    parent: dict[int, tuple[int, Joint]] = field(default_factory=dict)
    loops: list[Joint] = field(default_factory=list)


class _Groups:
    """Bodies in disjoint groups, each known by one leader (union-find)."""

    def __init__(self, bodies: Iterable[int]) -> None:
        self._leader = {body: body for body in bodies}

    def leader(self, body: int) -> int:
        leader = self._leader
        while leader[body] != body:
            leader[body] = leader[leader[body]]
            body = leader[body]
        return body

    def merge(self, body: int, other: int) -> bool:
        """Makes two groups one; returns False where they are one already."""
        one, two = self.leader(body), self.leader(other)
        self._leader[two] = one
        return one != two


def spanning_forest(bodies: dict[int, Body], joints: Iterable[Joint]) -> Forest:
    """Returns the spanning forest: older joints first, roots at the frozen bodies, else at the oldest one.

    Frozen bodies count as one, the world; a joint between two of them does nothing and is left out.
    """
    frozen = [number for number, body in bodies.items() if body.frozen]
    groups = _Groups(bodies)
    for number in frozen[1:]:
        groups.merge(frozen[0], number)
    forest = Forest()
    neighbours: dict[int, list[tuple[int, Joint]]] = {number: [] for number in bodies}
    for joint in joints:
        one, two = joint.body1, joint.body2
        if bodies[one].frozen and bodies[two].frozen:
            continue
        if groups.merge(one, two):
            neighbours[one].append((two, joint))
            neighbours[two].append((one, joint))
        else:
            forest.loops.append(joint)
    seen: set[int] = set()
    for root in [*frozen, *bodies]:
        if root not in seen:
            seen.add(root)
            forest.trees[root] = [root, *_grow(forest, root, neighbours, bodies, seen)]
    return forest


def _grow(
    forest: Forest,
    root: int,
    neighbours: dict[int, list[tuple[int, Joint]]],
    bodies: dict[int, Body],
    seen: set[int],
) -> Iterator[int]:
    """Yields the bodies that hang on a root, depth first, and enters their parents in the forest."""
    stack = [root]
    while stack:
        parent = stack.pop()
        for child, joint in neighbours[parent]:
            if child not in seen and not bodies[child].frozen:
                seen.add(child)
                forest.parent[child] = (parent, joint)
                stack.append(child)
                yield child


def perpendicular_axes(axis: Vector) -> tuple[Vector, Vector]:
    """Returns two directions that make a right-handed frame with a unit axis, always the same for the same axis."""
    least = min(range(3), key=lambda i: abs(axis[i]))
    u = cross(axis, (float(least == 0), float(least == 1), float(least == 2)))
    length = sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    u = (u[0] / length, u[1] / length, u[2] / length)
    return u, cross(axis, u)


def relative_orientation(q1: Quaternion, q2: Quaternion) -> Quaternion:
    """Returns the orientation of 2 in the frame of 1."""
    return multiply(conjugate(q1), q2)
