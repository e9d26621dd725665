"""The suite against servers that want it to hang, to stumble or to show what they like: it judges them all the same."""

from __future__ import annotations

import base64
import hashlib
import itertools
import json
import socket
from contextlib import AbstractContextManager
from typing import Any

import pytest
from click.testing import CliRunner
from click.testing import Result as Outcome

from hostile_servers import ANSWERS, WELCOME, Answer, answering, listening
from nmes.cli import main
from nmes.conformance import Options, Report, Target, Verdict, run
from nmes.conformance.report import describe
from nmes.protocol import DELIMITER
from servers import PASSWORD, PATIENCE

TICKS = b'{"type":"tick","frame":1,"t":0.1}' + DELIMITER
SUBSCRIBED = {
    "type": "subscribed", "events": ["tick"], "every": 1, "position_threshold": 0.01, "rotation_threshold": 0.01
}  # fmt: skip
SPAWNED = {"type": "cube_list", "cubes": [], "spawned": "cube_1_aaaaaaaa"}


def judge(port: int, *only: str, timeout: float = 0.3, scheme: str = "tcp", **options: Any) -> Report:
    return run(Target("127.0.0.1", port, PASSWORD, timeout, scheme), Options(only=only, **options))


def answering_one(kind: str, answer: Answer) -> AbstractContextManager[int]:
    """Runs a server that gives commands of a type that answer, and is well otherwise."""
    return answering(lambda said: answer if said["type"] == kind else None)


def conform(*arguments: str) -> Outcome:
    return CliRunner().invoke(main, ["conform", *arguments], env={"NMES_PASSWORD": PASSWORD})


# -- servers that never end -------------------------------------------------------------------------------------------


def test_a_server_that_sends_events_without_end_fails_after_one_time_out() -> None:
    def answer(said: dict[str, Any]) -> Answer | None:
        if said["type"] == "step":
            return {"type": "stepped", "frame": 1, "t": 0.1}
        if said["type"] == "subscribe":
            return SUBSCRIBED
        return itertools.repeat(TICKS) if said["type"] == "ping" else None

    with answering(answer) as port:
        report = judge(port, "5.1", "11.1")
    assert [result.verdict for result in report.results] == [Verdict.FAILED] * 2
    assert [result.expected for result in report.results] == ["a reply to ping in time", "events and pong in time"]


def test_a_server_that_sends_half_a_frame_without_end_is_not_quiet() -> None:
    def serve(connection: socket.socket) -> None:
        connection.recv(1 << 16)
        connection.sendall(json.dumps(WELCOME).encode() + DELIMITER)
        while True:
            connection.sendall(b"x" * 65536)

    with listening(serve) as port:
        report = judge(port, "1.5")
    assert [result.verdict for result in report.results] == [Verdict.FAILED]


def test_a_server_that_answers_cleaning_up_without_end_ends_the_case() -> None:
    def answer(said: dict[str, Any]) -> Answer | None:
        if said["type"] == "spawn_cube":
            return SPAWNED
        return itertools.repeat(b'{"type":"pang"}' + DELIMITER) if said["type"] == "despawn_cube" else None

    with answering(answer) as port:
        (result,) = judge(port, "7.5").results
    assert result.verdict is Verdict.FAILED
    assert b"could not clean up" in result.log[-1].data


def accept_key(request: bytes) -> bytes:
    (key,) = (line.split(b": ")[1] for line in request.split(b"\r\n") if line.lower().startswith(b"sec-websocket-key"))
    return base64.b64encode(hashlib.sha1(key + b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11").digest())


def test_a_websocket_of_control_frames_without_end_fails_after_one_time_out() -> None:
    def serve(connection: socket.socket) -> None:
        request = b""
        while b"\r\n\r\n" not in request:
            request += connection.recv(1 << 16)
        head = (
            b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Accept: "
        )
        connection.sendall(head + accept_key(request) + b"\r\n\r\n")
        while True:
            connection.sendall(b"\x8a\x00")  # pongs that nobody asked for

    with listening(serve) as port:
        report = judge(port, "5.1", scheme="ws")
    assert [result.expected for result in report.results] == ["auth_success in time"]


def test_a_time_limit_runs_before_the_first_case() -> None:
    with listening(lambda connection: None) as port:
        report = judge(port, "5.1", "5.2*", "10.1", timeout=100 * PATIENCE, time_limit=0.3)
    assert report.halted == "the time limit of 0.3 s was over" and report.exit_status == 2
    assert {result.reason for result in report.results} == {report.halted}


# -- answers that hardly anything can read ----------------------------------------------------------------------------


@pytest.mark.parametrize("value", ["[" * 400 + "]" * 400, "9" * 400, "-" + "9" * 309, '{"a":' * 300 + "1" + "}" * 300])
def test_what_is_nested_too_deep_or_beyond_all_numbers_is_no_strict_json(value: str) -> None:
    for kind in ("auth", "get_world_info", "ping"):
        sent = json.dumps(ANSWERS[kind])[:-1].encode() + f',"x":{value}}}'.encode() + DELIMITER
        with answering_one(kind, [sent]) as port:
            outcome = conform(f"127.0.0.1:{port}", "--only", "5.1", "--timeout", "0.5", "--json")
        report = json.loads(outcome.stdout)
        (result,) = report["results"]
        if kind == "get_world_info":
            assert "strict JSON" in report["trouble"]
        else:
            assert (outcome.exit_code, result["verdict"], result["cause"]) == (1, "failed", "no strict JSON")


# -- words for the terminal -------------------------------------------------------------------------------------------


def test_what_a_server_says_does_not_command_the_terminal() -> None:
    with answering_one("ping", [b"\x1b[2J\x1b[32mconforms\n\xe2\x80\xae" + DELIMITER]) as port:
        outcome = conform(f"127.0.0.1:{port}", "--only", "5.1")
        (result,) = judge(port, "5.1").results
    for text in (outcome.output, describe(result)):
        assert r"\x1b[2J\x1b[32mconforms\n\u202e" in text
        assert not {"\x1b", "\u202e"} & set(text)


# -- more than anybody wants to keep ----------------------------------------------------------------------------------


def test_of_long_answers_the_ends_are_kept_and_of_good_ones_nothing() -> None:
    pad = "x" * (2 << 20)
    for kind, verdict in (("pong", Verdict.OK), ("pang", Verdict.FAILED)):
        sent = {"type": kind, "pad": pad}
        with answering_one("ping", sent) as port:
            report = judge(port, "1.1", timeout=PATIENCE)
        (result,) = report.results
        assert result.verdict is verdict
        assert (verdict is Verdict.OK) == (result.log == [])
        assert sum(len(entry.data) for entry in result.log) < len(pad) / 2
    assert "bytes left out]... " in describe(result)


# -- nothing to judge -------------------------------------------------------------------------------------------------


def test_a_server_that_leaves_out_all_that_is_asked_for_was_not_judged() -> None:
    with answering(lambda said: None) as port:
        outcome = conform(f"127.0.0.1:{port}", "--only", "16.1:get_planets", "--json")
    assert [result["verdict"] for result in json.loads(outcome.stdout)["results"]] == ["unimplemented"]
    assert outcome.exit_code == 2
