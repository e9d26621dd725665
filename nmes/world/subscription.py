"""One client's subscription to events, and the cubes that have moved since it was last sent them.

Hides the bookkeeping of the `state` event: a subscriber is sent only the cubes that moved past its thresholds since
they were last sent to it, each of them at least once, and the names of those that are gone. Vectorised: a thousand
cubes cost one comparison of arrays, and are encoded as five arrays, taken apart and put together again: that takes half
the time of a thousand objects. The World decides when an event is due.

Invariant: what an event says of a cube is, byte for byte, what `moving_part` encodes to.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import pi, sin
from typing import Any, Self

import numpy as np

from nmes.backend import Array
from nmes.backend.rotation import euler_angles, euler_from_quaternion
from nmes.protocol import encode
from nmes.world.snapshot import pack_array, unpack_array

__all__ = ["Subscription", "moving_part"]


@dataclass(slots=True)
class Subscription:
    """One client's subscription. `every` is in ticks, the thresholds in m and rad."""

    events: tuple[str, ...]
    every: int
    position_threshold: float
    rotation_threshold: float
    _version: int = -1  # of the structure that the names and poses below belong to
    _names: list[str] = field(default_factory=list)
    _sent: Array = field(default_factory=lambda: np.empty((0, 7)))  # poses as last sent; NaN: never

    @classmethod
    def restored(cls, state: Mapping[str, Any]) -> Self:
        """Rebuilds a subscription from its `state`.

        Raises:
            ValueError: Its cubes and their poses do not fit together.
        """
        sent = unpack_array(state["sent"], 7)
        names = list(state["names"])
        if len(sent) != len(names):
            raise ValueError(f"a subscription has {len(names)} cubes, but {len(sent)} poses")
        return cls(
            events=tuple(state["events"]),
            every=state["every"],
            position_threshold=float(state["position_threshold"]),
            rotation_threshold=float(state["rotation_threshold"]),
            _version=state["version"],
            _names=names,
            _sent=sent,
        )

    def state(self) -> dict[str, Any]:
        """Returns the subscription as plain JSON data, for snapshots of the world."""
        return {
            "events": self.events,
            "every": self.every,
            "position_threshold": self.position_threshold,
            "rotation_threshold": self.rotation_threshold,
            "version": self._version,
            "names": self._names,
            "sent": pack_array(self._sent),
        }

    def changes(self, version: int, names: Sequence[str], states: Array) -> tuple[bytes, list[str]]:
        """Returns the cubes to send now, encoded (empty where there are none), and the names of those that are gone.

        Both count as sent.

        Args:
            version: Changes whenever `names` does.
            names: The cubes, in order of creation.
            states: Their states, shape (n, 13) as `Simulation.states` gives them.
        """
        removed = [] if self._version == version else self._align(version, names)
        poses, sent = states[:, :7], self._sent
        distance = np.sqrt(np.sum((poses[:, :3] - sent[:, :3]) ** 2, axis=1))
        # The chord between two unit quaternions: exactly 0 when nothing turned, unlike the arc cosine of their dot.
        chord = np.minimum(
            np.sqrt(np.sum((poses[:, 3:] - sent[:, 3:]) ** 2, axis=1)),
            np.sqrt(np.sum((poses[:, 3:] + sent[:, 3:]) ** 2, axis=1)),
        )
        most = 2.0 * sin(min(self.rotation_threshold / 4.0, pi / 2.0))  # chord of the threshold
        # Written as "not within", so that NaN (never sent) counts as moved.
        moved = np.flatnonzero(~((distance <= self.position_threshold) & (chord <= most)))
        sent[moved] = poses[moved]
        return _encode([names[i] for i in moved.tolist()], states[moved]) if len(moved) else b"", removed

    def _align(self, version: int, names: Sequence[str]) -> list[str]:
        """Brings what was sent in line with the cubes that there are now; returns the names of those that are gone."""
        rows = {name: i for i, name in enumerate(self._names)}
        sent = np.full((len(names), 7), np.nan)
        for i, name in enumerate(names):
            row = rows.pop(name, None)
            if row is not None:
                sent[i] = self._sent[row]
        removed = [name for name, row in rows.items() if not np.isnan(self._sent[row, 0])]
        self._names, self._sent, self._version = list(names), sent, version
        return removed


def moving_part(name: str, state: Sequence[float]) -> dict[str, Any]:
    """Returns a cube's pose and velocities as `cube_state` has them, from the 13 numbers of its state."""
    x, y, z, w = state[3:7]
    return {
        "cube_name": name,
        "position": state[0:3],
        "rotation": euler_from_quaternion((x, y, z, w)),
        "quaternion": state[3:7],
        "linear_velocity": state[7:10],
        "angular_velocity": state[10:13],
    }


_KEYS = (
    b'","position":[',
    b'],"rotation":[',
    b'],"quaternion":[',
    b'],"linear_velocity":[',
    b'],"angular_velocity":[',
)


def _encode(names: Sequence[str], states: Array) -> bytes:
    """Returns the encoded list of the moving parts of one or more cubes."""
    columns = (states[:, 0:3], euler_angles(states[:, 3:7]), states[:, 3:7], states[:, 7:10], states[:, 10:13])
    texts = [encode(np.ascontiguousarray(column))[2:-2].split(b"],[") for column in columns]
    width = 2 + 2 * len(_KEYS)
    parts: list[bytes] = [b""] * (width * len(names))
    parts[0::width] = encode(" ".join(names))[1:-1].split(b" ")  # no name has a space in it
    for place, (key, text) in enumerate(zip(_KEYS, texts, strict=True)):
        parts[1 + 2 * place :: width] = [key] * len(names)
        parts[2 + 2 * place :: width] = text
    parts[width - 1 :: width] = [b']},{"cube_name":"'] * len(names)
    return b'[{"cube_name":"' + b"".join(parts[:-1]) + b"]}]"
