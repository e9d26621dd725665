"""Tasks: worlds, objectives and limits for creatures, as documents.

Hides how a document and a seed become a world, a place for a creature in it, the commands that set the scene, and the
row at which an episode ends. A task runs nothing: `nmes.evaluation.episode` does.

Invariants: all that differs between two episodes of a task follows from their seeds, drawn by hashing and so the same
everywhere; a task that could be loaded has only expressions that can be run.
"""

from __future__ import annotations

import math
import os
from collections.abc import Container, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np

from nmes.backend import Array, Quaternion, Vector, load_backend
from nmes.backend.rotation import multiply, quaternion_from_euler, rotate, total
from nmes.errors import DocumentError
from nmes.evaluation.setting import (
    SHIPPED,
    Setting,
    changing,
    complete_task,
    crossed_bounds,
    infinite,
    limit_words,
    read_limits,
    read_task,
)
from nmes.genome.body import Body, corners
from nmes.genome.development import outgrown
from nmes.genome.limits import Limits
from nmes.objective import Quantity
from nmes.objective.trajectory import Trajectory
from nmes.schemas.documents import JsonObject, parse_document
from nmes.schemas.notebook import card
from nmes.variation import Requirements

__all__ = ["CREATURE", "Place", "Task", "TaskLike"]

_GAP = 0.001  # m between a prop that lies and what it lies on, so that the engine does not find them overlapping
TaskLike: TypeAlias = "Task | Mapping[str, Any] | str | os.PathLike[str]"
"""A task: itself, its document, its file, or the name of one that ships."""
CREATURE: Final = "creature"
"""The name of the creature in a task's world; its cubes are `creature.ID`."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where one creature of several has its own scene in a task's world, and what things are called there.

    Attributes:
        creature: Its name.
        x: How far its scene is moved along x, m.
        z: How far along z, m.
    """

    creature: str = CREATURE
    x: float = 0.0
    z: float = 0.0

    def prop(self, name: str) -> str:
        """Returns a prop's name in the world: each creature has props of its own."""
        return name if self.creature == CREATURE else f"{self.creature}.{name}"

    def shifted(self, point: Sequence[float]) -> list[float]:
        """Returns a point of the task's world, m, where it is in this creature's."""
        x, y, z = point
        # To add nothing would make -0.0 another number.
        return [x + self.x if self.x else x, y, z + self.z if self.z else z]


ALONE: Final = Place()
"""The place of a creature that has the world for itself."""


class Task(Setting):
    """A task for one creature.

    Attributes:
        limits: What a creature may be and use.
        objective: What an episode is worth.
        duty: Whether episodes tell `Result.duty` too: no part of the document, since it changes nothing else.
    """

    def __init__(self, document: Mapping[str, Any]) -> None:
        """Makes a task of a document.

        Args:
            document: As `schemas/task.json` says.

        Raises:
            DocumentError: It is not, with all that is wrong.
        """
        document = complete_task(document)
        if "roles" in document:
            names = ", ".join(role["name"] for role in document["roles"])
            raise DocumentError([("roles", f"this is a match of {names}, and no task for one creature")])
        super().__init__(document, {"objective": document.get("objective", "0")}, _problems(document))
        self.limits = read_limits(document["limits"])
        (self.objective,) = self._objectives
        self.duty = False

    @classmethod
    def load(cls, source: TaskLike) -> Task:
        """Returns the task that is meant.

        Args:
            source: A Task, which is returned as it is; a document; or a path of a file or, where there is none and it
                is such a name, one of the tasks that ship with the package.

        Raises:
            DocumentError: There is neither, it cannot be read, or it is not as it must be.
        """
        if isinstance(source, Task):
            return source
        return cls(source if isinstance(source, Mapping) else parse_document(read_task(source)))

    def _repr_html_(self) -> str:
        """Returns its card in a notebook, HTML."""
        facts = {
            "what": self.description,
            "score": f"{self.document['objective']}{f' ({self.unit})' if self.unit else ''}",
            "time": f"{self.duration:g} s, {self.tick_rate} ticks a second",
            "seeds": ", ".join(map(str, self.seeds)),
            "ends": ", ".join(f"{end['name']}: {end['when']}" for end in self.document["ends"]) or None,
            "limits": limit_words(self.document["limits"]),
            "hash": self.hash[:16],
        }
        return card(f"Task {self.name}", facts)

    def with_duty(self) -> Task:
        """Returns the same task, whose episodes tell the duty factor."""
        task = copy(self)
        task.duty = True
        return task

    @staticmethod
    def names() -> tuple[str, ...]:
        """Returns the names of the tasks that ship with the package, sorted."""
        return SHIPPED.names()

    @property
    def bounds(self) -> dict[str, float]:
        """The limits of what a creature does, as `first_beyond` takes them: what is not limited is infinite."""
        return infinite(self.limits)

    def ended(self, trajectory: Trajectory, begin: int, end: int) -> tuple[int, str] | None:
        """Returns how many rows count where an episode is ended early, and the name of what ended it; None if nothing.

        The row at which one of `ends` holds counts; that at which the creature is beyond a limit does not.

        Args:
            trajectory: The episode so far.
            begin: The first row to look at.
            end: The row after the last.
        """
        beyond = trajectory.first_beyond(begin, end, **self.bounds)
        stops = []
        for name, condition in self.ends:
            row = trajectory.first(condition, begin, end)
            if row is not None:
                stops.append((row + 1, name))
        # Of two with as many rows, the condition that comes first in the document; a limit was met a row later.
        return min(stops if beyond is None else [*stops, beyond], key=lambda stop: stop[0], default=None)

    # -- bodies that change ----------------------------------------------------------------------------------------

    def why_changing(self, body: Body) -> str | None:
        """Returns why parts of a body may come and go here, in words; None where they do not."""
        return "the task cuts off a limb" if "injury" in self.document else changing(body)

    def injury_tick(self, seed: int) -> int | None:
        """Returns the tick, counted from the start, before which a limb is cut off; None where none is."""
        injury = self.document.get("injury")
        return None if injury is None else round(self.draw(seed, "injury", injury["time"]) * self.tick_rate)

    def limb(self, seed: int, body: Body, there: Container[str]) -> str | None:
        """Returns the limb that is cut off, drawn among those that are there then; None where there is none."""
        limbs = [limb for limb in _limbs(body) if limb in there]
        return limbs[min(int(self.draw(seed, "limb", (0.0, len(limbs)))), len(limbs) - 1)] if limbs else None

    @property
    def needs(self) -> tuple[Quantity, ...]:
        """The quantities that the objective and the conditions name."""
        return tuple(dict.fromkeys([*self.objective.needs, *(q for _, end in self.ends for q in end.needs)]))

    @property
    def touchy(self) -> bool:
        """Whether an episode's judge must be told what touches what."""
        return self.duty or any(quantity.name in ("contacts", "grown") for quantity in self.needs)

    # -- episodes ------------------------------------------------------------------------------------------------

    def target(self, seed: int, place: Place = ALONE) -> Vector | str | None:
        """Returns the point of the target, m, or the id of the prop that is it; None if there is no target."""
        target = self.document.get("target")
        if target is None:
            return next((prop["id"] for prop in self.document["props"] if prop["target"]), None)
        far, bearing = (self.draw(seed, what, target[what]) for what in ("distance", "bearing"))
        x, y, z = place.shifted((far * math.cos(bearing), float(target["height"]), -far * math.sin(bearing)))
        return x, y, z

    def entry(self, seed: int, genome: Mapping[str, Any], body: Body, place: Place = ALONE) -> list[JsonObject]:
        """Returns the commands that set a creature down, its centre of mass above the origin, to a centimetre.

        Args:
            seed: The episode's.
            genome: The document.
            body: The genome's.
            place: Where, of several creatures.
        """
        vary, body = self.document["vary"], body.born
        lowest = body.bounds[0][1]
        # Whoever was built beside its origin would begin at a target, or beyond an obstacle.
        x, z = (round(total(cube.mass * cube.position[axis] for cube in body.cubes) / body.mass, 2) for axis in (0, 2))
        position = [0.0 - x, self.draw(seed, "drop", vary["drop"]) - lowest, 0.0 - z]
        position = place.shifted(position)
        spawn: JsonObject = {"type": "spawn_creature", "genome": genome, "name": place.creature, "position": position}
        if "flaws" in self.document:
            spawn["flaws"] = self.document["flaws"]
        target = self.target(seed, place)
        if target is not None and not any(prop.get("hidden") for prop in self.document["props"]):
            spawn["target"] = place.prop(target) if isinstance(target, str) else target
        commands = [spawn]
        yaw = self.draw(seed, "yaw", vary["yaw"])
        if yaw:
            root = body.cubes[0]
            turned = multiply(quaternion_from_euler(0.0, yaw, 0.0), root.quaternion)
            name = f"{place.creature}.{root.id}"
            commands.append({"type": "set_cube_state", "cube_name": name, "rotation": list(turned)})
        return commands

    def props(self, seed: int, body: Body, root: Array, place: Place = ALONE) -> list[JsonObject]:
        """Returns the commands that put the props into the world, or on a creature that has settled.

        Args:
            seed: The episode's.
            body: The creature's.
            root: State of its root, array (13,) as `Simulation.states` has it.
            place: The creature's, of several.
        """
        commands: list[JsonObject] = []
        cube = body.cubes[0]
        for prop in self.document["props"]:
            if "position" in prop:
                standing = self.standing(prop, seed)
                name, position = place.prop(prop["id"]), place.shifted(standing["position"])
                commands.append({**standing, "cube_name": name, "position": position})
                continue
            lean = self.draw(seed, f"lean of {prop['id']}", prop["lean"])
            foot = _top(root, cube.size)
            if not prop["hinge"]:
                foot = foot[0], foot[1] + _GAP, foot[2]
            turn = quaternion_from_euler(0.0, 0.0, lean)
            up = rotate(turn, (0.0, prop["size"][1] / 2.0, 0.0))
            commands.append(
                {
                    "type": "spawn_cube",
                    "cube_name": place.prop(prop["id"]),
                    "position": [a + b for a, b in zip(foot, up, strict=True)],
                    "rotation": list(turn),
                    "size": prop["size"],
                    "mass": prop["mass"],
                    "color": prop["color"],
                    "list": False,
                }
            )
            if prop["hinge"]:
                ends = {"cube1": f"{place.creature}.{cube.id}", "cube2": place.prop(prop["id"])}
                joint = {"type": "create_joint", "joint_type": "hinge", "position": list(foot), "axis": [0, 0, 1]}
                commands.append({**joint, **ends})
        return commands

    def check(self, body: Body) -> list[str]:
        """Returns the reasons why a body may not take part, in words; none if it may."""
        return [*self.limits.check(body), *self._unsuited(body)]

    def check_driven(self, body: Body) -> list[str]:
        """Returns the reasons why a body may not take part where somebody else drives it, as in a learner's rows."""
        why = self.why_changing(body)
        return self.check(body) + ([] if why is None else [f"{why}, and where others drive, bodies keep their parts"])

    @property
    def requirements(self) -> Requirements:
        """What a body must be like to take part, for whoever varies genomes."""
        planar = load_backend(self._config["backend"]).dims == 2
        develops = bool(self.document.get("development"))
        return Requirements(self.limits, planar, self._unsuited, self.senses, shapes=self.shapes, development=develops)

    def _unsuited(self, body: Body) -> list[str]:
        """Returns the reasons why a body within the limits may not take part."""
        ids, props = {cube.id for cube in body.cubes}, self.prop_ids()
        reasons = [*self._unborn(body), *self.too_stiff(body)]
        reasons += [
            f"the task puts a cube {name!r} there, and the body has one of that id" for name in props if name in ids
        ]
        reasons += [
            f"the task puts {name!r} on the root, where the cube {part!r} is" for name, part in self._covered(body)
        ]
        cubes = {quantity.cube for quantity in self.needs if quantity.cube is not None}
        reasons += [
            f"the task is about a cube {name!r}, which the body has not" for name in sorted(cubes - ids - {*props})
        ]
        return reasons

    def _unborn(self, body: Body) -> list[str]:
        """Returns the reasons why a body may not take part as it is at birth, or as it may come to be."""
        born = body.born
        why = None if self.document.get("development") else changing(body)
        # Who sheds all below its root is higher at once: of a task that is about heights, that is not asked.
        reasons = [] if why is None else [f"{why}, and on this task bodies do not develop"]
        reasons += [f"at birth {reason}" for reason in Limits(**self.document.get("newborn", {})).check(born)]
        if body.later:
            reasons += [f"at birth {reason}" for reason in self.limits.check(born)]
        reasons += [f"resized, {reason}" for largest in outgrown(body) for reason in self.limits.check(largest)]
        if "injury" in self.document and not _limbs(born):
            reasons.append("the task cuts off a limb, and the body has none at birth")
        return reasons

    def _covered(self, body: Body) -> Iterator[tuple[str, str]]:
        """Yields pairs of a prop and a cube of the body at rest that is in its place."""
        root = body.cubes[0]
        x, top, z = _top(np.array([*root.position, *root.quaternion]), root.size)
        for prop in [prop for prop in self.document["props"] if "position" not in prop]:
            width, height, depth = prop["size"]
            low = np.array([x - width / 2.0, top, z - depth / 2.0])
            high = np.array([x + width / 2.0, top + height, z + depth / 2.0])
            for cube in body.cubes[1:]:
                points = corners(cube)
                if (np.minimum(points.max(axis=0), high) - np.maximum(points.min(axis=0), low) > _GAP).all():
                    yield prop["id"], cube.id


def _limbs(body: Body) -> list[str]:
    """Returns the cubes that joints hold to the root, in the order of those."""
    root = body.cubes[0].id
    ends = [(joint.cube1, joint.cube2) for joint in body.joints]
    return list(dict.fromkeys(two if one == root else one for one, two in ends if root in (one, two)))


def _top(root: Array, size: Vector) -> Vector:
    """Returns the point above a box's centre where a thing that stands on its highest point has its foot."""
    x, y, z, *turn = root[:7].tolist()
    quaternion: Quaternion = (turn[0], turn[1], turn[2], turn[3])
    up = total(abs(rotate(quaternion, axis)[1]) * edge / 2.0 for axis, edge in zip(_UNITS, size, strict=True))
    return x, y + up, z


_UNITS: tuple[Vector, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def _problems(document: JsonObject) -> Iterator[tuple[str, str]]:
    """Yields what is wrong with a sound document as a task for one creature, each with its place."""
    if "objective" not in document:
        yield "objective", "is missing; expected a string of at most 2000 characters"
    for name in ("interchangeable", "margin"):
        if name in document:
            yield name, "only a task with roles says this"
    props = document["props"]
    injury = document.get("injury")
    if injury is not None:
        yield from crossed_bounds([("injury/time", injury["time"])])
        if injury["time"][1] >= document["duration"]:
            yield "injury/time", f"expected times before the end, at {document['duration']:g} s"
    bounds = [(f"target/{name}", value) for name, value in document.get("target", {}).items() if name != "height"]
    yield from crossed_bounds([*bounds, *((f"props/{index}/lean", prop["lean"]) for index, prop in enumerate(props))])
    yield from crossed_bounds(
        (f"props/{index}/away/{name}", value)
        for index, prop in enumerate(props)
        for name, value in prop.get("away", {}).items()
    )
    targets = [f"props/{index}/target" for index, prop in enumerate(props) if prop["target"]]
    for path in targets if "target" in document else targets[1:]:
        yield path, "there is a target already"
    for index, prop in enumerate(props):
        yield from ((f"props/{index}/{name}", problem) for name, problem in _prop_problems(prop))
        if prop["id"].startswith(f"{CREATURE}."):
            yield f"props/{index}/id", f"names that begin with {CREATURE!r} and a point are the creature's"


def _prop_problems(prop: JsonObject) -> Iterator[tuple[str, str]]:
    """Yields what is wrong with one prop by itself, each with its field."""
    if "hidden" in prop and not prop["target"]:
        yield "hidden", "only a target can be kept from the creature"
    if "position" in prop:
        if prop["hinge"] or any(prop["lean"]):
            yield "hinge" if prop["hinge"] else "lean", "a prop does that upon the creature: only without a position"
    else:
        for name in [name for name in ("away", "frozen") if name in prop]:
            yield name, "only a prop with a position says this: without, it stands on the creature"
