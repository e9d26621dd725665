"""Snapshots as bytes: a line of JSON that says what a world is, then what its engine says of itself.

It hides the encoding, which is plain: no program is in it, and a stranger's snapshot can at worst be refused. The line
is as `schemas/recording/keyframes.json` says; floats survive it bit for bit. What the engine's bytes mean, the engine
knows.

Invariant: the same world gives the same bytes.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from hashlib import sha256
from typing import Any, Final

import jsonschema_rs
import numpy as np
import orjson

from nmes.backend import Array
from nmes.errors import WorldError
from nmes.schemas import load

__all__ = ["pack", "pack_array", "renamed", "unpack", "unpack_array"]

_VERSION: Final = 1
_SHAPE = jsonschema_rs.Draft202012Validator(load("recording/keyframes.json"))


def pack(config: Mapping[str, Any], state: Mapping[str, Any], engine: bytes) -> bytes:
    """Returns a snapshot: the state of a world with this config, and its engine's snapshot."""
    return orjson.dumps({"version": _VERSION, "config": _hash(config), **state}) + b"\n" + engine


def unpack(snapshot: bytes, config: Mapping[str, Any]) -> tuple[dict[str, Any], bytes]:
    """Returns the state and the engine's bytes of a snapshot.

    Raises:
        WorldError: `bad_snapshot`: it is none, or of a version that this nmes does not know, or of another config.
    """
    line, _, engine = snapshot.partition(b"\n")
    state = _state(line)
    if state["config"] != _hash(config):
        raise WorldError("bad_snapshot", "this is a snapshot of a world of another config")
    return state, engine


def renamed(snapshot: bytes, config: Mapping[str, Any], name: str) -> bytes:
    """Returns a snapshot of a world of this config as one of a world that is called otherwise.

    Raises:
        WorldError: As `unpack`.
    """
    state, engine = unpack(snapshot, config)
    return pack(
        {**config, "name": name}, {key: state[key] for key in state if key not in ("version", "config")}, engine
    )


def _state(line: bytes) -> dict[str, Any]:
    try:
        state = orjson.loads(line)
    except ValueError:
        state = None
    if not isinstance(state, dict):
        raise WorldError("bad_snapshot", "this is no snapshot of a world")
    if state.get("version") != _VERSION:
        raise WorldError(
            "bad_snapshot", f"a snapshot of version {state.get('version')}; this nmes knows version {_VERSION}"
        )
    for error in _SHAPE.iter_errors(state):
        raise WorldError("bad_snapshot", f"not a snapshot of a world: {error.message}")
    return state


def _hash(config: Mapping[str, Any]) -> str:
    return sha256(orjson.dumps(config, option=orjson.OPT_SORT_KEYS)).hexdigest()


def pack_array(values: Array) -> str:
    """Returns an array's float64 bytes (little-endian) in base64, NaN included."""
    return base64.b64encode(values.astype("<f8").tobytes()).decode()


def unpack_array(text: str, columns: int) -> Array:
    """Returns the array (n, columns) that `pack_array` was given.

    Raises:
        ValueError: It is not base64, or not of that many columns.
    """
    return np.frombuffer(base64.b64decode(text, validate=True), "<f8").astype(np.float64).reshape(-1, columns)
