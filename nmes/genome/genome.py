"""Genomes: a creature's body, sensors and brain in one JSON document, read, judged as a whole, named by its hash.

Hides where the genomes that ship with the package lie, and that a body may have to grow first. Invariants: a Genome
that exists has a sound body; reading never changes the document; equal documents (up to white space, the order of
keys, and `1.0` for `1`) have equal hashes.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import cached_property, lru_cache
from io import BytesIO
from typing import Any, Final, TypeAlias

import orjson

from nmes.brain import Brain, load_brain
from nmes.errors import DocumentError
from nmes.genome import morphology
from nmes.genome.body import Body
from nmes.genome.inspection import inspect_body, inspect_brain
from nmes.schemas.documents import (
    JsonObject,
    ShippedDocuments,
    canonical_hash,
    parse_document,
    plain,
    write_json,
)
from nmes.schemas.notebook import card

__all__ = ["SHIPPED", "Genome", "GenomeLike"]

SHIPPED: Final = ShippedDocuments("genome", "nmes.genome", "shipped")
"""The genomes that ship with the package."""
GenomeLike: TypeAlias = "Genome | Mapping[str, Any] | str | os.PathLike[str]"
"""A genome: itself, its document, its file, or the name of one that ships."""
_PICTURE: Final = 480, 360  # pixels, in a notebook


class Genome:
    """One creature, as data.

    Args:
        document: As `schemas/genome.json` says; it is copied.

    Raises:
        DocumentError: With everything that is wrong, each with its place in the document. A brain is not looked into:
            `check_brain` does that.

    Attributes:
        name: What people call it.
        body: The body, grown where the document has a graph.
    """

    def __init__(self, document: Mapping[str, Any]) -> None:
        copied: JsonObject = plain(document)
        # As bytes, since a population is many genomes, and a document of dicts is ten times as large.
        self._text = write_json(copied)
        self.body = _read(self._text)
        self.name = str(copied["name"])
        self._brain_is_good = False  # as far as anybody has looked

    @classmethod
    def parse(cls, text: bytes) -> Genome:
        """Reads the bytes of a file.

        Raises:
            DocumentError: It is not strict JSON, or not a good genome.
        """
        return cls(parse_document(text))

    @classmethod
    def load(cls, source: GenomeLike) -> Genome:
        """Returns the genome that is meant.

        Args:
            source: A Genome, which is returned as it is; a document; or a path of a file or, where there is none and
                it is such a name, one of the genomes that ship with the package.

        Raises:
            DocumentError: There is neither, it cannot be read, or it is not a good genome.
        """
        if isinstance(source, Genome):
            return source
        return cls(source) if isinstance(source, Mapping) else cls.parse(SHIPPED.read(os.fspath(source)))

    @staticmethod
    def problems(document: Any) -> list[tuple[str, str]]:
        """Returns everything that is wrong with a document, its brain too; nothing for a good genome.

        What rests on a part that is wrong itself is judged as far as that can be without it.

        Args:
            document: JSON data.

        Returns:
            The JSON Pointer of each value that is wrong, without its leading slash, and words for a person: those of
            the body first, then those of the brain; of either at most one more than a `DocumentError` lists.
        """
        document = plain(document)
        inspection = inspect_body(document)
        return [*inspection.problems, *inspect_brain(document, inspection)]

    @staticmethod
    def names() -> tuple[str, ...]:
        """Returns the names of the genomes that ship with the package, sorted."""
        return SHIPPED.names()

    @property
    def document(self) -> JsonObject:
        """The document as it was given, nothing filled in: a new copy, plain JSON data."""
        document: JsonObject = orjson.loads(self._text)
        return document

    @cached_property
    def hash(self) -> str:
        """SHA-256 of the document in canonical form, 64 hexadecimal digits; see `nmes.schemas.documents`."""
        return canonical_hash(self.document)

    def brain(self) -> Brain:
        """Returns the brain, for this body's sensors and motors: a new one at each call.

        Raises:
            DocumentError: There is none, or it is not a good one for this body; with everything that is wrong.
        """
        document = self.document
        if "brain" not in document:
            raise DocumentError([("brain", f"{self.name!r} has no brain: it is driven from outside")])
        inputs, outputs = [sensor.id for sensor in self.body.sensors], self.body.outputs
        return load_brain(document["brain"], inputs, outputs)

    def check_brain(self) -> None:
        """Checks that the brain, if there is one, is a good one for this body; looks once.

        Raises:
            DocumentError: It is not, with everything that is wrong.
        """
        if not self._brain_is_good:
            if "brain" in self.document:
                self.brain()
            self._brain_is_good = True

    def expanded(self) -> Genome:
        """Returns the same creature with its cubes and joints written out in place of a graph."""
        document = self.document
        graph = document["body"].get("graph")
        return self if graph is None else Genome({**document, "body": morphology.grow(graph)})

    def _repr_png_(self) -> bytes:
        """Returns a picture of the body, for a notebook."""
        # Here, since most who read genomes draw none.
        from PIL import Image

        from nmes.genome.preview import render_body

        file = BytesIO()
        Image.fromarray(render_body(self.body, *_PICTURE)).save(file, format="PNG")
        return file.getvalue()

    def _repr_html_(self) -> str:
        """Returns its card in a notebook, HTML."""
        body = self.body
        facts = {
            "cubes": len(body.cubes),
            "mass": f"{body.mass:.4g} kg",
            "motors": len(body.motors),
            "sensors": len(body.sensors),
            **({"not there at birth": f"{len(body.later)} of the cubes"} if body.later else {}),
            **({"rules of development": len(body.development)} if body.development else {}),
            "brain": self.document.get("brain", {}).get("kind", "none"),
            "hash": self.hash[:16],
        }
        return card(f"Genome {self.name}", facts, picture=self._repr_png_())

    def __repr__(self) -> str:
        return f"Genome({self.name!r}, {self.hash[:16]})"


# A creature is read where it is evaluated, and in each of its worlds.
@lru_cache(maxsize=32)
def _read(text: bytes) -> Body:
    """Reads the body of a genome's document, grown where it has a graph.

    Raises:
        DocumentError: It is not a good genome, with everything that is wrong.
    """
    inspection = inspect_body(orjson.loads(text))
    if inspection.body is None or inspection.problems:
        raise DocumentError(inspection.problems)
    return inspection.body
