"""Channels: numbers that are said where a cube is, and heard by whoever is in range from the next tick on.

A voice is what one cube says on one channel. It lasts until that cube says something else there, or is gone. Hides when
what was said is heard, who is near enough, and how quiet a voice is from afar.

Invariants: what is heard changes in `tick` alone, but for voices of cubes that are gone; a world whose config has no
channels says nothing of them in its digest and its snapshots.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from math import inf
from typing import Any, NamedTuple

import orjson

from nmes.backend import Vector
from nmes.errors import WorldError
from nmes.schemas.documents import JsonObject
from nmes.world.entities import Entities
from nmes.world.nearby import Nearby, Neighbour

__all__ = ["Channel", "Channels", "Voice"]

Values = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Channel:
    """A channel of a world's config: how many numbers it has, how far it is heard (m), and whether it fades."""

    size: int
    range: float
    fades: bool

    @classmethod
    def from_config(cls, entry: Mapping[str, Any]) -> Channel:
        """Returns the channel that an entry of a config describes."""
        return cls(entry.get("size", 1), float(entry.get("range", inf)), entry.get("fades", False))

    def from_afar(self, values: Values, distance: float) -> Values:
        """Returns the values that are heard of a voice at a distance (m) within the range."""
        if not self.fades:
            return values
        part = 1.0 - distance / self.range
        return tuple(part * value for value in values)


class Voice(NamedTuple):
    """What is heard of one voice: whose it is (the number of a cube), what it says there, and how far it is (m)."""

    body: int
    values: Values
    distance: float


class Channels:
    """The channels of one world, and what is said and heard on them.

    Args:
        config: The world's complete config.
        entities: Its cubes.

    Attributes:
        channels: The channels by name, sorted; none where the config has none.

    Raises:
        WorldError: A channel fades and has no range.
    """

    def __init__(self, config: Mapping[str, Any], entities: Entities) -> None:
        entries = config.get("channels", {})
        for name, entry in entries.items():
            if entry.get("fades") and "range" not in entry:
                raise WorldError("invalid", "what fades needs a range, at which it is 0", f"channels/{name}/fades")
        self.channels = {name: Channel.from_config(entries[name]) for name in sorted(entries)}
        self._entities, self._version = entities, entities.version
        self._said: dict[str, dict[int, Values]] = {name: {} for name in self.channels}
        self._heard: dict[str, dict[int, Values]] = {name: {} for name in self.channels}
        self._near = {name: Nearby(entities, partial(self._speakers, name)) for name in self.channels}
        self._packed: bytes | None = None  # what the digest says of it; None: to be packed

    def require(self, name: str, path: str) -> Channel:
        """Returns a channel.

        Raises:
            WorldError: `invalid`: the config has none of that name; `path` is the field to blame.
        """
        channel = self.channels.get(name)
        if channel is None:
            known = f"it has {', '.join(self.channels)}" if self.channels else "its config has no channels"
            raise WorldError("invalid", f"the world has no channel {name!r}: {known}", path)
        return channel

    def say(self, body: int, name: str, values: Values | None) -> None:
        """Has a cube say something on a channel, heard from the next tick on; None: it falls silent there.

        Args:
            body: The cube's number in the engine.
            name: A channel that there is.
            values: As many numbers as the channel has, each from -1 to 1.
        """
        voices = self._said[name]
        if voices.get(body) == values:
            return
        if values is None:
            del voices[body]
        else:
            voices[body] = values
        self._packed = None

    def tick(self) -> None:
        """Lets what was said be heard; after every tick."""
        if self._entities.version != self._version:
            self._forget_gone()
        for name, voices in self._said.items():
            if voices != self._heard[name]:
                self._heard[name] = dict(voices)
                self._near[name].forget()
                self._packed = None

    def hear(self, name: str, place: Vector, but: Collection[int], most: int) -> list[Voice]:
        """Returns the voices on a channel that are heard at a place, the nearest first, of those equally far the older.

        Args:
            name: A channel that there is.
            place: Where, m.
            but: Cubes whose voices are not heard: the hearer's own.
            most: How many at most.
        """
        channel = self.channels[name]
        return [self._voice(name, near) for near in self._near[name].all(place, channel.range, but, most)]

    def nearest(self, name: str, place: Vector, but: Iterable[int]) -> Values | None:
        """Returns the words of the nearest voice that is heard at a place, as `hear`; None where nothing is heard."""
        if not self._heard.get(name):
            return None
        near = self._near[name].nearest(place, self.channels[name].range, but)
        return None if near is None else self._voice(name, near).values

    def _voice(self, name: str, near: Neighbour) -> Voice:
        values = self.channels[name].from_afar(self._heard[name][near.body], near.distance)
        return Voice(near.body, values, near.distance)

    def _speakers(self, name: str) -> list[int]:
        there = self._entities.body_names
        return [body for body in sorted(self._heard[name]) if body in there]

    def _forget_gone(self) -> None:
        there, self._version = self._entities.body_names, self._entities.version
        for voices in (*self._said.values(), *self._heard.values()):
            for body in voices.keys() - there.keys():
                del voices[body]
                self._packed = None

    # -- digests and snapshots -----------------------------------------------------------------------------------

    def packed(self) -> bytes:
        """Returns all that is said and heard, as bytes for a digest; none where there are no channels."""
        if not self.channels:
            return b""
        if self._entities.version != self._version:
            self._forget_gone()
        if self._packed is None:
            self._packed = orjson.dumps(self.snapshot())
        return self._packed

    def snapshot(self) -> JsonObject:
        """Returns all words that are said and heard as an entry of a snapshot; nothing where there are no channels."""
        if not self.channels:
            return {}
        self._forget_gone()
        return {"channels": {"said": _listed(self._said), "heard": _listed(self._heard)}}

    def restore(self, state: JsonObject) -> None:
        """Takes up what `snapshot` returned, among what else a snapshot holds.

        Raises:
            WorldError: `bad_snapshot`: it is of other channels, or of cubes that are not there.
        """
        if ("channels" in state) != bool(self.channels):
            raise WorldError("bad_snapshot", "it has voices where the config has no channels, or lacks them")
        for kind, voices in (("said", self._said), ("heard", self._heard)):
            for entry in state["channels"][kind] if self.channels else ():
                name, body, values = entry["channel"], entry["body"], entry["value"]
                if len(values) != self.require(name, "channels").size or body not in self._entities.body_names:
                    raise WorldError("bad_snapshot", "a voice is of another channel than there is, or of no cube")
                voices[name][body] = tuple(map(float, values))
        self._packed = None


def _listed(voices: Mapping[str, Mapping[int, Values]]) -> list[JsonObject]:
    """Returns voices as a list, in the order of channels and cubes."""
    return [
        {"channel": name, "body": body, "value": list(own[body])}
        for name, own in voices.items()
        for body in sorted(own)
    ]
