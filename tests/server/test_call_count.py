"""The way of one command from the socket to the recording and back is short."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from layout import ROOT
from nmes.recording import Kind, Recording
from nmes.server.connection import Connection
from servers import served

MOST = 24
PUSH = {"type": "apply_physics", "cube_name": "cube", "force": [1.5, 0, -0.5]}
PACKAGES = tuple(str(ROOT / folder) + "/" for folder in ("nmes", "backends", "schemas"))


@contextmanager
def counted(calls: list[str]) -> Iterator[None]:
    """Notes the calls of our own functions in this thread."""

    def note(frame: FrameType, event: str, _: Any) -> None:
        if event == "call" and frame.f_code.co_filename.startswith(PACKAGES):
            calls.append(f"{frame.f_code.co_filename.removeprefix(str(ROOT))}: {frame.f_code.co_qualname}")

    sys.setprofile(note)
    try:
        yield
    finally:
        sys.setprofile(None)


@pytest.mark.parametrize("backend", ["ballistic", "mujoco"])
def test_a_recorded_command_takes_few_calls(backend: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[str] = []
    receive: Callable[[Connection, int], None] = Connection.buffer_updated

    def count(connection: Connection, nbytes: int) -> None:
        calls.clear()
        with counted(calls):
            receive(connection, nbytes)

    with served({"backend": backend}, record_to=tmp_path) as server, server.peer() as peer:
        assert peer.ask({"type": "spawn_cube", "cube_name": "cube"})["spawned"] == "cube"
        expected = peer.ask(PUSH)
        monkeypatch.setattr(Connection, "buffer_updated", count)
        assert peer.ask(PUSH) == expected
        server.call(monkeypatch.undo)  # in the host's thread, so after the call has returned
    assert any(call.endswith("World.handle") for call in calls)
    assert len(calls) <= MOST, "\n".join(calls)
    (path,) = tmp_path.iterdir()
    assert [record.kind for record in Recording(path) if record.kind is Kind.COMMAND] == [Kind.COMMAND] * 3
