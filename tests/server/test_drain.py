"""A host that lets its clients end before it does."""

from __future__ import annotations

import http.client
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from nmes import Client
from nmes.errors import CommandFailed
from nmes.playback import replay
from nmes.protocol import validate_event
from nmes.recording import Recording
from nmes.server.reception import drain
from processes import process, ready
from servers import PASSWORD, PATIENCE, Peer, Served, served, types, until

LONG = 60.0  # s: no test waits for its end
AUTH = {"type": "auth", "password": PASSWORD}


def probe(port: int) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE)
    connection.request("GET", "/ready")
    answer = connection.getresponse()
    try:
        return answer.status, answer.read()
    finally:
        connection.close()


def options(folder: Path, *more: str) -> list[str]:
    flags = ["--backend", "ballistic", "--mode", "lockstep", "--record", str(folder), "--metrics-port", "0", *more]
    return ["serve", "--json", "--port", "0", *flags]


def listener(port: int) -> Peer:
    peer = Peer(port)
    assert peer.ask(AUTH)["type"] == "auth_success"
    peer.ask({"type": "subscribe", "events": ["tick"], "every": 10**6})
    return peer


@pytest.mark.parametrize("more", [[], ["--workers", "1"]], ids=["one process", "workers"])
def test_sigterm_waits_for_those_inside_and_lets_nobody_in(more: list[str], tmp_path: Path) -> None:
    with process(*options(tmp_path, "--drain", str(LONG), *more), NMES_PASSWORD=PASSWORD) as server:
        info = ready(server)
        with listener(info["port"]) as inside:
            assert probe(info["metrics_port"]) == (200, b"ready\n")
            server.send_signal(signal.SIGTERM)
            event = inside.hear()
            validate_event(event)
            assert event == {"type": "host_draining", "seconds": LONG}
            assert probe(info["metrics_port"]) == (503, b"draining\n")
            with pytest.raises(CommandFailed) as refused:
                Client(port=info["port"], password=PASSWORD, timeout=PATIENCE).connect()
            assert refused.value.code == "host_draining"
            with Peer(info["port"]) as maker:
                answer = maker.ask({**AUTH, "create": {"world": "new"}})
                assert answer["code"] == "host_draining"
            if more:
                (world,) = Client(port=info["port"], password=PASSWORD, timeout=PATIENCE).worlds()
                with pytest.raises(CommandFailed) as refused:
                    Client(port=world["worker_port"], password=PASSWORD, timeout=PATIENCE).connect()
                assert refused.value.code == "host_draining"
            worlds = Client(port=info["port"], password=PASSWORD, timeout=PATIENCE).worlds()
            assert [world["clients"] for world in worlds] == [1]
            assert inside.ask({"type": "step", "ticks": 5})["frame"] == 5  # who is in goes on
            assert server.poll() is None
        began = time.monotonic()
        assert server.wait(PATIENCE) == 0, server.communicate()
        assert time.monotonic() - began < LONG / 2
    (path,) = tmp_path.iterdir()
    recording = Recording(path)
    assert recording.complete
    assert (replay(recording).verdict, recording.summary().ticks) == ("reproduced", 5)


def test_it_ends_when_the_time_is_over(tmp_path: Path) -> None:
    with process(*options(tmp_path, "--drain", "0.3"), NMES_PASSWORD=PASSWORD) as server:
        info = ready(server)
        with listener(info["port"]) as inside:
            server.send_signal(signal.SIGTERM)
            assert types(inside.rest()) == ["host_draining", "world_closed"]
        assert server.wait(PATIENCE) == 0, server.communicate()
    (path,) = tmp_path.iterdir()
    assert Recording(path).complete


@pytest.mark.parametrize(
    ("drain", "signals", "told"),
    [
        (LONG, [signal.SIGTERM, signal.SIGTERM], ["host_draining", "world_closed"]),  # the second one is enough of it
        (LONG, [signal.SIGINT], ["world_closed"]),
        (0.0, [signal.SIGTERM], ["world_closed"]),
    ],
)
def test_it_is_not_waited_for(drain: float, signals: list[signal.Signals], told: list[str], tmp_path: Path) -> None:
    with process(*options(tmp_path, "--drain", str(drain)), NMES_PASSWORD=PASSWORD) as server:
        info = ready(server)
        with listener(info["port"]) as inside:
            heard: list[Any] = []
            for number in signals:
                server.send_signal(number)
                heard.append(inside.hear()["type"])
            assert [*heard, *types(inside.rest())] == told
        assert server.wait(PATIENCE) == 0, server.communicate()
    (path,) = tmp_path.iterdir()
    assert Recording(path).complete


def test_an_empty_host_ends_at_once() -> None:
    with served() as server:
        began = time.monotonic()
        server.run(drain(server.host, LONG))
        assert time.monotonic() - began < LONG / 2


def stepping(server: Served) -> Peer:
    """Returns a client that waits for a step which lasts."""
    peer = server.peer()
    places = [[1.2 * (n % 20), 1 + n // 20, 0.7 * (n // 20)] for n in range(100)]
    peer.ask({"type": "batch", "commands": [{"type": "spawn_cube", "position": place} for place in places]})
    peer.ask({"type": "subscribe", "events": ["tick"], "every": 10**6})
    peer.say({"type": "step", "ticks": 300})
    return peer


def test_who_waits_for_a_long_step_is_told_when_it_is_over() -> None:
    with served({"backend": "mujoco"}) as server:
        with stepping(server) as peer, ThreadPoolExecutor(1) as beside:
            until(lambda: server.hosted.world.frame > 0)
            waiting = beside.submit(server.run, drain(server.host, LONG))
            heard = [peer.hear(), peer.hear()]  # the world was in a thread until the step was over
            assert {"type": "host_draining", "seconds": LONG} in heard
            assert "stepped" in [each["type"] for each in heard], heard
            peer.socket.close()
            waiting.result(PATIENCE)
