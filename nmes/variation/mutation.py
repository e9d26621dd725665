"""Mutation: from a genome to one that differs from it a little, and is as good a genome.

Hides how the two ways of writing a body are changed, and that what does not fit is drawn again. Invariants: a mutant
is a good genome with a good brain, and meets the requirements; it follows from its parent, the kind of change, the
requirements and the draw alone.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Final

from nmes.errors import DocumentError, VariationError
from nmes.genome import Genome
from nmes.genome.body import Body
from nmes.genome.sensors import OF_CUBE, OF_FOOD, OF_JOINT, OF_OTHERS, SURROUNDED
from nmes.schemas.documents import JsonObject, did_you_mean
from nmes.variation import brain_changes, cube_bodies, graph_bodies
from nmes.variation.development_changes import change_development
from nmes.variation.draw import Draw
from nmes.variation.offspring import offspring, written_sensors
from nmes.variation.requirements import ANY, Requirements
from nmes.variation.sensor_changes import POINTED, draw_details, point_anew
from nmes.variation.shapes import change_shape

__all__ = ["KINDS", "OF_BRAINS", "Mutant", "mutate"]

KINDS: Final[Mapping[str, float]] = {
    "add-part": 1.0,
    "remove-part": 0.8,
    "resize-part": 1.5,
    "move-part": 1.2,
    "joint": 0.3,
    "limits": 0.6,
    "axis": 0.4,
    "motor": 1.0,
    "symmetry": 0.4,
    "recursion": 0.4,
    "sensors": 0.4,
    "weights": 4.0,
    "oscillators": 4.0,
    "topology": 1.0,
    "voices": 0.4,
    "shape": 0.8,
    "development": 1.0,
}
"""The kinds of mutation, each with how often it is drawn where it can be, relative to the others."""
OF_BRAINS: Final = frozenset(brain_changes.CHANGES)
"""Those of them that change brains; all others change bodies, and brains go along."""
_CUBE_SENSORS: Final = tuple(kind for kind in OF_CUBE if kind not in (*OF_OTHERS, *OF_FOOD, *SURROUNDED, "hear"))
_MOST_VOICES = 128
_VARIED: Final = ("body", "later", "development", "sensors", "voices", "brain")
_TRIES = 100
_FRUITLESS = 20  # draws in a row after which a kind that is asked for has nothing to change
_MOST_SENSORS = 1024


@dataclass(frozen=True, slots=True)
class Mutant:
    """A genome and how it came about.

    Attributes:
        genome: The genome; its `parents` name the one that it came from.
        kind: The kind of mutation.
    """

    genome: Genome
    kind: str


def mutate(
    genome: Genome,
    draw: Draw,
    *,
    kind: str | None = None,
    among: Collection[str] = KINDS,
    requirements: Requirements = ANY,
) -> Mutant:
    """Changes a genome a little.

    Args:
        genome: The parent. Its brain, if it has one, must be a good one.
        draw: All choices.
        kind: One of `KINDS`; drawn by their weights if None.
        among: The kinds that may be drawn.
        requirements: What the mutant's body must be like, and what it may come to sense and say.

    Raises:
        DocumentError: The parent's brain is none for its body.
        VariationError: There is no such kind (`unknown_mutation`), or none of many tries gave a good genome that meets
            the requirements (`no_offspring`), as when the kind has nothing to change in this genome.
    """
    if kind is not None and kind not in KINDS:
        hint = did_you_mean(kind, KINDS) or f": there are {', '.join(KINDS)}"
        raise VariationError("unknown_mutation", f"there is no kind of mutation {kind!r}{hint}")
    genome.check_brain()
    reason = "there is nothing of that kind to change"
    # Only where they may change anything: they draw nothing elsewhere.
    use = {
        "voices": bool(requirements.channels),
        "shape": bool(requirements.shapes),
        "development": requirements.development,
    }
    kinds = {name: weight for name, weight in KINDS.items() if name in among and use.get(name, True)}
    given, fruitless = genome.document, 0
    for _ in range(_TRIES):
        chosen = draw.one_of(tuple(kinds), tuple(kinds.values())) if kind is None else kind
        document = genome.document
        if _change(document, genome.body, chosen, draw, requirements):
            try:
                child = offspring(document, genome.body, [genome], draw, requirements)
            except DocumentError as error:
                reason, fruitless = f"the last {error.problems[0][1]}", 0
                continue
            if not _same(child.document, given):
                return Mutant(child, chosen)
        fruitless += 1
        if fruitless == _FRUITLESS and kind is not None:
            break
    what = "mutation" if kind is None else f"mutation {kind!r}"
    raise VariationError("no_offspring", f"no try gave a good {what} of {genome.name!r}: {reason}")


def _same(document: JsonObject, other: JsonObject) -> bool:
    return all(document.get(name) == other.get(name) for name in _VARIED)


def _change(document: JsonObject, body: Body, kind: str, draw: Draw, requirements: Requirements) -> bool:
    """Makes one change to a document; returns whether there was anything to change."""
    if kind in brain_changes.CHANGES:
        return "brain" in document and brain_changes.CHANGES[kind](document["brain"], body, draw)
    if kind == "development":
        return change_development(document, body, draw)
    if kind == "sensors":
        return _change_sensors(document, body, draw, requirements)
    if kind == "voices":
        return _change_voices(document, draw, requirements)
    if kind == "shape":
        return _change_shape(document["body"], body, draw, requirements)
    graph = document["body"].get("graph")
    if graph is not None:
        graph.setdefault("connections", [])
        return graph_bodies.CHANGES[kind](graph, body, draw, requirements.planar)
    document["body"].setdefault("joints", [])
    change = cube_bodies.CHANGES.get(kind)
    return change is not None and change(document["body"], body, draw, requirements.planar)


def _change_sensors(document: JsonObject, body: Body, draw: Draw, requirements: Requirements) -> bool:
    """Adds a sensor or takes one away; those of a body by default are written out first."""
    sensors = document.setdefault("sensors", written_sensors(body))
    if len(sensors) > 1 and draw.chance(0.4):
        sensors.remove(draw.one_of(sensors))
        return True
    pointed = [sensor for sensor in sensors if sensor["type"] in POINTED] if {*requirements.senses} & POINTED else []
    if pointed and draw.chance(0.5):
        point_anew(draw.one_of(pointed), draw, planar=requirements.planar)
        return True
    if len(sensors) >= _MOST_SENSORS:
        return False
    driven = [joint.id for joint in body.joints if joint.kind in ("hinge", "slide")]
    if driven and draw.chance(0.4):
        sensors.append({"type": draw.one_of(OF_JOINT), "joint": draw.one_of(driven)})
    else:
        kinds = (*_CUBE_SENSORS, *requirements.senses, *(("hear",) if requirements.channels else ()))
        sensor = {"type": draw.one_of(kinds), "cube": draw.one_of(body.cubes).id}
        if sensor["type"] == "hear":
            sensor |= _draw_number(draw, requirements)
        elif sensor["type"] in requirements.senses:
            sensor |= draw_details(sensor["type"], sensor["cube"], sensors, draw, planar=requirements.planar)
        sensors.append(sensor)
    return True


def _change_shape(document: JsonObject, body: Body, draw: Draw, requirements: Requirements) -> bool:
    """Gives a part another of the shapes that there are."""
    if not requirements.shapes or not change_shape(document, draw, requirements.shapes):
        return False
    if "graph" not in document:
        cube_bodies.stand(document, body)
    return True


def _change_voices(document: JsonObject, draw: Draw, requirements: Requirements) -> bool:
    """Adds a voice on one of the channels that there are, or takes one away."""
    voices = document.setdefault("voices", [])
    if voices and draw.chance(0.4):
        voices.remove(draw.one_of(voices))
        return True
    if len(voices) >= _MOST_VOICES or not requirements.channels:
        return False
    voices.append(_draw_number(draw, requirements))
    return True


def _draw_number(draw: Draw, requirements: Requirements) -> JsonObject:
    """Draws a number of a channel, as sensors and voices name it."""
    channel, size = draw.one_of(requirements.channels)
    return {"channel": channel, "number": draw.count(1, size)}
