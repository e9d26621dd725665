"""What a host logs for programs, and counts for Prometheus."""

from __future__ import annotations

import asyncio
import json
import logging
import socket
import urllib.request
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from prometheus_client.parser import text_string_to_metric_families

from nmes import Client
from nmes.cli import _logs, main
from nmes.errors import CommandFailed
from nmes.recording import Recording
from nmes.server import Host
from nmes.server.metrics import LISTED, Figures, Metrics, WorldFigures
from processes import process, ready
from recordings import busy, record
from servers import PASSWORD, PATIENCE, served, until

Series = dict[tuple[str, tuple[tuple[str, str], ...]], float]


def scrape(port: int) -> Series:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=PATIENCE) as page:
        return parse(page.read().decode())


def parse(text: str) -> Series:
    return {
        (sample.name, tuple(sorted(sample.labels.items()))): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def value(series: Series, name: str, **labels: str) -> float | None:
    return series.get((name, tuple(sorted(labels.items()))))


def test_commands_ticks_bytes_and_clients_are_counted(tmp_path: Path) -> None:
    options = ["--backend", "ballistic", "--mode", "lockstep", "--worlds", "red,green", "--record", str(tmp_path)]
    with process("serve", "--json", "--port", "0", "--metrics-port", "0", *options, NMES_PASSWORD=PASSWORD) as server:
        info = ready(server)
        port = info["metrics_port"]
        assert value(scrape(port), "nmes_worlds") == 0
        with Client(port=info["port"], password=PASSWORD, timeout=PATIENCE) as client:
            client.spawn_cube("a")
            for _ in range(2):
                with pytest.raises(CommandFailed):
                    client.get_cube_info("b")
            with pytest.raises(CommandFailed):
                client.request({"type": "of a stranger"})
            client.step(5)
            client.batch([{"type": "step", "ticks": 2}])
            series = scrape(port)
            assert value(series, "nmes_worlds") == 1
            assert value(series, "nmes_connections") == value(series, "nmes_clients") == 1
            assert value(series, "nmes_world_clients", world="red") == 1
            assert value(series, "nmes_tick_seconds_count") == value(series, "nmes_world_ticks_total", world="red") == 7
            assert value(series, "nmes_world_faulted", world="red") == value(series, "nmes_worlds_faulted") == 0

            def commands(kind: str, outcome: str) -> float | None:
                return value(series, "nmes_commands_total", type=kind, outcome=outcome)

            assert commands("spawn_cube", "ok") == 1
            assert commands("get_cube_info", "cube_not_found") == 2
            assert commands("none", "unknown_type") == 1
            assert commands("step", "ok") == commands("batch", "ok") == 1
            received = value(series, "nmes_received_bytes_total")
            client.ping()
            more = scrape(port)
            assert received is not None and (value(more, "nmes_received_bytes_total") or 0) > received > 100
            assert (value(more, "nmes_sent_bytes_total") or 0) > 100
            lag = value(more, "nmes_world_recording_lag_seconds", world="red")
            assert lag is not None and 0 <= lag < PATIENCE
            client.spawn_cube("b", mass=1e-6)
            client.apply_force("b", force=[1e15, 0, 0])
            with pytest.raises(CommandFailed):
                client.step(100)
            series = scrape(port)
            assert value(series, "nmes_world_faulted", world="red") == value(series, "nmes_worlds_faulted") == 1
        assert "green" not in str(more)
        server.terminate()
        assert server.wait(PATIENCE) == 0
    (path,) = tmp_path.iterdir()
    assert Recording(path).complete


def test_an_unrecorded_world_has_no_lag_and_realtime_ticks_are_counted() -> None:
    metrics = Metrics()
    with served({"mode": "realtime", "rate": 50}, metrics=metrics) as server:
        until(lambda: (value(parse(server.call(metrics.page).decode()), "nmes_tick_seconds_count") or 0) > 100)
        assert (
            value(parse(server.call(metrics.page).decode()), "nmes_world_recording_lag_seconds", world="main") is None
        )


async def test_a_record_is_as_old_as_it_is_and_not_as_the_last_before_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 1000.0
    monkeypatch.setattr("nmes.server.world_recorder.monotonic", lambda: now)
    async with Host(PASSWORD, record_to=tmp_path) as host:  # which does nothing by itself until it listens
        hosted = host.add({"backend": "ballistic", "mode": "lockstep"})
        hosted.world.tick()
        await hosted.flush()
        now += 3600
        await hosted.flush()  # there is nothing to do
        hosted.world.tick()
        now += 1
        assert hosted.figures.unwritten == 1
        await hosted.hibernation.begin(0)
        assert hosted.hibernation.resting
        now += 3600
        hosted.hibernation.wake()
        while not hosted.readable:
            await asyncio.sleep(0.01)
        hosted.world.tick()
        now += 2
        assert hosted.figures.unwritten == 2


def test_the_page_stays_short_for_many_worlds_and_counts_them_all() -> None:
    def page(worlds: int) -> bytes:
        awake = [WorldFigures(f"w{n}", 1, n % 3 == 0, 0.5, 1.0, 0.0, n, 0.1) for n in range(worlds)]
        metrics = Metrics()
        metrics.watch(lambda: Figures(worlds, 0, 0, True, worlds + 7, awake))
        return metrics.page()

    many = page(27_000)
    assert len(many) < 2 * len(page(LISTED)) < 200_000
    series = parse(many.decode())
    assert value(series, "nmes_worlds") == 27_007
    assert value(series, "nmes_worlds_asleep") == 7
    assert value(series, "nmes_clients") == 27_000
    assert value(series, "nmes_worlds_faulted") == 9_000
    assert value(series, "nmes_worlds_listed") == LISTED
    assert value(series, "nmes_world_ticks_total", world=f"w{LISTED - 1}") == LISTED - 1
    assert value(series, "nmes_world_ticks_total", world=f"w{LISTED}") is None


def test_nothing_waits_to_be_written_where_nothing_happens(tmp_path: Path) -> None:
    metrics = Metrics()
    with served(metrics=metrics, record_to=tmp_path, flush_interval=0.02) as server:
        port = server.run(server.host.probes.listen("127.0.0.1", 0))
        with server.client() as client:
            client.ping()
            until(lambda: value(scrape(port), "nmes_world_recording_lag_seconds", world="main") == 0.0)
            written = server.hosted.recording
            assert written is not None
            kinds = [record.kind.value for record in Recording(written)]
            assert kinds == ["joined", "command", "reply"]


@pytest.mark.parametrize("backend", ["ballistic", "pymunk"])
def test_ticks_replayed_on_resume_are_not_counted(tmp_path: Path, backend: str) -> None:
    path = record(tmp_path / "parent.mcap", busy, {"backend": backend})
    options = ["--json", "--port", "0", "--metrics-port", "0", "--record", str(tmp_path / "on"), "--resume", str(path)]
    with process("serve", *options, NMES_PASSWORD=PASSWORD) as server:
        info = ready(server)
        with Client(port=info["port"], password=PASSWORD, timeout=PATIENCE) as client:
            client.step(3)
            series = scrape(info["metrics_port"])
            assert value(series, "nmes_tick_seconds_count") == 3
            assert sum(series[key] for key in series if key[0] == "nmes_commands_total") == 1


async def test_by_default_nothing_is_counted() -> None:
    async with Host(PASSWORD) as host:
        world = host.add({"backend": "ballistic"}).world
        assert type(world).__module__ == "nmes.world.world"


def test_a_metrics_port_that_is_taken_is_an_error() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        result = CliRunner().invoke(main, ["serve", "--no-record", "--metrics-port", port])
    assert result.exit_code == 1
    assert f"cannot listen on 127.0.0.1:{port}" in result.output


def test_logs_are_written_as_json_lines(tmp_path: Path) -> None:
    options = ["--backend", "ballistic", "--mode", "lockstep", "--no-record", "--log-format", "json"]
    with process("serve", "--json", "--port", "0", *options, NMES_PASSWORD=PASSWORD) as server:
        info = ready(server)
        with pytest.raises(CommandFailed):
            Client(port=info["port"], password="a guess", timeout=PATIENCE).connect()
        with Client(port=info["port"], password=PASSWORD, timeout=PATIENCE) as client:
            client.spawn_cube("a", mass=1e-6)
            client.apply_force("a", force=[1e15, 0, 0])
            with pytest.raises(CommandFailed):
                client.step(100)
        server.terminate()
        _, log = server.communicate(timeout=PATIENCE)
    entries: list[dict[str, Any]] = [json.loads(line) for line in log.splitlines()]
    assert [entry["level"] for entry in entries] == ["warning", "error"]
    assert [entry["logger"] for entry in entries] == ["nmes.server.connection", "nmes.server.hosted_world"]
    assert "failed to authenticate" in entries[0]["message"]
    assert "world 'main' stopped" in entries[1]["message"]
    assert all(entry["time"].endswith("+00:00") for entry in entries)
    assert "a guess" not in log and PASSWORD not in log


def test_a_traceback_is_part_of_its_json_line() -> None:
    try:
        raise ValueError("two\nlines")
    except ValueError as error:
        record = logging.LogRecord(
            "x", logging.ERROR, "", 0, "said %s", ("so",), (ValueError, error, error.__traceback__)
        )
    line = _logs._Json().format(record)
    assert "\n" not in line
    assert json.loads(line)["message"] == "said so"
    assert "ValueError: two\nlines" in json.loads(line)["exception"]
