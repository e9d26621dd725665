"""Agents that share a world in lockstep: it ticks when all of them have said `step`."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from nmes import World, protocol
from nmes.playback import replay
from nmes.recording import Kind, Recording
from servers import Peer, Served, served, until

STEP = {"type": "step"}


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Served]:
    """A served world whose recording, however the test went, is reproduced."""
    with served(record_to=tmp_path) as running:
        yield running
    (path,) = tmp_path.iterdir()
    assert replay(path).verdict == "reproduced"


def agree(peer: Peer, agents: int, **more: Any) -> None:
    reply = peer.ask({"type": "set_mode", "mode": "lockstep", "barrier": True, "agents": agents, **more})
    protocol.validate_reply(reply)
    assert reply["barrier"] is True


def frame(server: Served) -> int:
    return server.call(lambda: server.hosted.world.frame)


def waiting(server: Served) -> int:
    return server.call(lambda: len(server.hosted._barrier.waiting))


def test_the_world_ticks_when_all_agents_have_sent_step(server: Served, tmp_path: Path) -> None:
    with server.peer() as one, server.peer() as two, server.peer() as watcher:
        agree(watcher, 2)
        for round in range(1, 6):
            first, last = (one, two) if round % 2 else (two, one)
            first.say({"type": "apply_physics", "cube_name": "nobody"}, STEP, {"type": "ping"})
            until(lambda: waiting(server) == 1)
            assert watcher.ask({"type": "ping"})["type"] == "pong"  # who does not control is not kept waiting
            assert frame(server) == round - 1
            assert first.hear()["code"] == "cube_not_found"
            last.say(STEP)
            stepped = last.hear()
            assert (stepped["type"], stepped["frame"]) == ("stepped", round)
            assert first.hear() == stepped
            assert first.hear()["type"] == "pong"  # what came after the step waited
    (path,) = tmp_path.iterdir()
    server.close()
    assert sum(record.kind is Kind.TICKS for record in Recording(path)) == 5


def test_a_single_agent_ticks_at_once_and_another_is_waited_for_after_its_first_step(server: Served) -> None:
    with server.peer() as one, server.peer() as two:
        agree(one, 1)
        assert one.ask(STEP)["frame"] == 1
        assert one.ask(STEP)["frame"] == 2
        two.say(STEP)
        until(lambda: waiting(server) == 1)
        assert frame(server) == 2
        assert one.ask(STEP)["frame"] == 3
        assert two.hear()["frame"] == 3


def test_a_step_of_several_ticks_counts_for_as_many_rounds(server: Served) -> None:
    with server.peer() as one, server.peer() as two:
        agree(one, 2)
        one.say({"type": "step", "ticks": 3})
        until(lambda: waiting(server) == 1)
        assert [two.ask(STEP)["frame"] for _ in range(2)] == [1, 2]
        two.say({"type": "step", "ticks": 2})
        assert one.hear()["frame"] == 3
        assert one.ask(STEP)["frame"] == two.hear()["frame"] == 4


def test_an_agent_that_leaves_is_no_longer_waited_for(server: Served) -> None:
    with server.peer() as one, server.peer() as two:
        agree(one, 2)
        one.say(STEP)
        two.say(STEP)
        assert one.hear()["frame"] == two.hear()["frame"] == 1
        one.say(STEP)
        until(lambda: waiting(server) == 1)
        two.socket.close()
        assert one.hear()["frame"] == 2
        assert one.ask(STEP)["frame"] == 3


def test_the_step_of_an_agent_that_leaves_while_waiting_counts(server: Served) -> None:
    with server.peer() as one, server.peer() as two:
        agree(one, 2)
        one.say(STEP)
        until(lambda: waiting(server) == 1)
        one.socket.close()
        assert two.ask(STEP)["frame"] == 1
        until(lambda: server.call(lambda: server.hosted.clients) == 1)
        assert two.ask(STEP)["frame"] == 2


def test_a_late_agent_is_reported_and_skipped(server: Served, caplog: pytest.LogCaptureFixture) -> None:
    with server.peer() as one, server.peer() as two, server.peer() as watcher:
        watcher.ask({"type": "subscribe", "events": ["tick"], "every": 1000})
        agree(one, 2, timeout=0.2)
        one.say(STEP)
        two.say(STEP)
        assert one.hear()["frame"] == two.hear()["frame"] == 1
        assert one.ask(STEP)["frame"] == 2
        event = watcher.hear()
        protocol.validate_event(event)
        assert event == {"type": "barrier_timeout", "frame": 1, "clients": [2]}
        assert "goes on at frame 1 without clients [2]" in caplog.text
        assert one.ask(STEP)["frame"] == 3  # it is not waited for any more
        two.say(STEP)
        until(lambda: waiting(server) == 1)
        assert one.ask(STEP)["frame"] == two.hear()["frame"] == 4


def test_agents_that_never_come_are_waited_for_until_the_time_out(server: Served) -> None:
    with server.peer() as one, server.peer() as watcher:
        watcher.ask({"type": "subscribe"})
        agree(one, 2, timeout=0.1)
        assert one.ask(STEP)["frame"] == 1
        assert watcher.hear() == {"type": "barrier_timeout", "frame": 0, "clients": []}
        assert one.ask(STEP)["frame"] == 2


@pytest.mark.parametrize("mode", ["lockstep", "fast"])
def test_a_change_of_mode_releases_waiting_agents(server: Served, mode: str) -> None:
    with server.peer() as one, server.peer() as two:
        agree(one, 2)
        one.say(STEP)
        until(lambda: waiting(server) == 1)
        assert "barrier" not in two.ask({"type": "set_mode", "mode": mode})
        answer = one.hear()
        assert answer["type"] == ("stepped" if mode == "lockstep" else "error")
        two.ask({"type": "set_mode", "mode": "lockstep"})


def test_a_new_barrier_keeps_the_agents_that_wait(server: Served) -> None:
    with server.peer() as one, server.peer() as two:
        agree(one, 3)
        one.say(STEP)
        until(lambda: waiting(server) == 1)
        agree(two, 2)
        assert two.ask(STEP)["frame"] == one.hear()["frame"] == 1


def test_a_fault_releases_waiting_agents(server: Served) -> None:
    with server.peer() as one, server.peer() as two:
        agree(one, 2)
        one.ask({"type": "spawn_cube", "cube_name": "a", "mass": 1e-6})
        one.ask({"type": "apply_force", "cube_name": "a", "force": [1e15, 0, 0]})
        one.say({"type": "step", "ticks": 1000})
        two.say({"type": "step", "ticks": 1000})
        assert one.hear()["code"] == two.hear()["code"] == "world_faulted"
        assert two.ask({"type": "reset"})["frame"] == 0
        one.say(STEP)
        assert two.ask(STEP)["frame"] == one.hear()["frame"] == 1


def test_closing_the_host_releases_waiting_agents(server: Served) -> None:
    with server.peer() as one:
        agree(one, 2)
        one.say(STEP)
        until(lambda: waiting(server) == 1)
        server.close()
        assert {json.loads(last)["type"] for last in one.rest()} <= {"error"}


def test_options_that_contradict_a_barrier_are_refused() -> None:
    world = World({"backend": "ballistic", "mode": "lockstep"})
    client = world.join()
    refused = world.execute(client, {"type": "set_mode", "mode": "fast", "barrier": True})
    assert (refused["code"], refused["field"], world.mode) == ("wrong_mode", "barrier", "lockstep")
    for agents in (0, 1001):
        assert world.execute(client, {"type": "set_mode", "mode": "lockstep", "agents": agents})["code"] == "invalid"
    world.execute(client, {"type": "set_mode", "mode": "lockstep", "barrier": True})
    batch = world.execute(client, {"type": "batch", "commands": [STEP, {"type": "ping"}]})
    assert [part["type"] for part in batch["results"]] == ["error", "pong"]
    assert batch["results"][0]["code"] == "wrong_mode"
    world.execute(client, {"type": "set_mode", "mode": "lockstep"})
    assert world.execute(client, {"type": "batch", "commands": [STEP]})["results"][0]["frame"] == 1
