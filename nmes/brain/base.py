"""What all brains share: documents and their numbers, names and wildcards, and how a brain is run.

A brain is two things. A `Brain` is a checked document, tied to the names of a body's sensors and motors; it never
changes. A `Kernel` is what runs: arrays, buffers, a clock of its own. Kernels are written for any number of brains at
once: their arrays may have an axis in front, so that one brain and a batch of brains run the very same code.

Invariants. A row of a batch is bit-equal to that brain alone, whatever the batch: sums and functions are those of
`nmes.brain.arithmetic`, and all else is added and multiplied element by element. Nothing depends on anything but the
document, the seed, dt, the inputs and the C library. Outputs are finite and from -1 to 1.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
import orjson
from numpy.typing import NDArray

from nmes.backend.arrays import ArrayLike, floats
from nmes.errors import DocumentError
from nmes.schemas import Schema
from nmes.schemas.documents import (
    CompiledSchema,
    JsonObject,
    compile_schema,
    complete,
    did_you_mean,
    fits,
    nor_at,
    plain,
    problems,
    without,
)

__all__ = [
    "LIMIT",
    "Array",
    "Brain",
    "BrainBatch",
    "Findings",
    "Indices",
    "JsonObject",
    "Kernel",
    "OpenLoop",
    "Parameter",
    "stack",
]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

LIMIT = 1e6
"""What goes through a brain, sensors' values first, is kept within this, so that no sum overflows."""

_BLOCK = 64  # steps of an open-loop brain that are computed at once
_SENSORS, _MOTORS = 4096, 1024  # at most
_WILDCARDS = 256  # entries with wildcards in one document: each is held against all names
_LISTED = 12  # names that a message lists


# -- documents --------------------------------------------------------------------------------------------------------


class Findings:
    """Collects the problems of a document, and matches its names and wildcards.

    All its methods raise DocumentError where there are more problems than one lists.
    """

    def __init__(self, where: str, unsure: Collection[str] = ()) -> None:
        """Begins without problems.

        Args:
            where: The JSON Pointer of the document itself.
            unsure: `sensors` or `motors`, where the body may have others of them than are known: what is not known then
                is no problem, nor is how many there are.
        """
        self._where = where
        self.unsure = unsure
        self._found: list[tuple[str, str]] = []
        self._unknown: dict[tuple[str, str], tuple[int, str, list[str]]] = {}  # index, hint, where else
        self._wildcards = 0

    def add(self, pointer: str, message: str) -> None:
        """Notes a problem with the value at a pointer."""
        self._found.append((self._place(pointer), message))
        if len(self._found) > DocumentError.MOST:
            self.check()

    def check(self) -> None:
        """Raises DocumentError if anything was wrong."""
        if self._found:
            raise DocumentError(self._found)

    def match(self, entry: str, names: Sequence[str], what: str, pointer: str) -> list[int]:
        """Returns the indices of the names that an entry stands for: its own, else those that fit its wildcards."""
        if entry in names:
            return [names.index(entry)]
        indices = []
        if "*" in entry or "?" in entry:
            self._wildcards += 1
            if self._wildcards > _WILDCARDS:
                self.add(pointer, f"a brain has at most {_WILDCARDS} entries with wildcards")
                self.check()
            fitting = fits(entry)
            indices = [i for i, name in enumerate(names) if fitting(name)]
        if not indices:
            self.unknown(entry, names, what, pointer)
        return indices

    def unknown(self, name: str, names: Sequence[str], what: str, pointer: str) -> None:
        """Notes that there is no such name."""
        if f"{what}s" in self.unsure:
            self._unknown.setdefault((name, what), (0, "", []))
            return
        if (name, what) in self._unknown:
            index, near, others = self._unknown[name, what]
            others.append(self._place(pointer))
            self._found[index] = (self._found[index][0], f"there is no {what} {name!r}{nor_at(others)}{near}")
            return
        near = did_you_mean(name, names) or f"; there {_list(names, what)}"
        self._unknown[name, what] = len(self._found), near, []
        self.add(pointer, f"there is no {what} {name!r}{near}")

    def is_unknown(self, name: str, what: str) -> bool:
        """Whether it was noted that there is no such name."""
        return (name, what) in self._unknown

    def _place(self, pointer: str) -> str:
        return "/".join(filter(None, (self._where, pointer)))

    def owners(self, entries: Sequence[str], names: Sequence[str], what: str, pointers: Sequence[str]) -> list[int]:
        """Deals names out to entries; returns for each name the index of its entry, or -1.

        A name belongs to the entry that is this very name, else to the first entry whose wildcards fit it.
        """
        owner = [-1] * len(names)
        matches = [self.match(entry, names, what, at) for entry, at in zip(entries, pointers, strict=True)]
        exact = [number for number, entry in enumerate(entries) if entry in names]
        others = [number for number, entry in enumerate(entries) if entry not in names]
        for number in exact + others:
            free = [i for i in matches[number] if owner[i] < 0]
            if matches[number] and not free:
                self.add(pointers[number], f"every {what} that {entries[number]!r} stands for has another entry")
            for i in free:
                owner[i] = number
        return owner


def _list(names: Sequence[str], what: str) -> str:
    if not names:
        return f"are no {what}s at all"
    more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return f"{'is' if len(names) == 1 else 'are'} {', '.join(names[:_LISTED])}{more}"


def _with_arrays(schema: Schema, document: JsonObject) -> JsonObject:
    """Returns a complete document with its parameters as floats, and its rows of parameters as arrays."""
    return {name: _with_array(schema["properties"][name], value) for name, value in document.items()}


def _with_array(part: Schema, value: Any) -> Any:
    if part.get("type") == "object":
        return _with_arrays(part, value)
    if _is_row(part):
        return np.array(value, np.float64)
    if part.get("type") == "array":
        return [_with_array(part["items"], item) for item in value]
    return float(value) if part.get("x-parameter") else value


def _is_row(part: Schema) -> bool:
    """Whether this is an array of parameters, or of rows of them."""
    items = part.get("items", {})
    return bool(items.get("x-parameter")) or (items.get("type") == "array" and _is_row(items))


def _plain(value: Any) -> Any:
    """Returns a copy of a document with lists in the place of arrays."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return value.tolist() if isinstance(value, np.ndarray) else value


Parameter = tuple[Any, Any, float, float]
"""Where a parameter, or an array of them, stands: container, key; and its least and greatest value."""


def _parameters(schema: Schema, value: JsonObject) -> Iterator[Parameter]:
    """Yields where a filled document's parameters stand, in the order of the schema, and their bounds."""
    for name, part in schema["properties"].items():
        if part.get("x-parameter"):
            yield value, name, part["minimum"], part["maximum"]
        elif _is_row(part):
            while "items" in part:
                part = part["items"]
            yield value, name, part["minimum"], part["maximum"]
        elif part.get("items", {}).get("type") == "object":
            for item in value[name]:
                yield from _parameters(part["items"], item)


# -- what runs --------------------------------------------------------------------------------------------------------


class Kernel(ABC):
    """The running part of one brain or of many; `lead` is the shape in front of its arrays, () or (brains,)."""

    open_loop = False
    _lead: tuple[int, ...] = ()

    @abstractmethod
    def reset(self, seeds: Sequence[int], dt: float) -> None:
        """Goes to the start; one seed a brain; `dt` is a control step, s."""

    @abstractmethod
    def step(self, inputs: Array) -> Array:
        """Goes one control step on: inputs (*lead, sensors), outputs (*lead, motors) in a buffer that is reused."""

    def controls(self, ticks: int) -> Array:
        """Goes many steps on; returns the outputs (ticks, *lead, motors). Only if `open_loop`."""
        raise ValueError("this brain needs its sensors: only step by step can it be known what it does")

    def memory(self) -> Array:
        """Returns its state after its steps, (*lead, k): with `recall` it goes on bit for bit."""
        return np.empty((*self._lead, 0))

    def activity(self) -> Array:
        """Returns the activity of its units in the last step, (*lead, k); none where inputs decide it."""
        return np.empty((*self._lead, 0))

    def recall(self, memory: Array) -> None:
        """Takes up what `memory` of a kernel of the same arrays, seeds and dt returned; after `reset`.

        Raises:
            ValueError: It is none of this kernel.
        """
        if memory.shape != self.memory().shape or not np.isfinite(memory).all():
            raise ValueError("this is no memory of this brain")
        self._take_up(memory)

    def _take_up(self, memory: Array) -> None:
        """Takes up a memory of the right shape, and finite."""
        return


class OpenLoop(Kernel):
    """A kernel that looks at nothing and so computes many steps at once."""

    open_loop = True

    def reset(self, seeds: Sequence[int], dt: float) -> None:
        """Goes to the start."""
        self._block = self._more(0)
        self._next = 0
        self._begun = self._moment()  # when the block was begun

    @abstractmethod
    def _more(self, count: int) -> Array:
        """Computes the next steps' outputs (count, *lead, motors)."""

    @abstractmethod
    def _moment(self) -> Array:
        """Returns the state from which the next `_more` follows, (*lead, k)."""

    @abstractmethod
    def _go_to(self, moment: Array) -> None:
        """Goes to where `_moment` was asked."""

    def memory(self) -> Array:
        """Returns its state: the beginning of its block, and how much of that is done."""
        begun, done = (self._moment(), 0) if self._next == len(self._block) else (self._begun, self._next)
        return np.concatenate([begun, np.full((*self._lead, 1), float(done))], axis=-1)

    def _take_up(self, memory: Array) -> None:
        done = float(memory[..., -1].flat[0])
        if not (done.is_integer() and 0 <= done < _BLOCK):
            raise ValueError("this is no memory of this brain")
        self._begun = memory[..., :-1].copy()
        self._go_to(self._begun)
        self._block, self._next = self._more(_BLOCK if done else 0), int(done)

    def step(self, inputs: Array) -> Array:
        """Goes one control step on."""
        if self._next == len(self._block):
            self._begun = self._moment()
            self._block = self._more(_BLOCK)
            self._next = 0
        row: Array = self._block[self._next]
        self._next += 1
        return row

    def controls(self, ticks: int) -> Array:
        """Goes many steps on; returns the outputs (ticks, *lead, motors)."""
        head = self._block[self._next : self._next + ticks]
        self._next += len(head)
        rest = ticks - len(head)
        if rest == 0:
            return head.copy()
        return np.concatenate([head, self._more(rest)]) if len(head) else self._more(rest)


# -- brains -----------------------------------------------------------------------------------------------------------


class Brain(ABC):
    """A controller as a document describes it, tied to the sensors and motors of a body.

    Attributes:
        inputs: Names of the sensors, in the order of `step`'s inputs.
        outputs: Names of the motors, in the order of `step`'s outputs.
    """

    kind: ClassVar[str]
    shape: ClassVar[CompiledSchema]

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        cls.shape = compile_schema(f"brain-{cls.kind}.json")

    def __init__(
        self,
        document: Mapping[str, Any],
        inputs: Sequence[str],
        outputs: Sequence[str],
        where: str = "",
        unsure: Collection[str] = (),
    ) -> None:
        """Checks a document; see `load_brain`."""
        self.inputs = tuple(inputs)
        self.outputs = tuple(outputs)
        findings = Findings(where, unsure)
        for names, most, what in ((self.inputs, _SENSORS, "sensors"), (self.outputs, _MOTORS, "motors")):
            if len(names) > most:
                findings.add("", f"the body has {len(names):,} {what}; a brain can have {most:,}")
        try:
            self._given: JsonObject = plain(document)
        except DocumentError as error:
            raise DocumentError([(f"{where}/{path}".strip("/"), words) for path, words in error.problems]) from None
        sound = self._sound(findings)
        if not self._even_rows(findings, self.shape.schema, sound, ""):
            findings.check()
        self._document = _with_arrays(self.shape.schema, complete(self.shape.schema, sound))
        self._resolve(self._document, findings)
        findings.check()
        self._kernel: Kernel | None = None
        self._form: str | None = None

    def _sound(self, findings: Findings) -> JsonObject:
        """Returns the parts of the document that fit its schema; raises where without the rest it is no brain."""
        unsound = []
        for problem in problems(self.shape, self._given):
            findings.add(problem.pointer, problem.message)
            unsound.append(problem)
        if not unsound:
            return self._given
        sound: JsonObject = without(self._given, unsound)
        if next(problems(self.shape, sound), None) is not None:
            findings.check()
        return sound

    def _even_rows(self, findings: Findings, schema: Schema, value: JsonObject, path: str) -> bool:
        """Notes rows of unequal length; tells whether there are none."""
        even = True
        for name, part in schema["properties"].items():
            here = path + name
            if name in value and _is_row(part) and part["items"].get("type") == "array":
                for number, row in enumerate(value[name]):
                    if len(row) != len(value[name][0]):
                        findings.add(f"{here}/{number}", f"has {len(row)} numbers, the first row {len(value[name][0])}")
                        even = False
            elif part.get("items", {}).get("type") == "object":
                for number, item in enumerate(value.get(name, ())):
                    even &= self._even_rows(findings, part["items"], item, f"{here}/{number}/")
        return even

    # What a kind of brain provides:

    @abstractmethod
    def _resolve(self, document: JsonObject, findings: Findings) -> None:
        """Looks names up and compares lengths; keeps what follows from them and not from the parameters."""

    @abstractmethod
    def _arrays(self) -> tuple[NDArray[Any], ...]:
        """Returns the parameters in the form that the kernel wants; brains of one form can be stacked."""

    @abstractmethod
    def _run(self, *arrays: NDArray[Any]) -> Kernel:
        """Returns a kernel for these arrays, which all have the same axes in front."""

    # What brains do:

    @property
    def open_loop(self) -> bool:
        """Whether it looks at no sensor: `step` may then be given anything, and `controls` knows it all at once."""
        return self._running().open_loop

    @property
    def document(self) -> JsonObject:
        """The document as it was given, nothing filled in: a new copy, plain JSON data.

        That of a brain from `with_vector` is whole, since what was left out is a parameter too. Loading either gives
        this brain again.
        """
        return copy.deepcopy(self._given)

    def reset(self, seed: int, dt: float) -> None:
        """Goes to the start.

        Args:
            seed: Of whatever the brain draws; from 0.
            dt: A control step, s: the brain's time is the number of its steps times this.
        """
        self._running().reset((seed,), dt)

    def step(self, inputs: ArrayLike) -> Array:
        """Goes one control step on, from what sensors read to what motors shall do; after `reset`.

        Args:
            inputs: Shape (sensors,), finite.

        Returns:
            Shape (motors,), each from -1 to 1: a buffer, which the next step may reuse.
        """
        assert self._kernel is not None, "reset comes first"
        return self._kernel.step(floats(inputs, "inputs"))

    def controls(self, ticks: int) -> Array:
        """Goes many steps on; returns their outputs, shape (ticks, motors), bit for bit as `step` would give them.

        Raises:
            ValueError: The brain is not `open_loop`.
        """
        return self._running().controls(ticks)

    def memory(self) -> Array:
        """Returns its state after its steps since `reset`, shape (k,): with `recall` it goes on bit for bit."""
        return self._running().memory()

    def activity(self) -> Array:
        """Returns the activity of its units in the last step, in the document's order, shape (k,), mostly from -1 to 1.

        They are the neurons of a `ctrnn`, each tanh((y + bias) / 2), and the nodes of a `graph`; of other kinds there
        are none, since what those do is what motors are told, or follows from what was sensed alone.
        """
        return self._running().activity()

    def recall(self, memory: Array) -> None:
        """Goes on where `memory` was asked of a brain of the same document; after `reset` with the same seed and dt.

        Raises:
            ValueError: It is no memory of such a brain.
        """
        self._running().recall(memory)

    def _running(self) -> Kernel:
        if self._kernel is None:
            self._kernel = self._run(*self._arrays())
        return self._kernel

    def to_vector(self) -> Array:
        """Returns all parameters (what the schema marks with `x-parameter`), in the order of the document."""
        parts = [np.ravel(where[key]) for where, key, _, _ in self._parameters(self._document)]
        return np.concatenate([np.empty(0), *parts])

    def with_vector(self, vector: ArrayLike) -> Brain:
        """Returns this brain with other parameters.

        Args:
            vector: As many numbers as `to_vector` gives. What is out of a parameter's bounds is put on the bound.

        Raises:
            DocumentError: There are too few or too many numbers, or some are not finite.
        """
        try:
            vector = floats(vector, "parameters")
        except ValueError as error:
            raise DocumentError([("", str(error))]) from None
        other = copy.copy(self)
        other._kernel = None
        other._document = copy.deepcopy(self._document)
        places = list(self._parameters(other._document))
        count = sum(np.size(where[key]) for where, key, _, _ in places)
        if vector.shape != (count,):
            raise DocumentError([("", f"this brain has {count} parameters; the vector has shape {vector.shape}")])
        if not np.isfinite(vector).all():
            raise DocumentError([("", f"number {int(np.argmin(np.isfinite(vector)))} of the vector is not finite")])
        at = 0
        for where, key, low, high in places:
            size = np.size(where[key])
            part = np.clip(vector[at : at + size], low, high)
            where[key] = part.reshape(where[key].shape) if isinstance(where[key], np.ndarray) else float(part[0])
            at += size
        other._given = _plain(other._document)
        return other

    def _parameters(self, document: JsonObject) -> Iterator[Parameter]:
        return _parameters(self.shape.schema, document)

    def form(self) -> str:
        """Returns everything about the brain but its parameters, as text: brains of the same form can be stacked."""
        if self._form is None:  # it takes as long as dozens of steps, and other parameters leave it as it is
            bare = copy.deepcopy(self._document)
            for where, key, _, _ in self._parameters(bare):
                where[key] = np.zeros(np.shape(where[key]))[()]
            self._form = orjson.dumps([self.inputs, self.outputs, bare], option=orjson.OPT_SERIALIZE_NUMPY).decode()
        return self._form


class BrainBatch:
    """Brains of the same form that are run together; see `stack`.

    Attributes:
        inputs: Names of the sensors.
        outputs: Names of the motors.
    """

    def __init__(self, brains: Sequence[Brain]) -> None:
        """See `stack`."""
        if not brains:
            raise ValueError("there are no brains to stack")
        form = brains[0].form()
        for number, brain in enumerate(brains):
            if brain.form() != form:
                raise ValueError(f"brain {number} differs from brain 0 by more than its parameters")
        self.inputs = brains[0].inputs
        self.outputs = brains[0].outputs
        self._count = len(brains)
        arrays = zip(*(brain._arrays() for brain in brains), strict=True)
        self._kernel = brains[0]._run(*(np.stack(same) for same in arrays))

    def __len__(self) -> int:
        return self._count

    @property
    def open_loop(self) -> bool:
        """Whether the brains look at no sensor."""
        return self._kernel.open_loop

    def reset(self, seeds: Sequence[int], dt: float) -> None:
        """Goes to the start: a seed for each brain; `dt` is a control step, s."""
        if len(seeds) != self._count:
            raise ValueError(f"there are {self._count} brains and {len(seeds)} seeds")
        self._kernel.reset(seeds, dt)

    def step(self, inputs: ArrayLike) -> Array:
        """Goes one control step on: inputs (brains, sensors), outputs (brains, motors) in a buffer that is reused."""
        return self._kernel.step(floats(inputs, "inputs"))

    def controls(self, ticks: int) -> Array:
        """Goes many steps on; returns their outputs, shape (ticks, brains, motors).

        Raises:
            ValueError: The brains are not `open_loop`.
        """
        return self._kernel.controls(ticks)


def stack(brains: Sequence[Brain]) -> BrainBatch:
    """Returns brains that are run together, each row bit-equal to the brain alone.

    Raises:
        ValueError: There are none, or they differ by more than their parameters.
    """
    return BrainBatch(brains)
