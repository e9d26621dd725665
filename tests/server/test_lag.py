"""A world that falls behind the clock says so, and when it keeps up again; driven by a clock that the test holds."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from prometheus_client.parser import text_string_to_metric_families

from nmes import World, protocol
from nmes.cli import main
from nmes.playback import replay
from nmes.server.metrics import Metrics
from servers import PASSWORD, Peer, Served, served

TICK = 1 / 60


class HeldTime:
    """Wall time (s) that passes where a test says so: a little whenever somebody looks, and with every tick.

    Attributes:
        tick: How long each tick takes.
        stumble: How much longer one of them takes.
    """

    def __init__(self) -> None:
        self.tick = 0.0
        self.stumble = 0.0
        self._now = 0.0
        self._lock = threading.Lock()

    def monotonic(self) -> float:
        self.pass_by(2e-4)
        return self._now

    def pass_by(self, duration: float) -> None:
        with self._lock:
            self._now += duration


@pytest.fixture
def time(monkeypatch: pytest.MonkeyPatch) -> HeldTime:
    held, tick = HeldTime(), World.tick

    def slow_tick(world: World) -> None:
        stumble, held.stumble = held.stumble, 0.0
        held.pass_by(held.tick + stumble)
        tick(world)

    for module in ("clock", "threads", "hosted_world"):
        monkeypatch.setattr(f"nmes.server.{module}.monotonic", held.monotonic)
    monkeypatch.setattr(World, "tick", slow_tick)
    return held


@pytest.fixture
def metrics() -> Metrics:
    return Metrics()


@pytest.fixture
def server(time: HeldTime, tmp_path: Path, metrics: Metrics) -> Iterator[Served]:
    world = {"mode": "realtime", "backend": "ballistic"}
    with served(world, record_to=tmp_path, metrics=metrics) as running:
        yield running


def lagging(watcher: Peer, told: Callable[[Any], bool]) -> Any:
    """Returns the next event that the world lags and of which something is true."""
    while True:
        event = watcher.hear()
        protocol.validate_event(event)
        assert event["type"] == "lagging", event
        if told(event):
            return event


def subscribed(server: Served) -> Peer:
    peer = server.peer()
    peer.ask({"type": "subscribe", "events": ["tick"], "every": 10**6})
    return peer


def gauges(server: Served, metrics: Metrics) -> dict[str, float]:
    families = list(text_string_to_metric_families(server.call(metrics.page).decode()))
    return {sample.name: sample.value for family in families for sample in family.samples}


def listed(server: Served, *options: str) -> str:
    arguments = ["worlds", f"127.0.0.1:{server.port}", *options]
    done = CliRunner().invoke(main, arguments, env={"NMES_PASSWORD": PASSWORD})
    assert done.exit_code == 0, done.output
    return done.output


def test_a_world_at_half_of_real_time_says_so_and_again_when_it_keeps_up(
    server: Served, time: HeldTime, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    with subscribed(server) as watcher:
        time.tick = 2 * TICK
        first = lagging(watcher, lambda event: True)
        assert not first["over"]
        assert 0.5 < first["behind"] < 1.5
        later = lagging(watcher, lambda event: event["behind"] > 3.0)
        assert later["frame"] > first["frame"]
        assert later["ratio"] == pytest.approx(0.5, abs=0.03)
        time.tick = 0.0
        over = lagging(watcher, lambda event: event["over"])
        assert over["frame"] > later["frame"]
        assert over["behind"] >= later["behind"]
    assert "world 'main' falls behind: it runs at 0." in caplog.text


@pytest.mark.parametrize(("stumble", "told"), [(0.6, False), (1.5, True)])
def test_a_world_that_stumbles_says_so_where_much_is_lost(
    server: Served, time: HeldTime, stumble: float, told: bool
) -> None:
    with subscribed(server) as watcher, server.peer() as other:

        def frame() -> int:
            count = other.ask({"type": "get_world_info"})["frame"]
            assert isinstance(count, int)
            return count

        start = frame()
        time.stumble = stumble
        while frame() < start + 180:
            pass
        assert time.stumble == 0.0
        watcher.say({"type": "ping"})
        if told:
            assert not lagging(watcher, lambda event: True)["over"]
            assert lagging(watcher, lambda event: True)["over"]
        assert watcher.hear()["type"] == "pong"


def test_the_log_tells_of_it_once_a_minute(server: Served, time: HeldTime, caplog: pytest.LogCaptureFixture) -> None:
    with subscribed(server) as watcher:
        time.tick = 0.5
        lagging(watcher, lambda event: event["behind"] > 150.0)
    lines = [record.args for record in caplog.records if "falls behind" in record.message]
    behind = [args[2] for args in lines if isinstance(args, tuple) and isinstance(args[2], float)]
    assert len(behind) == len(lines)
    assert len([seconds for seconds in behind if seconds < 150.0]) == 3  # the world runs on while the test looks
    assert all(later - earlier > 57.0 for earlier, later in pairwise(behind))


def test_a_pause_ends_it(server: Served, time: HeldTime) -> None:
    with subscribed(server) as watcher, server.peer() as other:
        time.tick = 2 * TICK
        lagging(watcher, lambda event: not event["over"])
        assert other.ask({"type": "pause"})["type"] == "paused"
        assert lagging(watcher, lambda event: event["over"])["ratio"] <= 1.0


def test_lists_and_metrics_show_it(server: Served, time: HeldTime, metrics: Metrics) -> None:
    assert '"ratio": null' in listed(server, "--json")
    assert gauges(server, metrics)["nmes_world_pace_ratio"] == 1.0
    with subscribed(server) as watcher:
        time.tick = 2 * TICK
        behind = lagging(watcher, lambda event: event["behind"] > 1.0)["behind"]
        assert '"ratio": 0.' in listed(server, "--json")
        assert "realtime, lags: 0." in listed(server)
        found = gauges(server, metrics)
        assert found["nmes_world_pace_ratio"] < 0.6
        assert found["nmes_lost_seconds_total"] >= behind
        time.tick = 0.0
        over = lagging(watcher, lambda event: event["over"])
    assert '"ratio": null' in listed(server, "--json")
    assert gauges(server, metrics)["nmes_world_pace_ratio"] == 1.0
    assert gauges(server, metrics)["nmes_lost_seconds_total"] >= over["behind"] - 0.001  # which is told in ms


def test_it_reaches_no_recording(server: Served, time: HeldTime) -> None:
    with subscribed(server) as watcher:
        time.tick = 2 * TICK
        lagging(watcher, lambda event: not event["over"])
        path = server.hosted.recording
    server.close()
    assert path is not None
    assert replay(path).verdict == "reproduced"
    assert b"lagging" not in path.read_bytes()
