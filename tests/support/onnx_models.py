"""Writes small ONNX models in the Protobuf of https://github.com/onnx/onnx, so that no package for that is needed."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np

FLOAT, DOUBLE, INT64 = 1, 11, 7
DTYPES = {FLOAT: np.float32, DOUBLE: np.float64, INT64: np.int64}


def varint(value: int) -> bytes:
    out = b""
    while value > 127:
        out += bytes([value & 127 | 128])
        value >>= 7
    return out + bytes([value])


def field(number: int, value: int | bytes | str) -> bytes:
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    data = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(data)) + data


def tensor(name: str, values: Any, kind: int = FLOAT, *, way: str = "raw") -> bytes:
    array = np.asarray(values, DTYPES[kind])
    head = b"".join(field(1, size) for size in array.shape) + field(2, kind) + field(8, name)
    match way:
        case "raw":
            return head + field(9, array.tobytes())
        case "packed":
            return head + field(4, array.tobytes())
        case "loose":
            return head + b"".join(varint(4 << 3 | 5) + struct.pack("<f", x) for x in array.ravel())
        case "external":
            return head + field(13, field(1, "location") + field(2, "/etc/passwd")) + field(14, 1)
    raise ValueError(way)


def value_info(name: str, kind: int, shape: list[int | str]) -> bytes:
    sizes = b"".join(field(1, field(1 if isinstance(size, int) else 2, size)) for size in shape)
    return field(1, name) + field(2, field(1, field(1, kind) + field(2, sizes)))


def node(op_type: str, inputs: list[str], outputs: list[str], attributes: bytes = b"") -> bytes:
    return (
        b"".join(field(1, x) for x in inputs) + b"".join(field(2, x) for x in outputs) + field(4, op_type) + attributes
    )


def model(nodes: list[bytes], tensors: list[bytes], inputs: list[bytes], outputs: list[bytes]) -> bytes:
    graph = b"".join(field(1, x) for x in nodes) + field(2, "graph") + b"".join(field(5, x) for x in tensors)
    graph += b"".join(field(11, x) for x in inputs) + b"".join(field(12, x) for x in outputs)
    return field(1, 8) + field(7, graph) + field(8, field(1, "") + field(2, 17))


def layer(
    weights: Any, biases: Any, *, shape: list[int | str] | None = None, way: str = "raw", kind: int = FLOAT
) -> bytes:
    """Returns a model of tanh(x . weights + biases), with weights (inputs, outputs)."""
    weights = np.asarray(weights)
    count, outputs = weights.shape
    return model(
        [node("MatMul", ["x", "w"], ["m"]), node("Add", ["m", "b"], ["s"]), node("Tanh", ["s"], ["y"])],
        [tensor("w", weights, kind, way=way), tensor("b", biases, kind, way=way)],
        [value_info("x", kind, shape or [1, count])],
        [value_info("y", kind, [1, outputs])],
    )
