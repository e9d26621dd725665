"""Crossover: from two genomes to a child that has something of each.

Hides how bodies and brains of two parents are put together. A limb of the second parent is grafted on the first one's
body, or what both have under the same name is mixed, number by number: parts and connections as K. Sims, "Evolving
Virtual Creatures" (1994), has it, nodes and links of networks as in NEAT (Stanley and Miikkulainen, 2002), where what
only the first parent has is kept. Invariants as of mutation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np

from nmes.brain import load_brain
from nmes.errors import DocumentError, VariationError
from nmes.genome import Genome
from nmes.schemas.documents import JsonObject, fits
from nmes.variation import cube_bodies, graph_bodies
from nmes.variation.brains import motor_names, sensor_names
from nmes.variation.draw import Draw
from nmes.variation.offspring import offspring
from nmes.variation.requirements import ANY, Requirements

__all__ = ["cross"]

_TRIES = 100
_OF_JOINTS: Final = ("type", "axis", "limits", "motor", "stiffness", "damping")


def cross(first: Genome, second: Genome, draw: Draw, *, requirements: Requirements = ANY) -> Genome:
    """Breeds a child of two genomes.

    Args:
        first: The parent whose body the child's is mostly like. Brains must be good ones.
        second: The other.
        draw: All choices.
        requirements: What the child's body must be like.

    Raises:
        DocumentError: A parent's brain is none for its body.
        VariationError: `no_offspring`: none of many tries gave a good genome that meets the requirements and has
            something of each.
    """
    for parent in (first, second):
        parent.check_brain()
    if ("graph" in first.document["body"]) != ("graph" in second.document["body"]):
        one, other = first.expanded(), second.expanded()
    else:
        one, other = first, second
    reason = "they have nothing to give each other"
    for _ in range(_TRIES):
        document = one.document
        names = draw.one_of(_WAYS)(document, one, other, draw)
        try:
            child = one
            if document["body"] != one.document["body"]:  # else there is nothing to grow
                child = offspring(document, one.body, [first, second], draw, ANY)
            document = _with_brain(child, other, names, draw)
            if child.body == one.body and document.get("brain") == one.document.get("brain"):
                continue
            return offspring(document, child.body, [first, second], draw, requirements)
        except DocumentError as error:
            reason = f"the last {error.problems[0][1]}"
    raise VariationError("no_offspring", f"no try gave a good child of {first.name!r} and {second.name!r}: {reason}")


# -- bodies -----------------------------------------------------------------------------------------------------------


def _graft(document: JsonObject, one: Genome, other: Genome, draw: Draw) -> dict[str, str]:
    """Grafts a limb; returns the names of the other's motors that come with it, each with its name in the child."""
    body, donor = document["body"], other.document["body"]
    for each in (body, donor):
        part = each.get("graph", each)
        part.setdefault("connections" if "graph" in each else "joints", [])
    if "graph" not in body:
        return cube_bodies.graft(body, one.body, donor, other.body, draw)
    parts = graph_bodies.graft(body["graph"], donor["graph"], draw)
    names = {}
    for motor in motor_names(other.body):
        for part, name in parts.items():
            if motor == part or motor.startswith(f"{part}."):
                names[motor] = name + motor[len(part) :]
    return names


def _mix_bodies(document: JsonObject, one: Genome, other: Genome, draw: Draw) -> dict[str, str]:
    """Takes what has the same name in both from either: parts and connections, or what joints are."""
    body, donor = document["body"], other.document["body"]
    if "graph" in body:
        _mix(body["graph"]["parts"], donor["graph"]["parts"], lambda part: part["id"], draw)
        _mix(body["graph"].get("connections", []), donor["graph"].get("connections", []), _ends, draw)
        return {}
    theirs = {joint["id"]: joint for joint in donor.get("joints", ())}
    for joint in body.get("joints", ()):
        if joint["id"] in theirs and draw.chance(0.5):
            own = {name: value for name, value in joint.items() if name not in _OF_JOINTS}
            taken = {name: value for name, value in theirs[joint["id"]].items() if name in _OF_JOINTS}
            joint.clear()
            joint.update(own | taken)
    return {}


def _ends(connection: JsonObject) -> tuple[str, str]:
    return connection["from"], connection["to"]


def _leave(document: JsonObject, one: Genome, other: Genome, draw: Draw) -> dict[str, str]:
    """Leaves the body as it is: the child differs by its brain."""
    return {}


_WAYS: Final[Sequence[Callable[[JsonObject, Genome, Genome, Draw], dict[str, str]]]] = (_graft, _mix_bodies, _leave)


def _mix(mine: list[JsonObject], theirs: Sequence[JsonObject], key: Callable[[JsonObject], object], draw: Draw) -> None:
    """Replaces some of the entries that have a counterpart among the others, each with a chance of a half."""
    others = {key(entry): entry for entry in theirs}
    for number, entry in enumerate(mine):
        if key(entry) in others and draw.chance(0.5):
            mine[number] = dict(others[key(entry)])


# -- brains -----------------------------------------------------------------------------------------------------------


def _with_brain(child: Genome, donor: Genome, names: Mapping[str, str], draw: Draw) -> JsonObject:
    """Returns the child's document with a brain that has something of the donor's, where they are of one kind.

    Args:
        child: Its brain is the first parent's, carried over.
        donor: The second parent.
        names: The donor's motors that came along, each with its name in the child.
        draw: The choices.
    """
    document, theirs = child.document, donor.document.get("brain")
    mine = document.get("brain")
    if mine is None or theirs is None or mine["kind"] != theirs["kind"]:
        return document
    if mine["kind"] == "graph":
        _mix(mine["nodes"], theirs["nodes"], lambda node: (node["id"], node.get("motor")), draw)
        _mix(mine.get("links", []), theirs.get("links", []), _link_ends, draw)
    elif names and mine["kind"] in ("sine", "cpg"):
        _take_oscillators(mine["oscillators"], theirs["oscillators"], motor_names(donor.body), names)
    else:
        document["brain"] = _mixed_numbers(mine, theirs, child, donor, draw)
    return document


def _link_ends(link: JsonObject) -> tuple[object, object, str]:
    return link.get("from"), link.get("sensor"), link["to"]


def _take_oscillators(
    mine: list[JsonObject], theirs: Sequence[JsonObject], motors: Sequence[str], names: Mapping[str, str]
) -> None:
    """Gives motors that came along the waves that they had: `motors` are all of the donor's, in order."""
    for oscillator in theirs:
        fitting = fits(oscillator["motor"])
        own = [motor for motor in motors if motor == oscillator["motor"] or fitting(motor)]
        for place, motor in enumerate(own):
            name = names.get(motor)
            exact = any(each["motor"] == motor for each in theirs)
            if name is None or (exact and oscillator["motor"] != motor):
                continue
            phase = oscillator.get("phase", 0.0) - place * oscillator.get("step", 0.0)
            wave = {**oscillator, "motor": name, "phase": round(min(max(phase, -100.0), 100.0), 6)}
            wave.pop("step", None)
            mine[:] = [*(each for each in mine if each["motor"] != name), wave]


def _mixed_numbers(mine: JsonObject, theirs: JsonObject, child: Genome, donor: Genome, draw: Draw) -> JsonObject:
    """Takes each number from either brain, where they differ by their numbers alone."""
    own, other = (
        load_brain(brain, sensor_names(genome.body), motor_names(genome.body))
        for brain, genome in ((mine, child), (theirs, donor))
    )
    if own.form() != other.form():
        return mine
    pairs = zip(own.to_vector().tolist(), other.to_vector().tolist(), strict=True)
    return own.with_vector(np.array([b if draw.chance(0.5) else a for a, b in pairs])).document
