"""Tasks with roles: matches of several creatures in one world, as documents.

Hides how a document and a seed become a place, a target and limits for the creature in each role. A task runs nothing:
`nmes.evaluation.match` does.

Invariants: all that differs between two matches of a task and the same creatures follows from their seeds; a task that
could be loaded has only expressions that can be run.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from hashlib import blake2b
from typing import Any, Final, TypeAlias

from nmes.backend import Vector, load_backend
from nmes.backend.rotation import multiply, quaternion_from_euler, rotate, total
from nmes.errors import DocumentError
from nmes.evaluation.setting import (
    MATCHES,
    Setting,
    changing,
    complete_task,
    crossed_bounds,
    infinite,
    read_limits,
    read_task,
)
from nmes.evaluation.task import Task
from nmes.genome import Genome
from nmes.genome.body import Body
from nmes.genome.limits import Limits
from nmes.genome.sensors import OF_OTHERS
from nmes.objective import FOLDS, FUNCTIONS, QUANTITIES, Cast, Objective, Quantity
from nmes.schemas.documents import JsonObject, parse_document
from nmes.schemas.notebook import card
from nmes.variation import Requirements

__all__ = ["METADATA", "MatchTask", "MatchTaskLike", "Role", "load_task"]

MatchTaskLike: TypeAlias = "MatchTask | Mapping[str, Any] | str | os.PathLike[str]"
"""A task with roles: itself, its document, its file, or the name of one that ships."""
METADATA: Final = "nmes.match"
"""The metadata record of a match's recording: its `task`, its `seed`, and `genomes`, the hash of each role's."""
_NAME: Final = re.compile("[a-z][a-z0-9_]*")
_WORDS: Final = {*FOLDS, *FUNCTIONS, *(name.partition(".")[0] for name in QUANTITIES), "cube", "true", "false"}


@dataclass(frozen=True, slots=True)
class Role:
    """The part of one creature in a match.

    Attributes:
        name: The creature's in the world; it goes before quantities in expressions.
        position: Where it is set down, m: its centre of mass above x and z, its lowest point at y.
        heading: Which way its x axis points then, rad: turned by so much about y.
        limits: What it may be and do.
        objective: What a match is worth to it.
        target: Another role, a prop, or a point, m; None: it has none.
    """

    name: str
    position: Vector
    heading: float
    limits: Limits
    objective: Objective
    target: Vector | str | None

    @property
    def bounds(self) -> dict[str, float]:
        """The limits of what it does, as `first_beyond` takes them: what is not limited is infinite."""
        return infinite(self.limits)


class MatchTask(Setting):
    """A task with roles.

    Attributes:
        roles: The parts, by name, in the order in which their creatures are made and driven.
        interchangeable: Whether all roles are the same part, on different sides.
        margin: By how much two scores must differ for one to be better.
    """

    def __init__(self, document: Mapping[str, Any]) -> None:
        """Makes a task of a document.

        Args:
            document: As `schemas/task.json` says, with roles.

        Raises:
            DocumentError: It is not, with all that is wrong.
        """
        document = complete_task(document)
        if "roles" not in document:
            how = "this is a task for one creature, such as `nmes eval GENOME --task T` takes"
            raise DocumentError([("roles", f"there are none: {how}")])
        parts = document["roles"]
        cast = Cast(tuple(role["name"] for role in parts), tuple(prop["id"] for prop in document["props"]))
        objectives = {f"roles/{index}/objective": role["objective"] for index, role in enumerate(parts)}
        super().__init__(document, objectives, _problems(document), cast)
        self.roles = {
            part["name"]: _role(part, document["limits"], objective)
            for part, objective in zip(parts, self._objectives, strict=True)
        }
        strangers = {q.cube for q in self.needs if q.role is None and q.cube is not None} - {*self.prop_ids()}
        if strangers:
            raise DocumentError([("props", f"expressions name a prop {min(strangers)!r}, and there is none")])
        self.interchangeable: bool = document.get("interchangeable", False)
        self.margin = float(document.get("margin", 0.0))

    @classmethod
    def load(cls, source: MatchTaskLike) -> MatchTask:
        """Returns the task that is meant.

        Args:
            source: A MatchTask, which is returned as it is; a document; or a path of a file or, where there is none and
                it is such a name, one of the tasks with roles that ship with the package.

        Raises:
            DocumentError: There is neither, it cannot be read, it has no roles, or it is not as it must be.
        """
        if isinstance(source, MatchTask):
            return source
        return cls(source if isinstance(source, Mapping) else parse_document(read_task(source)))

    @staticmethod
    def names() -> tuple[str, ...]:
        """Returns the names of the tasks with roles that ship with the package, sorted."""
        return MATCHES.names()

    def _repr_html_(self) -> str:
        """Returns its card in a notebook, HTML."""
        facts = {
            "what": self.description,
            **{f"score of {role.name}": role.objective.text for role in self.roles.values()},
            "time": f"{self.duration:g} s, {self.tick_rate} ticks a second",
            "seeds": ", ".join(map(str, self.seeds)),
            "ends": ", ".join(f"{end['name']}: {end['when']}" for end in self.document["ends"]) or None,
            "hash": self.hash[:16],
        }
        return card(f"Match {self.name}", facts)

    @property
    def needs(self) -> tuple[Quantity, ...]:
        """The quantities that the objectives and the conditions name."""
        expressions = [*(role.objective for role in self.roles.values()), *(condition for _, condition in self.ends)]
        return tuple(dict.fromkeys(quantity for expression in expressions for quantity in expression.needs))

    @property
    def touchy(self) -> bool:
        """Whether a quantity is about what touches what of a match, beyond the number of contacts."""
        return any(quantity.name.startswith(("touching.", "after_touch.")) for quantity in self.needs)

    @property
    def counts_contacts(self) -> bool:
        """Whether a quantity is about the number of a body's contacts."""
        return any(quantity.name == "contacts" for quantity in self.needs)

    def check(self, role: str, body: Body) -> list[str]:
        """Returns the reasons why a body may not play a role, in words; none if it may."""
        return [*self.roles[role].limits.check(body), *self._unsuited(role, body)]

    def requirements(self, role: str) -> Requirements:
        """What a body must be like to play a role, for whoever varies genomes."""
        planar = load_backend(self._config["backend"]).dims == 2
        channels = tuple(
            (name, channel.get("size", 1)) for name, channel in sorted(self._config.get("channels", {}).items())
        )
        senses = (*(OF_OTHERS if len(self.roles) > 1 else ()), *self.senses)
        return Requirements(
            self.roles[role].limits, planar, partial(self._unsuited, role), senses, channels, self.shapes
        )

    def _unsuited(self, role: str, body: Body) -> list[str]:
        """Returns the reasons why a body within the limits may not play a role."""
        ids = {cube.id for cube in body.cubes}
        asked = {quantity.cube for quantity in self.needs if quantity.role == role and quantity.cube is not None}
        why = changing(body)
        reasons = [] if why is None else [f"{why}, and in a match bodies keep their parts"]
        reasons += self.too_stiff(body)
        return reasons + [f"the task is about a cube {name!r}, which the body has not" for name in sorted(asked - ids)]

    def sides(self, seed: int) -> list[tuple[int, ...]]:
        """Returns who plays which role in the matches of a seed: of each match, the creature's number for each role.

        Where roles are interchangeable there is a match for each of them, so that everybody is in every role once; who
        begins where is drawn from the seed. Else there is one, and the creatures are in the order of the roles.
        """
        count = len(self.roles)
        if not self.interchangeable:
            return [tuple(range(count))]
        drawn = int.from_bytes(blake2b(f"{self.name}:{seed}:sides".encode(), digest_size=8).digest(), "little") % count
        return [tuple((place + drawn + turn) % count for place in range(count)) for turn in range(count)]

    def entry(self, seed: int, genomes: Mapping[str, Genome]) -> list[JsonObject]:
        """Returns the commands that put the props into the world and set the creatures down, each in its role.

        Args:
            seed: The match's.
            genomes: The creatures, by role.
        """
        commands = [self.standing(prop, seed) for prop in self.document["props"]]
        for role in self.roles.values():
            commands += self._set_down(role, seed, genomes)
        return commands

    def _set_down(self, role: Role, seed: int, genomes: Mapping[str, Genome]) -> Iterator[JsonObject]:
        genome, vary = genomes[role.name], self.document["vary"]
        body = genome.body
        root = body.cubes[0]
        yaw = role.heading + self.draw(seed, "yaw", vary["yaw"])
        turn = quaternion_from_euler(0.0, yaw, 0.0)
        # It is turned about its root, and its centre of mass is to be in its place after that.
        arm = _point(
            [
                total(cube.mass * (cube.position[axis] - root.position[axis]) for cube in body.cubes) / body.mass
                for axis in range(3)
            ]
        )
        x, _, z = rotate(turn, arm) if yaw else arm
        height = self.draw(seed, "drop", vary["drop"]) - body.bounds[0][1]
        spawn: JsonObject = {
            "type": "spawn_creature",
            "genome": genome.document,
            "name": role.name,
            "position": [
                role.position[0] - root.position[0] - x,
                role.position[1] + height,
                role.position[2] - root.position[2] - z,
            ],
        }
        if "flaws" in self.document:
            spawn["flaws"] = self.document["flaws"]
        if role.target is not None:
            spawn["target"] = self._aim(role.target, genomes)
        yield spawn
        if yaw:
            turned = list(multiply(turn, root.quaternion))
            yield {"type": "set_cube_state", "cube_name": f"{role.name}.{root.id}", "rotation": turned}

    def _aim(self, target: Vector | str, genomes: Mapping[str, Genome]) -> list[float] | str:
        """Returns a target as the command that makes a creature has it."""
        if not isinstance(target, str):
            return list(target)
        return f"{target}.{genomes[target].body.cubes[0].id}" if target in self.roles else target


def load_task(source: str | os.PathLike[str]) -> Task | MatchTask:
    """Returns the task of a file or, where there is none, the one of that name that ships, with roles or without.

    Raises:
        DocumentError: There is neither, it cannot be read, or it is not as it must be.
    """
    document = parse_document(read_task(source))
    return MatchTask(document) if isinstance(document, Mapping) and "roles" in document else Task(document)


def _role(part: JsonObject, limits: JsonObject, objective: Objective) -> Role:
    target = part.get("target")
    x, y, z = map(float, part["position"])
    aim: Vector | str | None = target if target is None or isinstance(target, str) else _point(target)
    own = read_limits({**limits, **part["limits"]})
    return Role(part["name"], (x, y, z), float(part["heading"]), own, objective, aim)


def _point(numbers: list[float]) -> Vector:
    x, y, z = map(float, numbers)
    return x, y, z


def _problems(document: JsonObject) -> Iterator[tuple[str, str]]:
    """Yields what is wrong with a sound document as a task with roles, each with its place."""
    for name in ("objective", "target"):
        if name in document:
            yield name, f"in a task with roles each has its own: roles/0/{name}"
    names = [role["name"] for role in document["roles"]]
    things = [prop["id"] for prop in document["props"]]
    for index, role in enumerate(document["roles"]):
        if role["name"] in names[:index]:
            yield f"roles/{index}/name", f"there is a role {role['name']!r} already"
        if role["name"] in _WORDS:
            yield f"roles/{index}/name", f"expressions have another meaning for {role['name']!r}"
        target = role.get("target")
        if isinstance(target, str) and (target == role["name"] or target not in (*names, *things)):
            yield f"roles/{index}/target", f"expected another role, a prop or a point, got {target!r}"
    for index, prop in enumerate(document["props"]):
        yield from crossed_bounds((f"props/{index}/away/{name}", value) for name, value in prop.get("away", {}).items())
        yield from ((f"props/{index}/{name}", problem) for name, problem in _prop_problems(prop, names))


def _prop_problems(prop: JsonObject, roles: list[str]) -> Iterator[tuple[str, str]]:
    if not _NAME.fullmatch(prop["id"]) or prop["id"] in _WORDS or prop["id"] in roles:
        yield (
            "id",
            "in a task with roles it is small letters, digits and '_', a letter first, and no word of expressions",
        )
    if "position" not in prop:
        yield "position", "is missing: in a task with roles props stand in the world"
    if "hidden" in prop:
        yield "hidden", "in a task with roles no prop is a target by itself"
    if prop["target"]:
        yield "target", "in a task with roles it is a role that names its target: roles/0/target"
    if prop["hinge"] or any(prop["lean"]):
        yield "hinge" if prop["hinge"] else "lean", "a prop does that upon a creature: only without roles"
