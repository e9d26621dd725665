"""The way of one command from the socket to the recording and back is short."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from layout import ROOT
from nmes.recording import Kind, Recording
from nmes.server.connection import LONG, Connection
from servers import PASSWORD, served

MOST = 25
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
    calls = calls_of_a_push({"backend": backend}, None, tmp_path, monkeypatch)
    assert len(calls) <= MOST, "\n".join(calls)


@pytest.mark.parametrize(("role", "more"), [("owner", 0), ("player", 3)])
def test_to_judge_a_command_by_its_role_takes_few_calls_more(
    role: str, more: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = calls_of_a_push({"roles": {"player": {}}}, role, tmp_path, monkeypatch)
    assert len(calls) <= MOST + more, "\n".join(calls)


def calls_of_a_push(
    config: dict[str, Any], role: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> list[str]:
    """Returns the calls of ours for one recorded command of a role, from its bytes to those of the reply."""
    calls: list[str] = []
    receive: Callable[[Connection, int], None] = Connection.buffer_updated

    def count(connection: Connection, nbytes: int) -> None:
        calls.clear()
        with counted(calls):
            receive(connection, nbytes)

    with served(config, record_to=tmp_path) as server, server.peer(None) as peer:
        auth = {"type": "auth", "password": PASSWORD, **({} if role is None else {"role": role})}
        assert peer.ask(auth).get("role") == role
        assert peer.ask({"type": "spawn_cube", "cube_name": "cube"})["spawned"] == "cube"
        expected = peer.ask(PUSH)
        monkeypatch.setattr(Connection, "buffer_updated", count)
        assert peer.ask(PUSH) == expected
        server.call(monkeypatch.undo)  # in the host's thread, so after the call has returned
    assert any(call.endswith("World.handle") for call in calls)
    (path,) = tmp_path.iterdir()
    assert [record.kind for record in Recording(path) if record.kind is Kind.COMMAND] == [Kind.COMMAND] * 3
    return calls


def test_commands_of_one_write_are_read_in_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    # Code that has just run runs faster: each read just before it is executed, commands take a tenth longer.
    calls: list[str] = []
    receive: Callable[[Connection, int], None] = Connection.buffer_updated
    pings = 200
    message = {"type": "ping", "id": "x" * 100}

    def count(connection: Connection, nbytes: int) -> None:
        with counted(calls):
            receive(connection, nbytes)

    with served({"backend": "ballistic"}) as server, server.peer() as peer:
        monkeypatch.setattr(Connection, "buffer_updated", count)
        peer.say(*[message] * pings)
        assert [peer.hear()["id"] for _ in range(pings)] == [message["id"]] * pings
        server.call(monkeypatch.undo)
    steps = [call.rpartition(".")[2] for call in calls if call.endswith((": parse", "World.handle"))]
    rows = [len(list(row)) for step, row in groupby(steps) if step.endswith("parse")]
    assert max(rows) > 20
    assert max(rows) * len(json.dumps(message)) <= LONG  # others wait no longer for them than for one frame
