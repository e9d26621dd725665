"""The differences between two genomes, told as a breeder would: this joint's limits, that part gone.

Hides which entries of two lists belong together: those of the same id or, where entries have none, of the same ends;
and rules that do the same.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from nmes.genome import Genome
from nmes.genome.development import deeds

__all__ = ["Difference", "differences"]

_ABOUT: Final = ("format", "name", "author", "license", "description", "parents")  # what does not make a creature
_KEYS: Final[Mapping[str, Sequence[str]]] = {
    "cubes": ("id",),
    "joints": ("id",),
    "parts": ("id",),
    "nodes": ("id",),
    "connections": ("from", "to"),
    "links": ("from", "sensor", "to"),
    "feedback": ("sensor", "motor"),
    "oscillators": ("motor",),
    "chains": ("motors",),
    "sensors": ("type", "joint", "cube", "axis"),
}
_MISSING: Final = object()


@dataclass(frozen=True, slots=True)
class Difference:
    """One difference.

    Attributes:
        path: Where: `body / parts / leg / size`.
        before: What the first genome has there, plain JSON data; None where it has nothing.
        after: What the second has.
        kind: `added`, `removed` or `changed`.
    """

    path: str
    before: Any
    after: Any
    kind: str


def differences(first: Genome, second: Genome) -> list[Difference]:
    """Returns the differences of the second genome from the first, in the order of the documents.

    What is said about a creature (name, author, parents) does not count; nor does the order of entries.
    """
    one, other = ({k: v for k, v in genome.document.items() if k not in _ABOUT} for genome in (first, second))
    return list(_compare((), one, other))


def _compare(path: tuple[str, ...], one: Any, other: Any) -> Iterator[Difference]:
    if one is _MISSING or other is _MISSING:
        kind = "added" if one is _MISSING else "removed"
        before, after = (None if value is _MISSING else value for value in (one, other))
        yield Difference(" / ".join(path), before, after, kind)
    elif isinstance(one, dict) and isinstance(other, dict):
        yield from _compare_entries(path, one, other)
    elif path and path[-1] in _KEYS and isinstance(one, list) and isinstance(other, list):
        yield from _compare_entries(path, _keyed(path[-1], one), _keyed(path[-1], other))
    elif path == ("development",) and isinstance(one, list) and isinstance(other, list):
        yield from _compare_entries(path, _rules(one), _rules(other))
    elif path and path[-1] == "layers" and isinstance(one, list) and isinstance(other, list):
        yield from _compare_entries(path, _numbered(one), _numbered(other))
    elif one != other:
        yield Difference(" / ".join(path), one, other, "changed")


def _compare_entries(path: tuple[str, ...], one: Mapping[str, Any], other: Mapping[str, Any]) -> Iterator[Difference]:
    for key in dict.fromkeys([*one, *other]):
        yield from _compare((*path, key), one.get(key, _MISSING), other.get(key, _MISSING))


def _keyed(name: str, entries: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Returns the entries of a list by what tells them from each other; of equal ones, the second is numbered."""
    said = [entry if isinstance(entry, dict) else {} for entry in entries]  # in a brain of a bad genome, anything
    keys = [" - ".join(str(entry[field]) for field in _KEYS[name] if field in entry) for entry in said]
    return _distinct(keys, entries)


def _rules(entries: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Returns rules of development by what they do."""
    return _distinct([deeds(entry) for entry in entries], entries)


def _distinct(keys: Sequence[str], entries: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    seen: Counter[str] = Counter()
    keyed = {}
    for key, entry in zip(keys, entries, strict=True):
        seen[key] += 1
        keyed[key if seen[key] == 1 else f"{key} ({seen[key]})"] = entry
    return keyed


def _numbered(entries: Sequence[Any]) -> dict[str, Any]:
    return {str(number): entry for number, entry in enumerate(entries, 1)}
