"""Tables of Q-learning as documents, to be kept and looked at: `schemas/q_table.json`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import prod
from typing import Final

from nmes.errors import DocumentError
from nmes.learning.learners.q_learning import QLearning
from nmes.schemas.documents import JsonObject, check, compile_schema, parse_document

__all__ = ["Action", "Dimension", "check_q_table", "q_table", "read_q_table"]

_FORMAT: Final = "nmes-q-table/1"
_SCHEMA: Final = compile_schema("q_table.json")


@dataclass(frozen=True)
class Dimension:
    """One of the numbers that are seen, cut into ranges.

    Attributes:
        name: What it is.
        unit: Its unit.
        edges: Between the ranges, ascending: of n there are n + 1 ranges.
    """

    name: str
    unit: str
    edges: Sequence[float]


@dataclass(frozen=True)
class Action:
    """One of the things that can be done.

    Attributes:
        name: What it is.
        arrow: Where it goes, along the first two dimensions, if it goes anywhere.
    """

    name: str
    arrow: tuple[float, float] | None = None


def q_table(
    title: str,
    dimensions: Sequence[Dimension],
    actions: Sequence[Action],
    learner: QLearning,
    figures: Mapping[str, float],
) -> JsonObject:
    """Returns a table of Q-learning as a document.

    Args:
        title: What for.
        dimensions: What is seen. States are counted through the ranges of the last one first.
        actions: What can be done.
        learner: The values and visits: arrays (states, actions).
        figures: What else is to be known of it: settings, and what came of it.

    Raises:
        DocumentError: They do not fit together.
    """
    document = {
        "format": _FORMAT,
        "title": title,
        "dimensions": [
            {"name": each.name, "unit": each.unit, "edges": list(map(float, each.edges))} for each in dimensions
        ],
        "actions": [
            {"name": each.name} | ({} if each.arrow is None else {"arrow": list(map(float, each.arrow))})
            for each in actions
        ],
        "values": learner.values.tolist(),
        "visits": learner.visits.tolist(),
        "figures": dict(figures),
        "digest": learner.digest,
    }
    check_q_table(document)
    return document


def read_q_table(text: bytes) -> JsonObject:
    """Reads a document that `q_table` made, from anybody.

    Raises:
        DocumentError: It is none, with all that is wrong.
    """
    document = parse_document(text)
    check_q_table(document)
    table: JsonObject = document
    return table


def check_q_table(document: object) -> None:
    """Checks a document.

    Raises:
        DocumentError: It is none, or there are other values than states and actions.
    """
    check(_SCHEMA, document)
    assert isinstance(document, dict)
    for place, dimension in enumerate(document["dimensions"]):
        if any(one >= other for one, other in pairwise(dimension["edges"])):
            raise DocumentError([(f"dimensions/{place}/edges", "edges are ascending")])
    states = prod(len(dimension["edges"]) + 1 for dimension in document["dimensions"])
    actions = len(document["actions"])
    for name in ("values", "visits"):
        rows = document[name]
        if len(rows) != states:
            raise DocumentError([(name, f"there are {states:,} states, and {len(rows):,} rows")])
        for place, row in enumerate(rows):
            if len(row) != actions:
                raise DocumentError([(f"{name}/{place}", f"there are {actions} actions, and {len(row)} numbers")])
