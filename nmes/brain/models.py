"""Brains from elsewhere: an ONNX model, run by onnxruntime, which is an extra.

This module hides how a model is held to the promises of all brains. It runs on one thread, operators in sequence, on
the processor. A model that draws random numbers, or that reads other files, is refused before it is run. The weights
are found in the model's bytes, in the Protobuf of ONNX, and exchanged in place: nothing else of it is touched.

A model is still a program: it may take as long and as much memory as it likes.
"""

from __future__ import annotations

import base64
import binascii
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from nmes.brain.arithmetic import weigh
from nmes.brain.base import Array, Brain, Findings, JsonObject, Kernel, Parameter
from nmes.brain.naming import Entries, Inputs, Outputs
from nmes.errors import MissingPackage

__all__ = ["OnnxBrain", "message_fields", "read_varint"]

Bytes = NDArray[np.uint8]

_MOST_TRIED: Final = 4096  # inputs that a model is fed for which it is not meant
_FLOAT_MAX: Final = float(np.finfo(np.float32).max)
_TYPES: Final[dict[str, np.dtype[Any]]] = {
    "tensor(float)": np.dtype(np.float32),
    "tensor(double)": np.dtype(np.float64),
}
_RANDOM: Final = {
    *("Bernoulli", "Multinomial", "RandomNormal", "RandomNormalLike", "RandomUniform", "RandomUniformLike"),
    "Sampling",  # of the domain com.microsoft
}

# -- what is in the bytes ---------------------------------------------------------------------------------------------

# Which fields of a message hold further messages, and of what kind: https://github.com/onnx/onnx/blob/main/onnx/onnx.proto
_INSIDE: Final = {
    "model": {7: "graph", 25: "function"},
    "function": {7: "node", 11: "attribute"},
    "graph": {1: "node", 5: "tensor", 15: "sparse"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse", 23: "sparse"},
    "sparse": {1: "tensor", 2: "tensor"},
    "tensor": {},
}
_INPUT, _OP_TYPE = 1, 4  # of a node
_DATA_TYPE, _EXTERNAL_DATA, _DATA_LOCATION, _RAW_DATA = 2, 13, 14, 9  # of a tensor
_FLOAT_DATA, _DOUBLE_DATA = 4, 10
_NUMBERS: Final = {(1, _RAW_DATA): "<f4", (1, _FLOAT_DATA): "<f4", (11, _RAW_DATA): "<f8", (11, _DOUBLE_DATA): "<f8"}
_LAST_FIELD: Final = 2**29 - 1
_DEEPEST: Final = 64
_MOST_FIELDS: Final = 200_000  # of all messages; a model has some for each node and tensor

_Field = tuple[int, int, int, int]  # number, value if it is a whole number, where its bytes begin and end


@dataclass
class _Contents:
    """The contents of a model that matter here."""

    weights: list[tuple[int, int, str]] = field(default_factory=list)  # where numbers begin and end, and their type
    random: set[str] = field(default_factory=set)
    external: bool = False
    fields: int = 0


def read_varint(model: bytes, at: int, end: int) -> tuple[int, int]:
    """Returns a whole number, and where it ends.

    Raises:
        ValueError: It does not end.
    """
    value = shift = 0
    while at < end and shift < 70:
        byte = model[at]
        at += 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value, at
        shift += 7
    raise ValueError("a number has no end")


def message_fields(model: bytes, start: int, end: int) -> Iterator[_Field]:
    """Yields the fields of a message.

    Raises:
        ValueError: These bytes are no message.
    """
    at = start
    while at < end:
        tag, at = read_varint(model, at, end)
        number, wire = divmod(tag, 8)
        if number > _LAST_FIELD:  # other readers cut off the bits above, and see another field
            raise ValueError(f"there is no field {number}")
        value, at = read_varint(model, at, end) if wire in (0, 2) else (0, at)
        begin = at
        if wire not in (0, 1, 2, 5):
            raise ValueError(f"there is no wire type {wire}")
        at += {0: 0, 1: 8, 2: value, 5: 4}[wire]
        if at > end:
            raise ValueError("a field is longer than what holds it")
        yield number, value, begin, at


def _look(model: bytes, kind: str, start: int, end: int, contents: _Contents, weights: bool, depth: int) -> None:
    """Looks through a message; `weights` if its tensors are the main graph's, which are parameters."""
    if depth > _DEEPEST:
        raise ValueError("messages are nested too deeply")
    fields = list(islice(message_fields(model, start, end), _MOST_FIELDS + 1 - contents.fields))
    contents.fields += len(fields)
    if contents.fields > _MOST_FIELDS:
        raise ValueError(f"it has more than {_MOST_FIELDS:,} fields")
    for number, _, begin, stop in fields:
        if number in _INSIDE[kind]:
            inner = _INSIDE[kind][number]
            main = (kind, inner) == ("model", "graph") or (weights and inner == "tensor" and kind == "graph")
            _look(model, inner, begin, stop, contents, main, depth + 1)
    if kind == "node":
        names = {model[begin:stop].decode(errors="replace") for number, _, begin, stop in fields if number == _OP_TYPE}
        contents.random |= names & _RANDOM
        inputs = [stop > begin for number, _, begin, stop in fields if number == _INPUT]
        if any(inputs[2:]):  # the third tells a Dropout whether it is in training
            contents.random |= names & {"Dropout"}
    if kind == "tensor":
        contents.external |= any(
            number == _EXTERNAL_DATA or (number == _DATA_LOCATION and value) for number, value, _, _ in fields
        )
        data_type = max((value for number, value, _, _ in fields if number == _DATA_TYPE), default=0)
        for number, _, begin, stop in fields:
            if weights and (data_type, number) in _NUMBERS:
                contents.weights.append((begin, stop, _NUMBERS[data_type, number]))


class _Weights(dict[str, Any]):
    """A document's model as something whose weights are read and written like a row of parameters."""

    def __init__(self, document: JsonObject, places: Sequence[tuple[int, int, str]]) -> None:
        super().__init__()
        self._document = document
        self._places = places

    def __getitem__(self, key: str) -> Array:
        model = base64.b64decode(self._document["model"])
        return np.concatenate([np.empty(0), *(_numbers(model, place) for place in self._places)])

    def __setitem__(self, key: str, weights: Array) -> None:
        model = bytearray(base64.b64decode(self._document["model"]))
        at = 0
        for begin, end, kind in self._places:
            count = (end - begin) // np.dtype(kind).itemsize
            model[begin:end] = weights[at : at + count].astype(kind).tobytes()
            at += count
        self._document["model"] = base64.b64encode(model).decode()


def _numbers(model: bytes, place: tuple[int, int, str]) -> Array:
    begin, end, kind = place
    return np.frombuffer(model, kind, (end - begin) // np.dtype(kind).itemsize, begin).astype(np.float64)


# -- the brain --------------------------------------------------------------------------------------------------------


def _session(model: bytes) -> Any:
    """Returns the model, ready to run.

    Raises:
        MissingPackage: onnxruntime is not installed.
        ValueError: onnxruntime refuses the model.
    """
    try:
        import onnxruntime
    except ImportError as error:
        raise MissingPackage("an onnx brain needs onnxruntime: pip install 'nmes[onnx]'") from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.use_deterministic_compute = True
    # Not in a format of its own, which a model may have too, and which nobody here has looked through.
    options.add_session_config_entry("session.load_model_format", "ONNX")
    options.log_severity_level = 4  # what is wrong is raised, and need not be printed too
    try:
        return onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # its exceptions have no base of their own
        raise ValueError(str(error)) from error


def _sizes(node: Any, free: int) -> list[int]:
    """Returns the shape of an input or output; what the model leaves open is `free` in the last place, else 1."""
    last = len(node.shape) - 1
    return [size if isinstance(size, int) else free if i == last else 1 for i, size in enumerate(node.shape)]


class OnnxKernel(Kernel):
    """One session for each brain."""

    def __init__(self, entries: Entries, models: Bytes) -> None:
        """Takes the bytes of models (*lead, bytes)."""
        count, sensors = entries.counts["inputs"], len(entries.owners["inputs"])
        lead = models.shape[:-1]
        self._sessions = [_session(model.tobytes()) for model in models.reshape(-1, models.shape[-1])]
        ins, outs = self._sessions[0].get_inputs(), self._sessions[0].get_outputs()
        self._names = [outs[0].name]
        self._sums = np.zeros((count, sensors + 1))
        self._sums[:, :sensors] = entries.spread(np.eye(count))
        self._row = np.zeros((*lead, sensors + 1))
        self._inputs = Inputs(self._row, sensors)
        self._seen = np.zeros((*lead, count))
        self._fed = np.zeros((len(self._sessions), *_sizes(ins[0], count)), _TYPES[ins[0].type])
        self._feeds = [{ins[0].name: fed} for fed in self._fed]
        self._raw = np.zeros((*lead, entries.counts["outputs"]))
        self._outputs = Outputs(entries.owners["outputs"], unbounded=True)

    def reset(self, seeds: Sequence[int], dt: float) -> None:
        """Has nothing to forget."""

    def step(self, inputs: Array) -> Array:
        """Goes one control step on."""
        self._inputs.read(inputs)
        weigh(self._sums, self._row, self._seen)
        self._fed[...] = self._seen.reshape(self._fed.shape)
        rows = self._raw.reshape(len(self._sessions), -1)
        for session, feed, row in zip(self._sessions, self._feeds, rows, strict=True):
            row[...] = session.run(self._names, feed)[0].reshape(-1)
        np.nan_to_num(rows, copy=False, nan=0.0)
        return self._outputs.pick(self._raw)


class OnnxBrain(Brain):
    """An ONNX model (`schemas/brain-onnx.json`)."""

    kind = "onnx"

    def _resolve(self, document: JsonObject, findings: Findings) -> None:
        self._entries = Entries(self, document, findings)
        self._places: list[tuple[int, int, str]] = []
        try:
            model = base64.b64decode(document["model"], validate=True)
        except binascii.Error as error:
            findings.add("model", f"is not base64: {error}")
            return
        contents = _Contents()
        try:
            _look(model, "model", 0, len(model), contents, False, 0)
        except ValueError as error:
            findings.add("model", f"is no ONNX model: {error}")
            return
        if contents.random:
            findings.add("model", f"draws random numbers ({', '.join(sorted(contents.random))})")
        if contents.external:
            findings.add("model", "keeps numbers in other files; a brain must hold all of its own")
        # What stands for no number, as a bound of infinity does, or is beyond what a parameter may be is left as it is.
        self._places = [place for place in contents.weights if (abs(_numbers(model, place)) <= _FLOAT_MAX).all()]
        if not (contents.random or contents.external):
            self._try(model, findings)

    def _try(self, model: bytes, findings: Findings) -> None:
        try:
            session = _session(model)
        except ValueError as error:
            findings.add("model", f"onnxruntime refuses it: {error}")
            return
        sides = {"inputs": session.get_inputs(), "outputs": session.get_outputs()}
        for side, nodes in sides.items():
            if len(nodes) != 1 or nodes[0].type not in _TYPES:
                tensors = ", ".join(f"{node.name}: {node.type}" for node in nodes)
                message = f"must have one tensor of floats or doubles for its {side}, has {tensors or 'none'}"
                findings.add("model", message)
                return
        count = math.prod(self._shape_of(session))
        self._entries.expect(findings, "model", count, "inputs", "inputs")
        if count > max(self._entries.counts["inputs"], _MOST_TRIED):
            return  # it cannot be fed by what it is for, and its zeros alone may fill the memory
        (node,) = sides["inputs"]
        fed = np.zeros(self._shape_of(session), _TYPES[node.type])
        try:
            (output,) = session.run(None, {node.name: fed})
        except Exception as error:  # its exceptions have no base of their own
            findings.add("model", f"fails on inputs of 0: {error}")
            return
        self._entries.expect(findings, "model", output.size, "outputs", "outputs")

    def _shape_of(self, session: Any) -> list[int]:
        return _sizes(session.get_inputs()[0], self._entries.counts["inputs"])

    def _parameters(self, document: JsonObject) -> Iterator[Parameter]:
        yield _Weights(document, self._places), "model", -_FLOAT_MAX, _FLOAT_MAX

    def _arrays(self) -> tuple[NDArray[Any], ...]:
        return (np.frombuffer(base64.b64decode(self._document["model"]), np.uint8),)

    def _run(self, *arrays: NDArray[Any]) -> Kernel:
        return OnnxKernel(self._entries, *arrays)
