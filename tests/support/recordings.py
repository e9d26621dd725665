"""Worlds to record, and recordings that are rewritten message by message."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import orjson
from mcap.records import Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

from nmes.playback import Divergence, replay
from nmes.protocol import Request, parse
from nmes.recording import Kind, Recorder, Recording
from nmes.recording.mcap_writer import Writer
from nmes.world import World
from nmes.world.journal import Journal


class Line(NamedTuple):
    """One message of a recording, by topic."""

    topic: str
    log_time: int
    data: bytes


Edit = Callable[[list[Line]], list[Line]]


class Script(Journal):
    """A journal that keeps a tuple for each call, in order."""

    def __init__(self) -> None:
        self.entries: list[tuple[Any, ...]] = []

    def joined(self, client: int, role: str | None, player: int | None) -> None:
        self.entries.append(("joined", client))

    def left(self, client: int) -> None:
        self.entries.append(("left", client))

    def received(self, client: int, request: Request) -> None:
        self.entries.append(("command" if request.error is None else "refused", client, request.raw))

    def replied(self, client: int, request: Request, reply: bytes) -> None:
        self.entries.append(("reply", client, reply))

    def ticked(self, frame: int, digest: bytes) -> None:
        self.entries.append(("tick", frame, digest.hex()))

    def keyframe(self, snapshot: bytes) -> None:
        self.entries.append(("keyframe", snapshot))

    def hibernated(self, frame: int) -> None:
        self.entries.append(("hibernated", frame))

    def faulted(self, frame: int, code: str, message: str) -> None:
        self.entries.append(("fault", frame, code, message))


def record(
    path: Path,
    play: Callable[[World, int], Any],
    config: Mapping[str, Any] | None = None,
    *,
    pose_rate: float = 10.0,
) -> Path:
    """Records what `play` does to a lockstep world as its first client."""
    world = World({"backend": "ballistic", "mode": "lockstep", **(config or {})})
    recorder = world.journal = Recorder(path, world, pose_rate=pose_rate)
    play(world, world.join())
    recorder.close()
    world.close()
    return path


def send(world: World, client: int, **command: Any) -> dict[str, Any]:
    """Sends a command and returns the reply."""
    return world.execute(client, command)


def busy(world: World, client: int) -> None:
    """Two cubes, pushes, ticks in and out of commands, refused frames, a second client."""
    send(world, client, type="spawn_cube", cube_name="one", position=[0, 5, 0])
    send(world, client, type="spawn_cube", cube_name="two", position=[3, 7, 0], linear_velocity=[0.1, 0, 0])
    other = world.join()
    for i in range(8):
        send(world, client, type="apply_physics", cube_name="one", force=[1.5, 0.25 * i, 0])
        send(world, other, type="apply_physics", cube_name="two", force=[0, 0, 0.125 + i])
        send(world, client, type="step", ticks=1 + i % 3)
        send(world, client, type="get_cube_info", cube_name="one")
        world.handle(other, parse(b'{"type":"no such thing","id":7}'))
    world.handle(other, parse(b"\xff\xfe not even text"))
    send(world, client, type="pause")
    send(world, client, type="ping")
    for _ in range(15):
        world.tick()  # by the clock
    world.leave(other)
    send(world, client, type="step", ticks=10)
    send(world, client, type="get_world_state")


def rewrite(
    source: Path,
    target: Path,
    edit: Edit,
    *,
    chained: bool = True,
    missing: int = 0,
    skip: int = 0,
    about: Mapping[str, Mapping[str, str]] | None = None,
    closed: str = "now",
) -> Path:
    """Writes a recording again with its messages edited, all checksums in order.

    Args:
        source: A whole recording.
        target: The new file.
        edit: What becomes of the messages, those of the chain left out.
        chained: Whether the hash chain is made anew too; otherwise its old heads are kept.
        missing: How many records more than there are the closing metadata speak of.
        skip: By how much the second half of the sequence numbers is too high.
        about: Metadata records by name, in place of those that there are or beside them.
        closed: When it was closed, as its end says.
    """
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    metadata: list[Metadata] = []
    lines: list[Line] = []
    heads: list[bytes] = []
    with source.open("rb") as file:
        for item in StreamReader(file).records:
            if isinstance(item, Schema):
                schemas[item.id] = item
            elif isinstance(item, Channel):
                channels[item.id] = item
            elif isinstance(item, Metadata):
                metadata.append(item)
            elif isinstance(item, Message) and channels[item.channel_id].topic == "chain":
                heads.append(item.data)
            elif isinstance(item, Message):
                lines.append(Line(channels[item.channel_id].topic, item.log_time, item.data))
    assert chained or len(heads) == 1, "more than one chunk"
    writer = Writer(target, profile="nmes", library="test")
    chain = hashlib.sha256()
    for name, values in {**{item.name: item.metadata for item in metadata[:-1]}, **(about or {})}.items():
        chain.update(writer.metadata(name, values))
    for schema in schemas.values():
        writer.schema(schema.name, schema.encoding, schema.data)
    numbers = {
        channel.topic: writer.channel(channel.topic, channel.message_encoding, channel.schema_id)
        for channel in channels.values()
    }
    edited = edit(lines)
    for i, line in enumerate(edited):
        sequence = i + skip * (i >= len(edited) // 2)
        writer.add(numbers[line.topic], sequence, line.log_time, 0, line.data)
    head = hashlib.sha256(chain.digest() + writer.open_chunk).hexdigest()
    last = orjson.dumps({"head": head}) if chained else heads[0]
    writer.add(numbers["chain"], len(edited), edited[-1].log_time, 0, last)
    records = str(len(edited) + 1 + missing)
    writer.seal("nmes.end", {"head": orjson.loads(last)["head"], "records": records, "closed": closed})
    writer.close()
    return target


def commands_of(lines: list[Line], kind: str = "commands") -> list[int]:
    """Returns the indices of the messages of clients."""
    return [i for i, line in enumerate(lines) if line.topic == kind]


def told_by(recording: Recording) -> list[tuple[Any, ...]]:
    """Returns what a recording tells of a history, an entry for each tick, fault, client and message."""
    entries: list[tuple[Any, ...]] = []
    for item in recording:
        about = item.about or {}
        match item.kind:
            case Kind.TICKS:
                entries += [("tick", about["frame"] + i, digest) for i, digest in enumerate(about["digests"])]
            case Kind.FAULT:
                entries.append(("fault", about["frame"], about["code"], about["message"]))
            case Kind.JOINED | Kind.LEFT:
                entries.append((str(item.kind), item.client))
            case Kind.HIBERNATED:
                entries.append(("hibernated", about["frame"]))
            case Kind.COMMAND | Kind.REFUSED | Kind.REPLY:
                entries.append((str(item.kind), item.client, item.data))
    return entries


def divergence(source: Path, tmp_path: Path, edit: Edit) -> Divergence:
    """Replays a recording that was edited, its chain made anew, and returns where it diverges."""
    path = tmp_path / "edited.mcap"
    path.unlink(missing_ok=True)
    report = replay(rewrite(source, path, edit))
    assert report.verdict == "diverged"
    assert report.damage is None
    assert report.divergence is not None
    return report.divergence


def changed(lines: list[Line], at: int, data: bytes) -> list[Line]:
    """Returns the messages with the content of one exchanged."""
    return [*lines[:at], lines[at]._replace(data=data), *lines[at + 1 :]]


def misled(lines: list[Line], frame: int) -> list[Line]:
    """Returns the messages with another digest for a tick that stands in one of its own."""

    def each(line: Line) -> Line:
        about = orjson.loads(line.data) if line.topic == "ticks" else {}
        if about.get("frame") != frame:
            return line
        return line._replace(data=orjson.dumps({**about, "digests": ["0" * len(about["digests"][0])]}))

    return [each(line) for line in lines]


def first(lines: list[Line], topic: str, after: int = 0) -> int:
    """Returns the index of the first message of a topic, from an index on."""
    return next(i for i, line in enumerate(lines) if i >= after and line.topic == topic)
