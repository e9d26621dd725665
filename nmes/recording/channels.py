"""The channels of a recording: their topics, schemas and numbers, registered when they are first needed."""

from __future__ import annotations

from functools import cache

from nmes import protocol
from nmes.recording import viewer_messages as scene
from nmes.recording.mcap_writer import Writer
from nmes.recording.records import BOXES, KEYFRAMES
from nmes.schemas import load

__all__ = [
    "CHAIN",
    "CHECKSUMS",
    "CLIENTS",
    "COMMAND",
    "FAULTS",
    "HIBERNATION",
    "KEYFRAME",
    "LIFE",
    "POSES",
    "REFUSED",
    "REPLY",
    "SCENE",
    "TICKS",
    "Channels",
]

# The keys of channels: the name of a cube for that of its box, and these. All clients share the first three, however
# many come: a file has no more than 65,535 channels.
COMMAND, REPLY, REFUSED = 0, 1, 2
TICKS, CLIENTS, FAULTS, POSES, SCENE, CHAIN, CHECKSUMS, KEYFRAME, LIFE, HIBERNATION = range(-1, -11, -1)
_VIEWS = {POSES: scene.POSES_SCHEMA, SCENE: scene.SCENE_SCHEMA}
_OWN = {TICKS: "ticks", CLIENTS: "clients", FAULTS: "faults", CHAIN: "chain", LIFE: "life", HIBERNATION: "hibernation"}
_TOPICS = {**_OWN, POSES: "/tf", SCENE: "/scene"}
_OCTETS = {CHECKSUMS: "checksums", KEYFRAME: KEYFRAMES, REFUSED: "refused"}
_SAID = {COMMAND: ("commands", "command"), REPLY: ("replies", "reply")}


class Channels(dict[int | str, int]):
    """The numbers of a file's channels by key; one is registered when it is first asked for."""

    def __init__(self, writer: Writer) -> None:
        """Begins without channels; they are registered with the writer."""
        self._writer = writer
        self._schemas: dict[str, int] = {}

    def __missing__(self, key: int | str) -> int:
        if isinstance(key, str):
            channel = self._view(BOXES + key, scene.BOX_SCHEMA)
        elif key in _SAID:
            topic, schema = _SAID[key]
            channel = self._writer.channel(topic, "json", self._schema(schema))
        elif key in _OCTETS:
            channel = self._writer.channel(_OCTETS[key], "application/octet-stream")
        elif key in _VIEWS:
            channel = self._view(_TOPICS[key], _VIEWS[key])
        else:
            channel = self._writer.channel(_TOPICS[key], "json", self._schema(_TOPICS[key]))
        self[key] = channel
        return channel

    def _view(self, topic: str, name: str) -> int:
        """Registers a channel for viewers."""
        if name not in self._schemas:
            self._schemas[name] = self._writer.schema(name, "protobuf", scene.descriptors(name))
        return self._writer.channel(topic, "protobuf", self._schemas[name])

    def _schema(self, name: str) -> int:
        if name not in self._schemas:
            self._schemas[name] = self._writer.schema(f"nmes.{name}", "jsonschema", _schema(name))
        return self._schemas[name]


@cache  # a short episode takes no longer than making these
def _schema(name: str) -> bytes:
    match name:
        case "command" | "reply":
            # The message has an address of its own, so that what is "any command" in it does not mean the whole.
            message = {**protocol.bundled_schema(name), "$id": f"nmes:{name}"}
            schema = {
                "$schema": message.pop("$schema"),
                "title": f"nmes.{name} of a client",
                "type": "object",
                "required": ["client", "message"],
                "properties": {"client": {"type": "integer", "minimum": 1}, "message": message},
            }
        case _:
            schema = load(f"recording/{name}.json")
    return protocol.encode(schema)
