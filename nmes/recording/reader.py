"""The reader of recordings: one world's history, in order, as far as the file is sound.

A recording is an MCAP file (docs/recording-format.md) that holds a world's inputs in order: who came and went, every
frame that clients sent, every tick with its digest, and the replies. A `Recording` reads such a file, and needs no
world and no engine for that: `nmes.playback` runs it again.

Invariants:

- File order is the order of the history, and a message's sequence number is its place in it.
- A SHA-256 chain runs over the metadata and every chunk, each chunk ending with its head, so that no byte of the
  history can be changed, dropped or moved without breaking it. Checksums of the single records stand before the head:
  the chain shows whether a chunk is as it was written, they show which record is not.
- A reader returns what comes before the first damage, and says where and what that is. It never guesses beyond it.
- One that begins at a keyframe has not read what stands before it, and says nothing of that.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Iterable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import orjson

from nmes import protocol
from nmes.errors import MissingPackage, NmesError, RecordingError
from nmes.recording.chain import Chain
from nmes.recording.mcap_format import DamagedFile
from nmes.recording.mcap_reader import Block, Reader
from nmes.recording.records import END, FORMAT, FORMATS, PROFILE, Record, next_head
from nmes.recording.seeking import Start, beginning, last_keyframe
from nmes.recording.summary import Summary, summarize
from nmes.schemas.notebook import card

__all__ = ["Recording"]

_Part = TypeVar("_Part")
_NEVER = 2**63  # a frame that no world comes to


class Recording:
    """A recorded history.

    Iterating yields its records in file order, as often as one likes, up to the damage if there is any.

    Attributes:
        path: The file.
        metadata: Its metadata records by name (schemas/recording_metadata.json).
        config: The world's complete config, seed included.
        fingerprint: The versions, binaries and processor that the run's numbers depended on.
        size: The size of the file in bytes.
        end: Its closing metadata (`nmes.end`); empty until all of it was read and is sound.
        stopped: Why the last reading ended before the file does, if it did.

    Raises:
        RecordingError: The file cannot be read as a recording at all: it is not one, or it is damaged before the
            first record, or it is of a format that this version does not know.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self._reader = Reader(path)
        self.size = self._reader.size
        if self._reader.profile != PROFILE:
            raise RecordingError(
                "not_a_recording", f"{path} is an MCAP file of profile {self._reader.profile!r}, not {PROFILE!r}"
            )
        self.stopped: DamagedFile | None = None
        self._damage: DamagedFile | None = None
        self._checked = False
        self.end: dict[str, str] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self._read_metadata()

    def _read_metadata(self) -> None:
        """Reads the metadata at the beginning, and with them config, fingerprint and the first head of the chain."""
        metadata, reason = [], ""
        try:
            for block in self._reader.blocks():
                if block.metadata is None or block.metadata.name == END:
                    break
                self.metadata[block.metadata.name] = block.metadata.metadata
                metadata.append(block.content)
        except DamagedFile as error:
            reason = f": {error.message}"
        self._head = next_head(b"", b"".join(metadata))
        written = self.metadata.get("nmes.recording", {}).get("format", FORMAT)
        if written not in FORMATS:
            known = " and ".join(sorted(FORMATS))
            raise RecordingError(
                "unknown_format", f"{self.path} is a recording of format {written}; this nmes reads formats {known}"
            )
        try:
            protocol.validate_metadata(self.metadata)
            self.config: dict[str, Any] = protocol.complete_config(orjson.loads(self.metadata["nmes.world"]["config"]))
        except (NmesError, ValueError) as error:
            reason = reason or f": {error}"
            raise RecordingError("not_a_recording", f"{self.path} does not say how its world began{reason}") from None
        self.fingerprint = self.metadata["nmes.fingerprint"]

    @property
    def damage(self) -> DamagedFile | None:
        """The damage with which the recording ends early, or None. Checks the whole file if it was not read yet."""
        if not self._checked:
            for _ in self._walk(Chain.check):
                pass
        return self._damage

    @property
    def complete(self) -> bool:
        """Whether the recording was closed properly and all of it is sound."""
        return self.damage is None

    def __iter__(self) -> Iterator[Record]:
        return self.records()

    def records(self, start: Start | None = None) -> Iterator[Record]:
        """Yields the records in file order, from a `start` or the beginning on."""
        for _, records in self.chunks(start):
            yield from records

    def chunks(self, start: Start | None = None) -> Iterator[tuple[int, list[Record]]]:
        """Yields the records in file order, a chunk at a time, with how far into the file (in bytes) that reaches.

        Args:
            start: Where to begin, from `start`; None: at the beginning.
        """
        return self._walk(Chain.records, start)

    def _walk(self, read: Callable[[Chain, Block], _Part], start: Start | None = None) -> Iterator[tuple[int, _Part]]:
        """Reads chunk after chunk, and keeps where and why that ends.

        Args:
            read: Called with the chain and each chunk; its result is yielded.
            start: Where to begin; None: at the beginning.
        """
        chain = Chain(self._head) if start is None else start.chain.copy()
        offset = None if start is None else start.offset
        self.stopped = None
        end: dict[str, str] = {}
        begun = False
        try:
            for block in self._reader.blocks(offset):
                if end:
                    raise DamagedFile(block.offset, f"there is more at byte {block.offset}, behind the end")
                if block.metadata is None:
                    begun = True
                    yield block.offset + block.size, read(chain, block)
                elif block.metadata.name == END:
                    end = block.metadata.metadata
                elif begun:
                    raise DamagedFile(block.offset, f"metadata at byte {block.offset} stand among the records")
            if (end.get("head"), end.get("records")) != (chain.head.hex(), str(chain.sequence)):
                raise DamagedFile(self.size, "the file's closing metadata do not belong to its records")
            self.end = end
        except DamagedFile as error:
            self.stopped = _explained(error, chain)
        if offset is None:
            self._damage, self._checked = self.stopped, True

    def __repr__(self) -> str:
        return f"Recording({str(self.path)!r})"

    def _repr_html_(self) -> str:
        """Returns its card in a notebook, HTML; only its beginning is read for that."""
        config, about = self.config, self.metadata.get("nmes.evaluation", {})
        facts = {
            "size": f"{self.size:,} bytes",
            "world": config["name"],
            "engine": config["backend"],
            "pace": f"{config['tick_rate']} ticks a second, {config['mode']}",
            "seed": config["seed"],
            "genome": about.get("genome"),
        }
        return card(f"Recording {self.path.name}", facts)

    # -- tables ----------------------------------------------------------------------------------------------------

    def to_arrow(self, what: str = "states", *, keep_going: bool = False) -> Any:
        """Returns a table of what happened, a row for each tick and thing; docs/cli.md, `nmes export`, has the columns.

        All but `messages` is made by running the recording again.

        Args:
            what: `messages`, `states` (of cubes), `joints`, `controls`, `sensors`, or `scores`.
            keep_going: Go on where a tick does not come out as it was recorded, as on another machine.

        Returns:
            A `pyarrow.Table`.

        Raises:
            MissingPackage: pyarrow is not installed.
            ValueError: There is no such table.
            RecordingError: A tick does not come out as recorded (`diverged`, or `not_comparable` where the
                fingerprints differ).
            ProofError, DocumentError: Of scores, where the recording is none of an episode.
        """
        # Found by its name, as the package's front finds what it has: to read a recording loads no world.
        return importlib.import_module("nmes.evaluation.tables").arrow(self, what, keep_going=keep_going)

    def to_pandas(self, what: str = "states", *, keep_going: bool = False) -> Any:
        """Returns a `pandas.DataFrame` of what happened; as `to_arrow`.

        Raises:
            MissingPackage: pandas is not installed, or pyarrow.
        """
        try:
            importlib.import_module("pandas")
        except ImportError as error:
            raise MissingPackage("a DataFrame needs pandas: pip install 'nmes[arrow]' pandas") from error
        return self.to_arrow(what, keep_going=keep_going).to_pandas()

    # -- seeking ---------------------------------------------------------------------------------------------------

    def start(self, frame: int | None = None) -> Start:
        """Finds where to begin reading in order to come to a frame: at the last keyframe before it, or the beginning.

        A file says where its keyframes are: only what comes from there on is read and checked.

        Args:
            frame: The frame, counted on through resets; None: that with which the recording begins.

        Raises:
            RecordingError: The recording begins after that frame (`no_such_frame`).
        """
        first = self._first
        if frame is None:
            return first
        if frame < first.frame:
            raise RecordingError("no_such_frame", f"{self.path} begins at frame {first.frame}; it has no frame {frame}")
        if frame == first.frame or not self.config.get("keyframes"):
            return first
        return last_keyframe(self._reader, self._head, frame) or first

    @cached_property
    def _first(self) -> Start:
        return beginning(self._reader, self._head)

    @property
    def last_frame(self) -> int:
        """The frame with which it ends, counted on through resets; read from its last keyframe on."""
        start = self.start(_NEVER)
        return start.frame + _count_ticks(self.records(start))

    def require_beginning(self, who: str) -> None:
        """Refuses a recording that begins at a keyframe, on behalf of a server or an engine that cannot restore one.

        Args:
            who: The server or the engine, as it is called in the message.

        Raises:
            RecordingError: The recording begins at a keyframe (`unsupported`).
        """
        if self._first.snapshot is not None:
            begins = f"it begins at frame {self._first.frame}, in a running world of {self.config['backend']}"
            raise RecordingError("unsupported", f"{self.path} cannot be run on {who}: {begins}")

    def lineage(self, frame: int) -> dict[str, str]:
        """Makes the metadata `nmes.parent` of a recording that is forked from this one at a frame."""
        start = self.start(frame)
        ticks, head = start.frame, start.chain.head

        def read(chain: Chain, block: Block) -> tuple[list[Record], bytes]:
            return chain.records(block), chain.head

        for _, (records, after) in self._walk(read, start):
            ticks, head = ticks + _count_ticks(records), after
            if ticks > frame:
                break
        return {"recording": self._head.hex(), "head": head.hex(), "frame": str(frame), "file": self.path.name}

    def summary(self) -> Summary:
        """Counts the contents of the recording, by reading all of it."""
        return summarize(self)


def _count_ticks(records: Iterable[Record]) -> int:
    return sum(len(record.digests) for record in records)


def _explained(error: DamagedFile, chain: Chain) -> DamagedFile:
    """Adds to a damage which record it is in, as far as that can be known, and how many come before it."""
    extent = f"read up to record {chain.sequence - 1}" if chain.sequence else "no record can be read"
    number = None if error.content is None else chain.first_bad(error.content)
    place = "" if number is None else f"; record {number} is not as it was written"
    damage = DamagedFile(error.offset, f"{error.message}{place}; {extent}", cut=error.cut)
    damage.record = number
    return damage
