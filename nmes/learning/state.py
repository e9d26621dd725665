"""All that a run of learning knows after a leg, as bytes: arrays by name, and what tells two states apart.

The bytes are a line of JSON, of each array its name, type and shape, and behind it the arrays' bytes in this order.
Whoever reads them takes nothing that was not there: what is too short or too long is refused.
"""

from __future__ import annotations

from collections.abc import Mapping
from hashlib import blake2b
from math import prod
from typing import Any, Final

import numpy as np
import orjson
from numpy.typing import NDArray

__all__ = ["State", "read_state", "state_digest", "write_state"]

State = dict[str, NDArray[Any]]
"""Arrays of doubles or bytes by name."""

_TYPES: Final = ("<f8", "|u1")


def write_state(state: Mapping[str, NDArray[Any]]) -> bytes:
    """Returns a state as bytes, the same for equal states."""
    arrays = {name: np.ascontiguousarray(state[name]) for name in sorted(state)}
    arrays = {name: array.astype(array.dtype.newbyteorder("<")) for name, array in arrays.items()}
    head = [[name, array.dtype.str, array.shape] for name, array in arrays.items()]
    return b"".join([orjson.dumps(head), b"\n", *(array.tobytes() for array in arrays.values())])


def read_state(text: bytes) -> State:
    """Returns the state of some bytes.

    Raises:
        ValueError: They are of none.
    """
    line, _, rest = text.partition(b"\n")
    state: State = {}
    begin = 0
    head = orjson.loads(line)
    if not isinstance(head, list):
        raise ValueError("its first line is no list of arrays")
    for entry in head:
        match entry:
            case [str(name), str(kind), [*shape]] if kind in _TYPES and all(type(n) is int and n >= 0 for n in shape):
                end = begin + prod(shape) * np.dtype(kind).itemsize
            case _:
                raise ValueError("it names an array of no such kind")
        if end > len(rest):
            raise ValueError("it is cut off")
        state[name] = np.frombuffer(rest[begin:end], kind).reshape(shape)
        begin = end
    if begin != len(rest):
        raise ValueError("something stands behind its end")
    return state


def state_digest(state: Mapping[str, NDArray[Any]]) -> str:
    """Returns the digest of a state, 32 hexadecimal digits."""
    return blake2b(write_state(state), digest_size=16).hexdigest()
