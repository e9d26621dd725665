"""Documents: JSON data that people write and share, such as genomes, brains, tasks and world configs.

Hides how a document is read strictly, judged by its schema, completed with its defaults, named by its hash, and found
by a name or a path. What a kind of document means beyond its schema, its own package knows.
"""

from __future__ import annotations

import difflib
import hashlib
import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from heapq import nlargest
from importlib.resources import files
from itertools import chain, islice
from pathlib import Path
from typing import Any, Final

import jiter
import jsonschema_rs
import orjson

from nmes.errors import DocumentError, RejectedMessage
from nmes.schemas import Schema, describe, load, load_all

__all__ = [
    "CONTAINERS",
    "NESTING",
    "VALUES",
    "CompiledSchema",
    "JsonObject",
    "Problem",
    "ShippedDocuments",
    "canonical_hash",
    "check",
    "compile_folder",
    "compile_schema",
    "complete",
    "did_you_mean",
    "excerpt",
    "fits",
    "nor_at",
    "parse_document",
    "parse_json",
    "plain",
    "plain_numbers",
    "problems",
    "unwritable_number",
    "without",
    "write_json",
]

JsonObject = dict[str, Any]

NESTING: Final = 200
"""How deep JSON may be nested."""
CONTAINERS: Final = 1 << 16
"""How many arrays and objects JSON may hold: what one costs does not show in the length of its text."""
VALUES: Final = 1 << 22
"""How many values JSON may hold: a digit and a comma become a hundred times as many bytes."""
_FILE: Final = 80 << 20  # bytes of a document's file: the largest model of a brain, and as much again as a body
_EXCERPT: Final = 80  # characters of somebody's value that a message repeats
_COMPARED, _KNOWN, _CLOSE = 24, 256, 4  # characters of a name, names it is compared with roughly, and closely
_UNKNOWN: Final = 100  # fields that there are none of, above which an object is not looked into
_PLACES: Final = 8  # that a message lists
_ALIKE: Final = 0.6  # how like a name must be to be meant
_WHOLE: Final = 2.0**53  # beyond this not every whole number is a float


# -- JSON -------------------------------------------------------------------------------------------------------------


def parse_json(text: bytes) -> Any:
    """Reads strict JSON within `NESTING`, `CONTAINERS` and `VALUES`: no key twice, no number infinite as a double.

    Raises:
        RejectedMessage: It is not UTF-8 (`bad_frame`), or not strict JSON (`bad_json`).
    """
    if text.count(b",") > VALUES:  # those in strings count, as below
        raise RejectedMessage("bad_json", f"more than {VALUES:,} values")
    brackets = text.count(b"[") + text.count(b"{") if len(text) > 2 * NESTING else 0
    if brackets > CONTAINERS:  # those in strings count, which are too few to matter
        raise RejectedMessage("bad_json", f"more than {CONTAINERS:,} arrays and objects")
    try:
        # jiter alone finds duplicate keys and keeps long integers exact; orjson alone refuses numbers that are
        # infinite as a double (1e400). Both together cost less than looking for such numbers ourselves.
        value = jiter.from_json(text, catch_duplicate_keys=True, allow_inf_nan=False)
        orjson.loads(text)
    except ValueError as error:
        raise _rejection(text, error) from None
    if brackets > NESTING and _too_deep(value):
        raise RejectedMessage("bad_json", f"nested more than {NESTING} deep")
    return value


def _rejection(text: bytes, error: ValueError) -> RejectedMessage:
    try:
        text.decode()
    except UnicodeDecodeError as broken:
        return RejectedMessage("bad_frame", f"invalid UTF-8 at byte {broken.start}")
    return RejectedMessage("bad_json", f"not strict JSON: {_cut(str(error))}")  # it may repeat a key of any length


def _too_deep(value: Any) -> bool:
    level = [value]
    for _ in range(NESTING):
        level = [
            inner
            for outer in level
            for inner in (outer.values() if type(outer) is dict else outer)
            if type(inner) is list or type(inner) is dict
        ]
    return bool(level)


def parse_document(text: bytes) -> Any:
    """Reads the bytes of a document's file.

    Raises:
        DocumentError: It is not strict JSON.
    """
    try:
        return parse_json(text)
    except RejectedMessage as error:
        raise DocumentError([("", error.message)]) from error


def write_json(value: Any) -> bytes:
    """Writes JSON without white space; arrays and scalars of numpy become numbers, integers may have any length.

    Raises:
        TypeError: It holds something that JSON cannot.
        ValueError: It holds a lone surrogate, or a number that JSON cannot.
    """
    try:
        return orjson.dumps(value, default=plain_numbers)
    except TypeError:  # also an integer of more than 64 bits
        written = json.dumps(value, default=plain_numbers, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
        return written.encode()


def plain_numbers(value: Any) -> Any:
    """Returns the numbers of an array or a scalar of numpy, or of what is like them, as JSON has numbers.

    A single (float32) becomes the double that it is, wherever it stands.

    Raises:
        TypeError: It is nothing of the kind.
    """
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"a {type(value).__name__} is nothing that JSON has")


def unwritable_number(value: Any, text: bytes) -> tuple[str, str] | None:
    """Returns where data have a number that JSON lacks (nan, inf), for which null was written, and what was wrong.

    Args:
        value: The data.
        text: What `write_json` made of them.
    """
    if b"null" not in text:
        return None
    if isinstance(value, float) and not math.isfinite(value):
        return "", f"{value} is no number that JSON has"
    if hasattr(value, "tolist"):
        return unwritable_number(value.tolist(), text)
    inner = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list | tuple) else ()
    for key, item in inner:
        found = unwritable_number(item, text)
        if found is not None:
            return f"{key}/{found[0]}".rstrip("/"), found[1]
    return None


def plain(value: Any) -> Any:
    """Returns a deep copy of JSON data, numpy arrays as lists.

    Raises:
        DocumentError: It is not JSON data; with the place of a number that is none.
    """
    try:
        text = write_json(value)
        wrong = unwritable_number(value, text)
        copied = orjson.loads(text)
    except (TypeError, ValueError, RecursionError) as error:
        raise DocumentError([("", f"this is not JSON data: {error}")]) from None
    if wrong is not None:
        raise DocumentError([wrong])
    return copied


# -- schemas ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class CompiledSchema:
    """The shape of one kind of message or document, free of references, and its compiled validator.

    Attributes:
        conditional: Whether there are fields in it with `x-when`.
    """

    type: str
    schema: Schema
    validator: jsonschema_rs.Draft202012Validator = field(repr=False)
    conditional: bool


def compile_schema(path: str) -> CompiledSchema:
    """Returns the compiled schema in a file, by its path under `schemas/`: `genome.json`."""
    return _compiled(path.removesuffix(".json"), load(path))


def compile_folder(folder: str) -> dict[str, CompiledSchema]:
    """Returns the compiled schemas of a folder (`commands`, `replies`, `events`) by message type, sorted."""
    return {kind: _compiled(kind, schema) for kind, schema in load_all(folder).items()}


def _compiled(kind: str, schema: Schema) -> CompiledSchema:
    return CompiledSchema(
        kind, schema, jsonschema_rs.Draft202012Validator(schema), b'"x-when":' in orjson.dumps(schema)
    )


@dataclass(frozen=True, slots=True)
class Problem:
    """One value of a document that is not as its schema says.

    Attributes:
        keys: The keys and indices that lead to the value.
        message: What is wrong with it, for a person.
    """

    keys: tuple[str | int, ...]
    message: str

    @property
    def pointer(self) -> str:
        """The JSON Pointer of the value, without its leading slash."""
        return "/".join(str(key).replace("~", "~0").replace("/", "~1") for key in self.keys)


def check(schema: CompiledSchema, value: Any) -> None:
    """Holds a document to its schema.

    Raises:
        DocumentError: It is not as the schema says, with the problems.
    """
    found = ((problem.pointer, problem.message) for problem in problems(schema, value))
    first = next(found, None)
    if first is not None:
        raise DocumentError(chain([first], found))


def problems(schema: CompiledSchema, value: Any) -> Iterator[Problem]:
    """Yields the problems that a schema has with a value, each when it is asked for.

    Arrays that are too long come first: where there are any, nothing else is looked at. Of each other array no more
    than 20 unsound items are, and of one that may be other things too no more than it may have and one, so that what
    this costs is bounded. The problems of `x-when` come only where there are
    no others.
    """
    if schema.validator.is_valid(value):
        if schema.conditional:
            yield from _misplaced(schema.schema, value, ())
        return
    within = True
    for problem in _too_long(schema.schema, value, ()):
        within = False
        yield problem
    if within:
        for error in schema.validator.iter_errors(_abridged(schema.schema, value)):  # makes all of them at once
            yield from _explain(schema.schema, error, value)


def without(value: Any, blamed: Iterable[Problem]) -> Any:
    """Returns a copy of JSON data without the fields that problems are about.

    Of a problem inside an array the field that holds the array goes; one that is about all of the data changes nothing.
    """
    copied = plain(value)
    for problem in blamed:
        named = [index for index, key in enumerate(problem.keys) if isinstance(key, str)]
        if named:
            part = copied
            for key in problem.keys[: named[-1]]:
                within = key in part if isinstance(part, dict) else isinstance(part, list) and isinstance(key, int)
                part = part[key] if within else None
            if isinstance(part, dict):
                part.pop(problem.keys[named[-1]], None)
    return copied


def _too_long(schema: Schema, value: Any, keys: tuple[str | int, ...]) -> Iterator[Problem]:
    """Yields the arrays that have more items than they may, without looking into them, and fields by the hundred."""
    if isinstance(value, dict):
        parts = schema.get("properties", {})
        for name, part in parts.items():
            if name in value:
                yield from _too_long(part, value[name], (*keys, name))
        if schema.get("additionalProperties") is False and len(value) > len(parts) + _UNKNOWN:
            yield from (Problem((*keys, name), "there is no such field") for name in value if name not in parts)
    elif isinstance(value, list):
        items = schema.get("items", {})
        if len(value) > schema.get("maxItems", len(value)):
            yield Problem(keys, f"expected {describe(schema)}, got {len(value):,}")
        elif "properties" in items or "items" in items:
            for index, item in enumerate(value):
                yield from _too_long(items, item, (*keys, index))


def _abridged(schema: Schema, value: Any) -> Any:
    """Returns a value with each of its arrays cut off behind the last unsound item that is to be looked at."""
    if isinstance(value, dict):
        parts, more = schema.get("properties", {}), schema.get("additionalProperties", {})
        return {
            # what is in a field that there must not be, nobody asks
            name: None if more is False and name not in parts else _abridged(parts.get(name, {}), item)
            for name, item in value.items()
        }
    if not isinstance(value, list):
        return value
    if "anyOf" in schema:
        arrays = [choice for choice in schema["anyOf"] if "array" in choice.get("type", "array")]
        longest = max((choice.get("maxItems", len(value)) for choice in arrays), default=0)
        return value[: longest + 1]  # which is as unsound: each item costs as much as all of its choices
    if "items" not in schema:
        return value
    items, unsound = schema["items"], 0
    validator = _validator(orjson.dumps(items))
    abridged = []
    for item in value:
        if validator.is_valid(item):
            abridged.append(item)
        else:
            abridged.append(_abridged(items, item))
            unsound += 1
            if unsound == DocumentError.MOST + 1:
                break
    return abridged


@lru_cache(maxsize=64)
def _validator(schema: bytes) -> jsonschema_rs.Draft202012Validator:
    return jsonschema_rs.Draft202012Validator(orjson.loads(schema))


def _explain(schema: Schema, error: jsonschema_rs.ValidationError, value: Any) -> Iterator[Problem]:
    """Yields the problems of one failed keyword."""
    keys, kind = tuple(error.instance_path), error.kind
    around = _at(schema, error.schema_path[:-1])
    if isinstance(kind, jsonschema_rs.ValidationErrorKind.Required):
        missing = around.get("properties", {}).get(kind.property, {})
        yield Problem((*keys, kind.property), f"is missing; expected {describe(missing)}")
    elif isinstance(kind, jsonschema_rs.ValidationErrorKind.AdditionalProperties):
        for name in kind.unexpected:
            yield Problem((*keys, name), "there is no such field" + did_you_mean(name, around["properties"]))
    else:
        actual = "" if "x-secret" in around else f", got {excerpt(_at(value, keys))}"
        yield Problem(keys, f"expected {describe(around)}{actual}")


def _misplaced(schema: Schema, value: Mapping[str, Any], keys: tuple[str | int, ...]) -> Iterator[Problem]:
    """Yields the fields that are there, or are not, against `x-when`, in a value that is otherwise sound."""
    parts = schema.get("properties", {})
    for name, part in parts.items():
        if "x-when" in part and value.get("type", parts["type"].get("default")) not in part["x-when"]:
            if name in value:
                yield Problem((*keys, name), f"only where type is {' or '.join(part['x-when'])}")
            continue
        if name not in value and "x-when" in part and "default" not in part:
            yield Problem((*keys, name), f"is missing; expected {describe(part)}")
        inner = value.get(name, part.get("default"))
        if part.get("type") == "object" and inner is not None:
            yield from _misplaced(part, inner, (*keys, name))
        elif part.get("items", {}).get("type") == "object" and inner is not None:
            for index, item in enumerate(inner):
                yield from _misplaced(part["items"], item, (*keys, name, index))


def _at(value: Any, keys: Iterable[str | int]) -> Any:
    for key in keys:
        value = value[str(key) if isinstance(value, Mapping) else key]  # paths have names such as "1" as numbers
    return value


def complete(schema: Schema, value: Mapping[str, Any]) -> JsonObject:
    """Returns a sound document with its defaults filled in; fields that hold a whole number become ints.

    A field with `x-when` is filled in only where `type` is one of those. What stands in the document keeps its order,
    what is filled in follows in the schema's.
    """
    full = dict(value)
    for name, part in schema.get("properties", {}).items():
        if "x-when" in part and full["type"] not in part["x-when"]:
            continue
        if name in full:
            full[name] = _completed(part, full[name])
        elif "default" in part:
            full[name] = _completed(
                part, orjson.loads(orjson.dumps(part["default"]))
            )  # several times faster than deepcopy
    return full


def _completed(schema: Schema, value: Any) -> Any:
    kind = schema.get("type")
    if kind == "object":
        return complete(schema, value)
    if kind == "integer":
        return int(value)  # to JSON Schema 1.0 is an integer too
    if kind == "array":
        items = schema.get("items", {})
        inner = items.get("type") in ("object", "integer", "array")
        return [_completed(items, item) for item in value] if inner else value
    if isinstance(value, dict) and isinstance(kind, list) and "object" in kind:
        return complete(schema, value)
    return int(value) if isinstance(value, float) and isinstance(kind, list) and "integer" in kind else value


# -- names ------------------------------------------------------------------------------------------------------------


def canonical_hash(document: Any) -> str:
    """Returns the SHA-256 of a document in canonical form, 64 hexadecimal digits.

    Canonical is: UTF-8, no white space, keys sorted by their code points, whole numbers below 2^53 without a
    fraction (`10` for `10.0`), others as the shortest decimal that is the same double.
    """
    return hashlib.sha256(orjson.dumps(_canonical(document), option=orjson.OPT_SORT_KEYS)).hexdigest()


def _canonical(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _canonical(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_canonical(item) for item in value]
    if isinstance(value, float) and value.is_integer() and abs(value) < _WHOLE:
        return int(value)
    if isinstance(value, int) and not -(2**63) <= value < 2**64:  # to whoever reads it, it is a double
        try:
            return float(value)
        except OverflowError:
            raise DocumentError([("", "a whole number is greater than any double")]) from None
    return value


@dataclass(frozen=True, slots=True)
class ShippedDocuments:
    """The documents of one kind that ship with the package, a file each.

    Attributes:
        kind: What one is called in messages, as in "there is no task".
        package: The package that has the files.
        folder: The folder inside it.
    """

    kind: str
    package: str
    folder: str

    def names(self) -> tuple[str, ...]:
        """Returns the names of all of them, sorted."""
        entries = (entry.name for entry in (files(self.package) / self.folder).iterdir())
        return tuple(sorted(name.removesuffix(".json") for name in entries if name.endswith(".json")))

    def shipped(self, name: str) -> bytes:
        """Returns the bytes of the shipped document of a name, which is one of `names`, whatever files there are."""
        return (files(self.package) / self.folder / f"{name}.json").read_bytes()

    def read(self, name: str | Path) -> bytes:
        """Returns the bytes of the file at a path or, where there is none, of the shipped document of that name.

        Raises:
            DocumentError: There is neither, or the file cannot be read, or is too large.
        """
        try:
            with Path(name).open("rb") as file:
                text = file.read(_FILE + 1)
        except (FileNotFoundError, IsADirectoryError, NotADirectoryError) as error:
            names = self.names()
            if str(name) in names:
                return self.shipped(str(name))
            hint = did_you_mean(str(name), names) or f"; there are {', '.join(names)}"
            message = f"there is no {self.kind} {str(name)!r}, nor such a file ({error.strerror}){hint}"
            raise DocumentError([("", message)]) from error
        except OSError as error:
            raise DocumentError([("", f"cannot read {name}: {error.strerror}")]) from error
        except ValueError as error:  # a path with NUL
            raise DocumentError([("", f"there is no {self.kind} {str(name)!r}: {error}")]) from error
        if len(text) > _FILE:
            raise DocumentError([("", f"{name} has over {_FILE >> 20} MiB, more than a {self.kind} may have")])
        return text


# -- words ------------------------------------------------------------------------------------------------------------


def fits(pattern: str) -> Callable[[str], bool]:
    """Returns what tells whether a name fits a pattern: `*` stands for any characters, also none, and `?` for any one.

    A name takes time in proportion to its length times the pattern's at most, whatever they are.
    """
    if "*" not in pattern and "?" not in pattern:  # as of most sensors: without an expression to compile and to match
        return lambda name: name == pattern
    first, *middle = (re.escape(piece).replace(r"\?", ".") for piece in pattern.split("*"))
    last = f".*{middle.pop()}" if middle else ""
    # Each piece is sought once, from where the one before it was found first: atomic groups never try another place.
    between = "".join(f"(?>.*?{piece})" for piece in middle if piece)
    match = re.compile(f"{first}{between}{last}", re.DOTALL).fullmatch
    return lambda name: match(name) is not None


def did_you_mean(name: str | int, known: Iterable[str]) -> str:
    """Returns `; did you mean leg?`, to stand behind a message about an unknown name, or nothing if none is near.

    Only so much of names, and so many of them, are compared that a message costs little.
    """
    matcher = difflib.SequenceMatcher(b=str(name)[:_COMPARED])
    rough = []
    for other in islice(known, _KNOWN):
        matcher.set_seq1(other[:_COMPARED])
        if matcher.real_quick_ratio() >= _ALIKE and (ratio := matcher.quick_ratio()) >= _ALIKE:
            rough.append((ratio, other))
    near = []
    for _, other in nlargest(_CLOSE, rough):
        matcher.set_seq1(other[:_COMPARED])
        near.append((matcher.ratio(), other))
    ratio, other = max(near, default=(0.0, ""))
    return f"; did you mean {other}?" if ratio >= _ALIKE else ""


def nor_at(places: Sequence[str]) -> str:
    """Returns ` (nor at body/joints/2/cube1)`, for a message about what is not there; nothing without other places.

    Args:
        places: JSON Pointers of the other places where the same is wrong.
    """
    if not places:
        return ""
    more = f" and {len(places) - _PLACES} more" if len(places) > _PLACES else ""
    return f" (nor at {', '.join(places[:_PLACES])}{more})"


def excerpt(value: Any) -> str:
    """Returns the beginning of a value's JSON, for a message: `<` escaped, as it is on the wire."""
    return _cut(write_json(value).decode().replace("<", "\\u003c"))


def _cut(text: str) -> str:
    return text if len(text) <= _EXCERPT else text[: _EXCERPT - 3] + "..."
