"""What an ONNX model computes, without what it is called: copies whose names and words differ come to the same.

    computation(model, inputs)  # plain data

Hides the Protobuf of ONNX and the order in which a model is written down. Values are known by numbers, counted from the
outputs back to the inputs, so that only what has a part in the outputs is there. What an operator makes of its inputs,
and whether another model gives the same by other means, is not looked at: `Identity` alone is no step.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Iterator, Mapping, MutableMapping
from dataclasses import dataclass, field
from itertools import count, dropwhile
from typing import Any, Final

import numpy as np

from nmes.brain.models import message_fields, read_varint

__all__ = ["computation"]

# Numbers of fields: https://github.com/onnx/onnx/blob/main/onnx/onnx.proto
_GRAPH, _FUNCTIONS = 7, 25  # of a model
_NODES, _TENSORS, _INPUTS, _OUTPUTS, _SPARSE = 1, 5, 11, 12, 15  # of a graph
_IN, _OUT, _OPERATOR, _ATTRIBUTES, _DOMAIN = 1, 2, 4, 5, 7  # of a node
_NAME: Final = 1  # of an attribute, and of an input or output
_TENSOR_NAME, _TENSOR_SAID = 8, 12
_SAID: Final = {13, 20}  # of an attribute: words, and its type, which its fields tell too
_TENSOR_FIELDS, _GRAPH_FIELDS = (5, 10), (6, 11)  # of an attribute
_NUMBERS: Final = {1: ("<f4", 4), 6: ("<i4", 5), 7: ("<i8", 7), 11: ("<f8", 10)}  # a type's, and where they stand
_DIMS, _TYPE, _RAW = 1, 2, 9  # of a tensor
_OWN_DOMAIN: Final = {"", "ai.onnx"}

_Value = bytes | int
_Message = Mapping[int, list[_Value]]


def computation(model: bytes, inputs: int) -> list[Any]:
    """Returns plain data of what a model computes.

    Args:
        model: One that a brain has taken.
        inputs: How many numbers go into it.
    """
    message = _message(model)
    graph = _Graph.read(b"".join(_texts(message, _GRAPH)))  # a message may come in parts
    types = [_type(said, inputs) for _, said in graph.inputs]
    return [types, *_Numbering().graph(graph, {}), [each.hex() for each in _texts(message, _FUNCTIONS)]]


def _message(data: bytes) -> dict[int, list[_Value]]:
    """Reads a message: the values of each field, in order; bytes, or whole numbers."""
    values: dict[int, list[_Value]] = {}
    for number, value, begin, end in message_fields(data, 0, len(data)):
        values.setdefault(number, []).append(data[begin:end] if end > begin else value)
    return values


def _texts(message: _Message, number: int) -> list[bytes]:
    """Returns the texts of a field; an empty one is read as the number 0."""
    return [value if isinstance(value, bytes) else b"" for value in message.get(number, ())]


def _text(message: _Message, number: int) -> bytes:
    return (_texts(message, number) or [b""])[-1]


@dataclass(slots=True)
class _Node:
    """A node of a graph: what it does, what of, and which values it makes."""

    operator: tuple[str, str]  # its domain and name
    inputs: list[bytes]
    outputs: list[bytes]
    attributes: list[tuple[str, dict[int, list[_Value]]]]
    graphs: list[_Graph]
    outer: list[bytes] = field(default_factory=list)  # the values that its graphs take from around it

    @classmethod
    def read(cls, data: bytes) -> _Node:
        """Reads a node."""
        message = _message(data)
        domain, name = (_text(message, number).decode(errors="replace") for number in (_DOMAIN, _OPERATOR))
        attributes, graphs = [], []
        for each in _texts(message, _ATTRIBUTES):
            attribute = _message(each)
            said = _text(attribute, _NAME).decode(errors="replace")
            attributes.append((said, {number: attribute[number] for number in sorted({*attribute} - _SAID - {_NAME})}))
        attributes.sort(key=lambda each: each[0])
        for _, attribute in attributes:
            graphs += [_Graph.read(each) for number in _GRAPH_FIELDS for each in _texts(attribute, number)]
        outer = [name for graph in graphs for name in graph.outer()]
        operator = "" if domain in _OWN_DOMAIN else domain, name
        return cls(operator, _texts(message, _IN), _texts(message, _OUT), attributes, graphs, outer)


@dataclass(slots=True)
class _Graph:
    """A graph: its nodes, tensors by name, and the names of its inputs and outputs."""

    nodes: list[_Node]
    tensors: dict[bytes, bytes]
    sparse: dict[bytes, bytes]
    inputs: list[tuple[bytes, bytes]]  # the name and all that is said
    outputs: list[bytes]

    @classmethod
    def read(cls, data: bytes) -> _Graph:
        """Reads a graph."""
        message = _message(data)
        tensors = {_text(_message(each), _TENSOR_NAME): each for each in _texts(message, _TENSORS)}
        sparse = {_text(_message(_text(_message(each), 1)), _TENSOR_NAME): each for each in _texts(message, _SPARSE)}
        inputs = [(_text(_message(each), _NAME), each) for each in _texts(message, _INPUTS)]
        outputs = [_text(_message(each), _NAME) for each in _texts(message, _OUTPUTS)]
        nodes = [_Node.read(each) for each in _texts(message, _NODES)]
        return cls(nodes, tensors, sparse, [each for each in inputs if each[0] not in tensors], outputs)

    def outer(self) -> Iterator[bytes]:
        """Yields the names that are none of its own."""
        own = {*self.tensors, *self.sparse, *(name for name, _ in self.inputs)}
        own |= {name for node in self.nodes for name in node.outputs}
        for names in (self.outputs, *([*node.inputs, *node.outer] for node in self.nodes)):
            yield from (name for name in names if name not in own)


class _Numbering:
    """Gives values numbers in the order in which the outputs come to need them."""

    def __init__(self) -> None:
        self._fresh = count()

    def graph(self, graph: _Graph, known: MutableMapping[bytes, int]) -> list[Any]:
        """Returns a graph as plain data; `known` are the numbers of the values around it."""
        numbers = ChainMap({b"": -1, **{name: next(self._fresh) for name, _ in graph.inputs}}, known)
        makers = {name: node for node in graph.nodes for name in node.outputs}
        lines: list[Any] = []
        waiting = graph.outputs[::-1]
        while waiting:  # no recursion: models are deep
            name = waiting[-1]
            node = makers.get(name)
            needs = [] if node is None else [each for each in (*node.inputs, *node.outer) if each not in numbers]
            if name not in numbers and needs:
                waiting += needs[::-1]
                continue
            waiting.pop()
            if name in numbers:
                continue
            if node is None:
                numbers[name] = next(self._fresh)
                lines.append(_tensor(graph.tensors[name]) if name in graph.tensors else graph.sparse[name].hex())
            elif node.operator == ("", "Identity"):
                numbers[name] = numbers[node.inputs[0]]
            else:
                lines.append(self._line(node, numbers))
                numbers.update({each: next(self._fresh) for each in node.outputs if each})
        return [lines, [numbers[name] for name in graph.outputs]]

    def _line(self, node: _Node, numbers: MutableMapping[bytes, int]) -> list[Any]:
        attributes: list[Any] = []
        for name, attribute in node.attributes:
            for number, values in attribute.items():
                if number in _TENSOR_FIELDS:
                    told: list[Any] = [_tensor(each) for each in values if isinstance(each, bytes)]
                elif number in _GRAPH_FIELDS:
                    told = []
                else:
                    told = [each.hex() if isinstance(each, bytes) else each for each in values]
                attributes.append([name, number, told])
        graphs = [self.graph(each, numbers) for each in node.graphs]
        outputs = [bool(name) for name in node.outputs]
        return [*node.operator, [numbers[name] for name in node.inputs], outputs, attributes, graphs]


def _tensor(data: bytes) -> list[Any]:
    """Returns type, dimensions and numbers of a tensor, however they are stored."""
    message = _message(data)
    (kind,) = message.get(_TYPE, [0])[-1:]
    dims = [number for each in message.get(_DIMS, ()) for number in _integers(each)]
    if kind not in _NUMBERS:
        rest = sorted({*message} - {_DIMS, _TYPE, _TENSOR_NAME, _TENSOR_SAID})
        return [kind, dims, [[number, [_plain(each) for each in message[number]]] for number in rest]]
    dtype, place = _NUMBERS[int(kind)]
    parts = [each for each in message.get(_RAW, ()) if isinstance(each, bytes)]
    if not parts and dtype[1] == "f":
        parts = [each for each in message.get(place, ()) if isinstance(each, bytes)]
    if parts or dtype[1] == "f":
        numbers = np.frombuffer(b"".join(parts), dtype).tolist()
    else:
        numbers = [number for each in message.get(place, ()) for number in _integers(each)]
    return [kind, dims, numbers]


def _integers(value: _Value) -> list[int]:
    """Returns the integers of a field, packed or not; the great ones are negative."""
    if isinstance(value, int):
        found = [value]
    else:
        found, at = [], 0
        while at < len(value):
            number, at = read_varint(value, at, len(value))
            found.append(number)
    return [number - (1 << 64) if number >> 63 else number for number in found]


def _plain(value: _Value) -> Any:
    return value.hex() if isinstance(value, bytes) else value


def _type(said: bytes, inputs: int) -> list[Any]:
    """Returns the type of numbers of the model's input, and its sizes but for those of 1 in front."""
    tensor = _message(_text(_message(_text(_message(said), 2)), 1))
    sizes = [_message(each).get(1, [0])[-1] for each in _texts(_message(_text(tensor, 2)), 1)]
    full = [size or (inputs if place == len(sizes) else 1) for place, size in enumerate(sizes, 1)]
    return [tensor.get(1, [0])[-1], list(dropwhile(lambda size: size == 1, full))]
