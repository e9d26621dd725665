"""Genomes: a creature's body, sensors and brain in one JSON document, read, judged as a whole, named by its hash.

Hides where the genomes that ship with the package lie, how a document is made canonical, and that a body may have to
grow first. Invariants: a Genome that exists has a sound body; reading never changes the document; equal documents (up
to white space, the order of keys, and `1.0` for `1`) have equal hashes.
"""

from __future__ import annotations

import difflib
import hashlib
from collections.abc import Mapping
from functools import cached_property, lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import orjson

from nmes import protocol
from nmes.brain import Brain, load_brain
from nmes.errors import DocumentError, RejectedMessage
from nmes.genome import morphology
from nmes.genome.body import Body, read_body

__all__ = ["Genome"]

JsonObject = dict[str, Any]

_GENOME: Final = protocol.document_schema("genome.json")
_WHOLE = 2.0**53  # beyond this not every whole number is a float


class Genome:
    """One creature, as data.

    Args:
        document: As `schemas/genome.json` says; it is copied.

    Raises:
        DocumentError: With everything that is wrong, each with its place in the document. A brain is not looked into:
            `brain` does that.

    Attributes:
        body: The body, grown where the document has a graph.
    """

    def __init__(self, document: Mapping[str, Any]) -> None:
        try:
            text = protocol.encode(document)
        except (TypeError, ValueError, RecursionError) as error:
            raise DocumentError([("", f"this is not JSON data: {error}")]) from None
        self._document, self._grown, self.body = _read(text)

    @classmethod
    def parse(cls, text: bytes) -> Genome:
        """Reads the bytes of a file.

        Raises:
            DocumentError: It is not strict JSON, or not a good genome.
        """
        try:
            document = protocol.parse_json(text)
        except RejectedMessage as error:
            raise DocumentError([("", error.message)]) from error
        return cls(document)

    @classmethod
    def load(cls, name: str | Path) -> Genome:
        """Reads a file or, where there is none and it is such a name, one of the genomes that ship with the package.

        Raises:
            DocumentError: There is neither, it cannot be read, or it is not a good genome.
        """
        path = Path(name)
        shipped = files("nmes.genome") / "shipped" / f"{name}.json"
        if not path.exists() and str(name) in cls.names():
            return cls.parse(shipped.read_bytes())
        try:
            return cls.parse(path.read_bytes())
        except OSError as error:
            near = difflib.get_close_matches(str(name), cls.names(), n=1)
            hint = f"; did you mean {near[0]!r}, which ships with the package?" if near else ""
            raise DocumentError([("", f"cannot read {name}: {error.strerror}{hint}")]) from error

    @staticmethod
    def names() -> list[str]:
        """Returns the names of the genomes that ship with the package, sorted."""
        return sorted(
            entry.name.removesuffix(".json")
            for entry in (files("nmes.genome") / "shipped").iterdir()
            if entry.name.endswith(".json")
        )

    @property
    def document(self) -> JsonObject:
        """A copy of the document."""
        copied: JsonObject = orjson.loads(orjson.dumps(self._document))  # several times faster than deepcopy
        return copied

    @property
    def name(self) -> str:
        """What people call it."""
        return str(self._document["name"])

    @cached_property
    def hash(self) -> str:
        """SHA-256 of the document in canonical form, 64 hexadecimal digits.

        Canonical is: UTF-8, no white space, keys sorted by their code points, whole numbers below 2^53 without a
        fraction, others as the shortest decimal that is the same double.
        """
        return hashlib.sha256(orjson.dumps(_canonical(self._document), option=orjson.OPT_SORT_KEYS)).hexdigest()

    def brain(self) -> Brain:
        """Returns the brain, for this body's sensors and motors: a new one at each call.

        Raises:
            DocumentError: There is none, or it is not a good one for this body; with everything that is wrong.
        """
        if "brain" not in self._document:
            raise DocumentError([("brain", f"{self.name!r} has no brain: it is driven from outside")])
        inputs, outputs = [sensor.id for sensor in self.body.sensors], [motor.id for motor in self.body.motors]
        return load_brain(self._document["brain"], inputs, outputs)

    def expanded(self) -> Genome:
        """Returns the same creature with its cubes and joints written out in place of a graph."""
        return Genome({**self._document, "body": self._document["body"] if self._grown is None else self._grown})

    def __repr__(self) -> str:
        return f"Genome({self.name!r}, {self.hash[:12]})"


# A creature is read where it is evaluated, and in each of its worlds.
@lru_cache(maxsize=32)
def _read(text: bytes) -> tuple[JsonObject, JsonObject | None, Body]:
    """Returns a genome's document, its body written out where the document has a graph, and the body."""
    try:
        document: JsonObject = orjson.loads(text)
    except ValueError as error:
        raise DocumentError([("", f"this is not JSON data: {error}")]) from None
    problems = [(problem.pointer, problem.said) for problem in protocol.problems(_GENOME, document)]
    if problems:
        raise DocumentError(problems)
    body = document["body"]
    if ("cubes" in body) == ("graph" in body) or ("graph" in body and "joints" in body):
        raise DocumentError([("body", "must have either cubes (and joints between them) or a graph")])
    grown: JsonObject | None = None
    if "graph" in body:
        grown = body = morphology.grow(body["graph"])
        # Scales may have taken a size or a mass out of its bounds.
        for problem in protocol.problems(_GENOME, {**document, "body": body}):
            what = _named(body, problem.pointer)
            problems.append(("body/graph", f"grows {what} is out of range: {problem.said}"))
        if problems:
            raise DocumentError(problems)
    return document, grown, read_body(body, document.get("sensors"), None if grown is None else "body/graph")


def _canonical(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _canonical(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_canonical(item) for item in value]
    if isinstance(value, float) and value.is_integer() and abs(value) < _WHOLE:
        return int(value)
    return value


def _named(body: JsonObject, path: str) -> str:
    """Says what of a grown body a path such as `body/cubes/3/mass` means."""
    _, kind, index, *field = path.split("/")
    return f"{body[kind][int(index)]['id']!r}, of which the {'/'.join(field)}"
