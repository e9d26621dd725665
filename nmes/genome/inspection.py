"""All that is wrong with a genome's document, told at once.

A document is judged in steps: by its schema, then as a body, then as a brain for that body. Hides how a later step goes
on where an earlier one has found something: fields that are wrong are left out and, where a part is none without them,
the part. Invariant: nothing is blamed that may only follow from what was left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from typing import Any, Final

import orjson

from nmes.brain import load_brain
from nmes.errors import DocumentError, MissingPackage
from nmes.genome import morphology
from nmes.genome.body import Body, read_body
from nmes.schemas.documents import JsonObject, Problem, compile_schema, problems, without, write_json

__all__ = ["Inspection", "inspect_body", "inspect_brain"]

_GENOME: Final = compile_schema("genome.json")
_BARE: Final = {"format": "nmes-genome/1", "name": "grown"}
"""A document that lacks only its body."""
_PARTS: Final[tuple[tuple[str, ...], ...]] = (("body", "cubes"), ("body", "joints"), ("sensors",), ("voices",))
"""Where parts stand that can be left out one by one."""


@dataclass(frozen=True, slots=True)
class Inspection:
    """What was found in a genome's document.

    Attributes:
        problems: Everything that is wrong with all but the brain, each with its place.
        body: The body, which is good only if there are no problems; None if it cannot be read at all.
        absent: The ids of the cubes and joints of the document that the body lacks, since they are wrong; `*` for one
            without an id.
    """

    problems: list[tuple[str, str]]
    body: Body | None = None
    absent: tuple[str, ...] = ()


def inspect_body(document: Any) -> Inspection:
    """Judges a genome's document, all but its brain.

    Args:
        document: JSON data.
    """
    unsound = list(islice(problems(_GENOME, document), DocumentError.MOST + 1))
    try:
        return _remaining(document, unsound) if unsound else _body_of(document)
    except DocumentError as error:  # with more than a list of problems, or one that hides all others
        return Inspection([*_told(unsound), *error.found])


def _told(unsound: Iterable[Problem]) -> list[tuple[str, str]]:
    return [(problem.pointer, problem.message) for problem in unsound]


def _body_of(document: JsonObject) -> Inspection:
    """Judges the body of a document that is as its schema says.

    Raises:
        DocumentError: It cannot be read.
    """
    body, sensors, voices = document["body"], document.get("sensors"), document.get("voices", [])
    later, development = document.get("later", []), document.get("development", [])
    if ("cubes" in body) == ("graph" in body) or ("graph" in body and "joints" in body):
        raise DocumentError([("body", "must have either cubes (and joints between them) or a graph")])
    rest = write_json([sensors, voices, later, development])
    if "graph" in body:
        return Inspection(*_read_body(_grown(write_json(body["graph"])), rest, "body/graph"))
    return Inspection(*_read_body(write_json(body), rest, None))


def _remaining(document: Any, unsound: Sequence[Problem]) -> Inspection:
    """Judges what is left of a document without what its schema refuses.

    Raises:
        DocumentError: That has more problems than one lists.
    """
    found = _told(unsound)
    if len(unsound) > DocumentError.MOST:
        return Inspection(found)
    mended = without(document, unsound)
    left_out = {_part(problem.keys) for problem in problems(_GENOME, mended)}
    # A field that there is not may be one that is misspelt: of a joint its motor, of a body its joints.
    places = [problem.keys for problem in unsound]
    left_out |= {_part(keys) for keys in places if keys[:2] == ("body", "joints") and len(keys) == 4}
    whole = any(keys[:1] == ("body",) and not any(isinstance(key, str) for key in keys[2:]) for keys in places)
    if None in left_out or whole or "cubes" not in mended["body"]:
        return Inspection(found)
    kept = {place: [i for i in range(len(_parts(mended, place))) if (place, i) not in left_out] for place in _PARTS}
    absent = tuple(_name(mended, *part) for part in left_out if part is not None and part[0][0] == "body")
    if "graph" in mended["body"] or not kept["body", "cubes"]:
        return Inspection(found)
    cubes, joints, sensors, voices = ([_parts(mended, place)[i] for i in kept[place]] for place in _PARTS)
    body = {"cubes": cubes, "joints": joints}
    others, read = read_body(body, sensors if "sensors" in mended else None, voices, absent=absent)
    return Inspection([*found, *((_original(path, kept), message) for path, message in others)], read, absent)


def _part(keys: Sequence[str | int]) -> tuple[tuple[str, ...], int] | None:
    """Returns the part in which a value stands, as its place and index; None where it is in none."""
    for place in _PARTS:
        if tuple(keys[: len(place)]) == place and len(keys) > len(place):
            return place, int(keys[len(place)])
    return None


def _parts(document: JsonObject, place: Sequence[str]) -> list[Any]:
    for key in place:
        document = document.get(key, {})
    return list(document)


def _name(document: JsonObject, place: Sequence[str], index: int) -> str:
    """Returns the id of a part that is left out; `*`, which may be any, where it has no good one."""
    part = _parts(document, place)[index]
    name = part.get("id") if isinstance(part, dict) else None
    return name if isinstance(name, str) else "*"


def _original(path: str, kept: Mapping[tuple[str, ...], Sequence[int]]) -> str:
    """Returns where in the document that stands which has this path without what was left out."""
    keys = path.split("/")
    for place, indices in kept.items():
        # Where the document has no sensors, there are those of every body, which stand nowhere.
        if tuple(keys[: len(place)]) == place and len(keys) > len(place) and indices:
            keys[len(place)] = str(indices[int(keys[len(place)])])
    return "/".join(keys)


def inspect_brain(document: Any, inspection: Inspection) -> list[tuple[str, str]]:
    """Judges a document's brain, for the body that was found in it.

    Args:
        document: JSON data.
        inspection: What `inspect_body` says of it.

    Returns:
        Everything that is wrong with it, each with its place; nothing where there is no brain.
    """
    wrong = {path.split("/")[0] for path, _ in inspection.problems}
    if not isinstance(document, dict) or "brain" not in document or "brain" in wrong:
        return []
    names, unsure = {"sensors": list[str](), "motors": list[str]()}, {"sensors", "motors"}
    if inspection.body is not None and "*" not in inspection.absent:
        unsure = {"sensors"} if inspection.absent or not wrong <= {"body"} else set()
        names["sensors"] = [sensor.id for sensor in inspection.body.sensors]
        names["motors"] = list(inspection.body.outputs)
        if inspection.absent:
            joints = [joint["id"] for joint in document["body"].get("joints", ())]
            voices = [voice.id for voice in inspection.body.voices]
            names["motors"] = [name for name in joints if name in {*names["motors"], *inspection.absent}] + voices
        if "voices" in wrong:
            unsure |= {"motors"}
    try:
        load_brain(document["brain"], names["sensors"], names["motors"], unsure=unsure)
    except DocumentError as error:
        return list(error.found)
    except MissingPackage as error:
        return [("brain", error.message)]
    return []


# A child is read as its parents' sensors see it, then with its own, then whole: it grows once.
@lru_cache(maxsize=128)
def _grown(text: bytes) -> bytes:
    """Grows a graph of parts, and returns the cubes and joints that a document would have, both as JSON.

    Raises:
        DocumentError: It does not grow, or out of the bounds of a document.
    """
    grown = morphology.grow(orjson.loads(text))
    # Scales may have taken a size or a mass out of its bounds.
    outgrown = [
        ("body/graph", f"grows {_quantity(grown, problem.pointer)} is out of range: {problem.message}")
        for problem in problems(_GENOME, {**_BARE, "body": grown})
    ]
    if outgrown:
        raise DocumentError(outgrown)
    return write_json(grown)


# A population is of few bodies with many brains, or of one portion of bodies that are each read in their worlds again.
@lru_cache(maxsize=128)
def _read_body(text: bytes, rest: bytes, place: str | None) -> tuple[list[tuple[str, str]], Body]:
    """Reads a body from what `read_body` takes: its cubes and joints, and all else, each as JSON.

    Raises:
        DocumentError: As `read_body`.
    """
    sensors, voices, later, development = orjson.loads(rest)
    return read_body(orjson.loads(text), sensors, voices, place, later=later, development=development)


def _quantity(body: JsonObject, path: str) -> str:
    """Returns words for a place in a grown body, such as `body/cubes/3/mass`."""
    _, kind, index, *field = path.split("/")
    return f"{body[kind][int(index)]['id']!r}, of which the {'/'.join(field)}"
