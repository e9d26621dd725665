"""From a body's sensors and motors to the entries of a network, and back.

A network sees entries, a body has names; here is where the two meet: what a wildcard stands for shares its column of
the document's matrix, a sensor that no entry names has a column of zeros, and a motor that no entry names rests at 0.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nmes.brain.base import LIMIT, Array, Brain, Findings, JsonObject

__all__ = ["Entries", "Inputs", "Outputs"]


class Inputs:
    """Where the inputs stand in a buffer, kept within the limit, with a 1 behind them."""

    def __init__(self, row: Array, count: int) -> None:
        """Takes a buffer (*lead, columns)."""
        self._x = row[..., :count]
        self._low, self._high = np.full(count, -LIMIT), np.full(count, LIMIT)
        row[..., count] = 1.0

    def read(self, inputs: Array) -> None:
        """Takes what sensors read (*lead, sensors)."""
        np.maximum(inputs, self._low, out=self._x)
        np.minimum(self._x, self._high, out=self._x)


class Outputs:
    """Which of a network's values drives which motor."""

    def __init__(self, owner: Sequence[int], unbounded: bool) -> None:
        """Takes for each motor the index of its value, or -1; `unbounded` if values may be out of -1 to 1."""
        self._owner = np.array(owner, np.intp)
        self._idle = self._owner < 0
        self._in_order = owner == list(range(len(owner)))
        self._unbounded = unbounded

    def pick(self, values: Array) -> Array:
        """Takes values (*lead, at least one for each index)."""
        out = values[..., : len(self._owner)] if self._in_order else values[..., self._owner]
        if not self._in_order:
            out[..., self._idle] = 0.0
        return np.minimum(np.maximum(out, -1.0), 1.0) if self._unbounded else out


class Entries:
    """The entries of `inputs` and `outputs`, dealt out to a body's sensors and motors."""

    def __init__(self, brain: Brain, document: JsonObject, findings: Findings) -> None:
        self.listed = {side: side in document for side in ("inputs", "outputs")}
        self.counts: dict[str, int] = {}
        self.owners: dict[str, list[int]] = {}
        for side, names, what in (("inputs", brain.inputs, "sensor"), ("outputs", brain.outputs, "motor")):
            entries = document.get(side, list(names))
            pointers = [f"{side}/{number}" for number in range(len(entries))]
            self.counts[side] = len(entries)
            self.owners[side] = findings.owners(entries, names, what, pointers)

    def expect(self, findings: Findings, pointer: str, got: int, side: str, each: str) -> None:
        """Compares a length with the number of entries of one side."""
        wanted = self.counts[side]
        what = "sensors" if side == "inputs" else "motors"
        if got == wanted or (findings.unsure and not self.listed[side]):
            return
        if self.listed[side]:
            findings.add(pointer, f"has {got} {each}, and there must be {wanted}, one for each entry of {side}")
        else:
            message = f"has {got} {each}, and the body has {wanted} {what}: a list {side!r} would say which are meant"
            findings.add(pointer, message)

    def spread(self, matrix: Array) -> Array:
        """Returns a matrix with a column for each entry as one with a column for each sensor."""
        return np.hstack([matrix, np.zeros((len(matrix), 1))])[:, self.owners["inputs"]]
