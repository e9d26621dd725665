"""What a task for one creature and one with roles have in common: a world, a time, seeds, and what ends an episode.

Hides how a document and a seed become a world's config, and how what a seed decides is drawn: by hashing, and so the
same everywhere.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from hashlib import blake2b
from typing import Any, Final

from nmes.backend import load_backend
from nmes.backend.shapes import Shape
from nmes.errors import DocumentError, NmesError
from nmes.genome.body import Body
from nmes.genome.limits import Limits
from nmes.genome.sensors import NEEDED
from nmes.genome.springs import too_stiff
from nmes.objective import Cast, Condition, Objective
from nmes.protocol import complete_config
from nmes.schemas.documents import (
    JsonObject,
    ShippedDocuments,
    canonical_hash,
    check,
    compile_schema,
    complete,
    plain,
)

__all__ = [
    "MATCHES",
    "SHIPPED",
    "Setting",
    "changing",
    "complete_task",
    "crossed_bounds",
    "infinite",
    "limit_words",
    "read_limits",
    "read_task",
    "task_identity",
]

SHIPPED: Final = ShippedDocuments("task", "nmes.evaluation", "tasks")
"""The tasks for one creature that ship with the package."""
MATCHES: Final = ShippedDocuments("task", "nmes.evaluation", "matches")
"""The tasks with roles that ship with the package."""
_TASK: Final = compile_schema("task.json")
# Of the world's config.
_OURS: Final = {
    **dict.fromkeys(("name", "seed", "mode", "rate"), "a task does not say this: it is the evaluation's"),
    "life": "creatures on a task neither starve nor breed: an ecosystem is a world that is served",
    "roles": "who may do what is for worlds that are served; here nobody comes",
}
_FRICTION: Final = (0.5, 2)  # of cubes that set their own, where a task has no limit for it
_TICKS, _STEPS = 100_000, 1_000_000  # ticks and engine steps of an episode: its rows are kept, and somebody waits


class Setting:
    """What is set for an episode, whoever takes part.

    Attributes:
        document: What it was made from, with every default filled in.
        name: Its name.
        description: What is asked, for people.
        duration: Length of an episode, s.
        seeds: One episode each.
        ends: What ends an episode early, and what it is called then.
        unit: The unit of a score, for people; empty where it has none.
        hash: SHA-256 of the document but for the unit, defaults filled in, in canonical form, 64 hexadecimal digits:
            equal documents (up to white space, the order of keys, `10.0` for `10` and defaults) have equal hashes.
    """

    def __init__(
        self,
        document: JsonObject,
        objectives: Mapping[str, str],
        problems: Iterable[tuple[str, str]],
        cast: Cast | None = None,
    ) -> None:
        """Reads what is common.

        Args:
            document: As `complete_task` returns it.
            objectives: The texts of the objectives, by their places in the document.
            problems: What is wrong besides, each with its place.
            cast: Whom expressions may name, where there are roles.

        Raises:
            DocumentError: Something is wrong, with all of it.
        """
        self.document = document
        self._objectives, self.ends = _expressions(document, objectives, problems, cast)
        self._config = complete_config(document["world"])
        self.name: str = document["name"]
        self.description: str = document["description"]
        self.duration = float(document["duration"])
        self.seeds: tuple[int, ...] = tuple(document["seeds"])
        self.unit: str = document.get("unit", "")
        self.hash = canonical_hash(task_identity(document))
        ticks = self.settle_limit_ticks + self.ticks
        for count, most, what in ((ticks, _TICKS, "ticks"), (ticks * self._config["substeps"], _STEPS, "engine steps")):
            if count > most:
                raise DocumentError(
                    [("duration", f"makes with settle_limit episodes of {count:,} {what}, at most {most:,}")]
                )

    @property
    def tick_rate(self) -> int:
        """Ticks in a second."""
        rate: int = self._config["tick_rate"]
        return rate

    @property
    def substeps(self) -> int:
        """Engine steps in a tick."""
        substeps: int = self._config["substeps"]
        return substeps

    @property
    def ticks(self) -> int:
        """Ticks of an episode that is not ended early."""
        return max(1, round(self.duration * self.tick_rate))

    @property
    def settle_ticks(self) -> int:
        """Ticks before the start, at the least: the creatures must be at rest."""
        return round(float(self.document["settle"]) * self.tick_rate)

    @property
    def settle_limit_ticks(self) -> int:
        """Ticks before the start, at the most."""
        return round(float(self.document["settle_limit"]) * self.tick_rate)

    def too_stiff(self, body: Body) -> list[str]:
        """Returns the reasons why the engine cannot integrate the springs and dampers of a body; none if it can.

        Of the integrators that a world's `engine` may name `rk4` alone takes dampers as explicitly as springs.
        """
        staged = self._config["engine"].get("integrator") == "rk4"
        return too_stiff(body, 1.0 / (self.tick_rate * self.substeps), dampers=staged)

    def draw(self, seed: int, what: str, bounds: Sequence[float]) -> float:
        """Draws a number, evenly: the same on every machine."""
        part = (
            int.from_bytes(blake2b(f"{self.name}:{seed}:{what}".encode(), digest_size=8).digest(), "little") / 2.0**64
        )
        low, high = bounds
        return float(low + part * (high - low))

    def world_config(self, seed: int) -> JsonObject:
        """Returns the config of an episode's world: in lockstep, with the task's name."""
        config = {**self._config, "name": self.name, "seed": seed, "mode": "lockstep"}
        if "friction" in self.document["vary"]:
            config["friction"] = self.draw(seed, "friction", self.document["vary"]["friction"])
        return config

    @property
    def surface(self) -> dict[str, float]:
        """The friction and restitution of cubes that say nothing else, where all its worlds have the same."""
        named = {"friction", "restitution"} - self.document["vary"].keys()
        return {name: float(self._config[name]) for name in sorted(named)}

    @property
    def senses(self) -> tuple[str, ...]:
        """The types of sensors of use here, besides those that are of use everywhere, that the engine has."""
        able = load_backend(self._config["backend"]).capabilities
        return tuple(kind for kind in self.document.get("senses", ()) if kind not in NEEDED or NEEDED[kind][0] in able)

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """The shapes that parts of bodies may come to have here, besides boxes, that the engine has."""
        able = load_backend(self._config["backend"]).capabilities
        return tuple(shape for shape in self.document.get("shapes", ()) if f"shape.{shape}" in able)

    def standing(self, prop: JsonObject, seed: int) -> JsonObject:
        """Returns the command that puts a prop with a `position` into the world, upon its foot, as a seed draws it."""
        x, y, z = map(float, prop["position"])
        if "away" in prop:
            far, bearing = (
                self.draw(seed, f"{prop['id']} {what}", prop["away"][what]) for what in ("distance", "bearing")
            )
            x, z = x + far * math.cos(bearing), z - far * math.sin(bearing)
        return {
            "type": "spawn_cube",
            "cube_name": prop["id"],
            "position": [x, y + prop["size"][1] / 2.0, z],
            "size": prop["size"],
            "mass": prop["mass"],
            "color": prop["color"],
            **({"frozen": True} if prop.get("frozen") else {}),
            "list": False,
        }

    def prop_ids(self) -> list[str]:
        """Returns the ids of the props, as expressions have them."""
        return [prop["id"] for prop in self.document["props"]]


def read_task(name: str | os.PathLike[str]) -> bytes:
    """Returns the bytes of the file at a path or, where there is none, of the task of that name that ships.

    Raises:
        DocumentError: There is neither, or the file cannot be read, or is too large.
    """
    path = os.fspath(name)
    return (MATCHES if path in MATCHES.names() else SHIPPED).read(path)


def task_identity(document: Mapping[str, Any]) -> JsonObject:
    """Returns a task's document without the unit, which changes no figure: the part that its hash is of."""
    return {name: value for name, value in document.items() if name != "unit"}


def complete_task(document: Mapping[str, Any]) -> JsonObject:
    """Returns a sound copy with defaults filled in, but for the world's, which an engine may add to.

    Raises:
        DocumentError: It is not as the schema says.
    """
    copied = plain(document)
    check(_TASK, copied)
    full = complete(_TASK.schema, copied)
    full["world"] = copied.get("world", {})
    full["seeds"] = [int(seed) for seed in full["seeds"]]
    return full


def changing(body: Body) -> str | None:
    """Returns why the parts of a body may come and go by themselves, in words; None where they do not."""
    if body.later or body.development:
        return "the body has parts that are later, or rules of development"
    return None


def _judged(limits: Mapping[str, Any]) -> JsonObject:
    """Returns the limits of a task's document with that of friction, by which creatures are judged where it has none.

    It is not among the schema's defaults, which are part of a task's hash: tasks keep the hashes that they had before
    there was such a limit.
    """
    return {**limits, "friction": limits.get("friction", _FRICTION)}


def read_limits(limits: Mapping[str, Any]) -> Limits:
    """Returns the limits that a document with these ones means."""
    least, most = _judged(limits)["friction"]
    return Limits(**{**limits, "friction": (float(least), float(most))})


def limit_words(limits: Mapping[str, Any]) -> str:
    """Returns the limits that a document with these ones means, in words."""
    each = ((name, value if isinstance(value, Sequence) else [value]) for name, value in _judged(limits).items())
    return ", ".join(f"{name} {' to '.join(f'{bound:,}' for bound in bounds)}" for name, bounds in each)


def infinite(limits: Limits) -> dict[str, float]:
    """Returns the limits of what a creature does, as `first_beyond` takes them: what is not limited is infinite.

    A body may not stretch farther than one that is as large as may be at rest: from corner to corner of its box.
    """
    farthest = None if limits.size is None else limits.size * math.sqrt(3.0)
    bounds = {"energy": limits.energy, "speed": limits.speed, "spin": limits.spin, "size": farthest}
    return {name: math.inf if limit is None else limit for name, limit in bounds.items()}


def crossed_bounds(bounds: Iterable[tuple[str, Sequence[float]]]) -> Iterator[tuple[str, str]]:
    """Yields the problems of bounds, each with its place, that are the wrong way round."""
    for path, (low, high) in bounds:
        if low > high:
            yield path, f"expected the lowest first, got {low:g} before {high:g}"


def _expressions(
    document: JsonObject, objectives: Mapping[str, str], further: Iterable[tuple[str, str]], cast: Cast | None
) -> tuple[tuple[Objective, ...], tuple[tuple[str, Condition], ...]]:
    """Returns the objectives and the conditions of a sound document.

    Raises:
        DocumentError: One of them cannot be read, or something else is wrong that no schema sees.
    """
    problems = [*_problems(document), *further]
    read: list[Objective] = []
    ends: list[tuple[str, Condition]] = []
    for path, text in objectives.items():
        try:
            read.append(Objective(text, path, cast=cast))
        except NmesError as error:
            problems.append((path, error.message.removeprefix(f"{error.path}: ")))
    for index, end in enumerate(document["ends"]):
        path = f"ends/{index}/when"
        try:
            ends.append((end["name"], Condition(end["when"], path, cast=cast)))
        except NmesError as error:
            problems.append((path, error.message.removeprefix(f"{error.path}: ")))
    if problems:
        raise DocumentError(problems)
    return tuple(read), tuple(ends)


def _problems(document: JsonObject) -> Iterator[tuple[str, str]]:
    for name, why in _OURS.items():
        if name in document["world"]:
            yield f"world/{name}", why
    yield from crossed_bounds((f"vary/{name}", value) for name, value in document["vary"].items())
    limits = [("limits", document["limits"])]
    limits += [(f"roles/{index}/limits", role["limits"]) for index, role in enumerate(document.get("roles", ()))]
    yield from crossed_bounds((f"{path}/friction", each["friction"]) for path, each in limits if "friction" in each)
    if document["settle_limit"] < document["settle"]:
        yield "settle_limit", f"expected settle, {document['settle']:g}, or more, got {document['settle_limit']:g}"
    props = document["props"]
    for index, prop in enumerate(props):
        if prop["id"] in [other["id"] for other in props[:index]]:
            yield f"props/{index}/id", f"there is a prop {prop['id']!r} already"
