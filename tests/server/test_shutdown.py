"""A host that is told to stop while it is busy."""

from __future__ import annotations

import asyncio
import json
import signal
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from nmes import Client
from nmes.errors import Disconnected
from nmes.fleet.supervisor import Supervisor
from nmes.fleet.worker_processes import WorkerProcesses
from nmes.playback import replay, world_at
from nmes.protocol import DELIMITER
from nmes.recording import Recording
from nmes.server import Host
from nmes.server.hosted_world import HostedWorld
from nmes.server.keys import Keys
from processes import process, ready
from servers import PASSWORD, PATIENCE, Peer, types


def test_sigterm_under_load_completes_recordings(
    tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    options = ["--worlds", "3", "--port", "0", "--backend", "ballistic", "--mode", "fast", "--record", str(tmp_path)]
    with process("serve", "--json", *options, NMES_PASSWORD=PASSWORD) as server:
        ports = [world["port"] for world in ready(server)["worlds"]]
        auth = {"type": "auth", "password": PASSWORD}
        watchers, deaf = [Peer(port) for port in ports], Peer(ports[0], receive_buffer=4096)
        for peer in (*watchers, deaf):
            assert peer.ask(auth)["type"] == "auth_success"
        for watcher in watchers:
            watcher.ask({"type": "subscribe", "events": ["tick"], "every": 1000})
        deaf.say(*[{"type": "get_world_info"}] * 5000)

        def flood(port: int) -> None:
            try:
                with Client(port=port, password=PASSWORD, timeout=PATIENCE) as client:
                    client.spawn_cube()
                    while True:
                        with client.pipeline() as many:
                            for _ in range(100):
                                many.apply_force(force=[0, 1, 0])
                                many.get_cube_state()
            except Disconnected:
                pass

        floods = [threading.Thread(target=flood, args=(port,)) for port in ports * 2]
        for thread in floods:
            thread.start()
        heard = [watcher.hear()["type"] for watcher in watchers]  # all are under way
        assert heard == ["tick"] * 3
        time.sleep(0.3)

        began = time.monotonic()
        server.send_signal(signal.SIGTERM)
        last = [types(watcher.rest())[-1] for watcher in watchers]
        assert server.wait(PATIENCE) == 0, server.communicate()
        took = time.monotonic() - began
        for thread in floods:
            thread.join(PATIENCE)
        for peer in (*watchers, deaf):
            peer.socket.close()
    assert last == ["world_closed"] * 3
    record_property("from SIGTERM to the end, under load", f"{took:.2f} s")
    assert took < 5.0
    recordings = [Recording(path) for path in tmp_path.iterdir()]
    assert len(recordings) == 3
    assert all(recording.complete for recording in recordings)
    smallest = min(recordings, key=lambda recording: recording.size)
    assert replay(smallest).verdict == "reproduced"


@pytest.mark.parametrize("asks", [{"world": "blue"}, {"create": {"world": "green"}}], ids=["enter", "create"])
@pytest.mark.parametrize("shared", [False, True], ids=["one process", "workers"])
async def test_a_host_that_closes_opens_no_world_for_who_is_at_the_door(
    asks: Mapping[str, Any], shared: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    closing = WorkerProcesses if shared else HostedWorld
    close, held = closing.close, asyncio.Event()

    async def hold(self: Any) -> Any:
        await held.wait()
        return await close(self)

    monkeypatch.setattr(closing, "close", hold)
    host: Host | Supervisor = Host(PASSWORD, record_to=tmp_path)
    if shared:
        host = Supervisor(Keys(PASSWORD, {}, {}), ["no program"], record_to=tmp_path, address="127.0.0.1")
    for name in ("red", "blue"):
        host.offer({"backend": "ballistic", "name": name})
    if isinstance(host, Host):
        await host.open("red")
    _, port = await host.listen("127.0.0.1", 0)
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    async with asyncio.timeout(PATIENCE):
        while not host.connections:
            await asyncio.sleep(0.01)
        ending = asyncio.create_task(host.close())
        await asyncio.sleep(0)
        writer.write(json.dumps({"type": "auth", "password": PASSWORD, **asks}).encode() + DELIMITER)
        answer = json.loads((await reader.readuntil(DELIMITER)).removesuffix(DELIMITER))
        held.set()
        await ending
    writer.close()
    assert answer["code"] == "host_draining"
    assert [path.name.partition("-")[0] for path in tmp_path.iterdir()] == ([] if shared else ["red"])


def test_sigterm_ends_a_long_step(tmp_path: Path) -> None:
    options = ["--port", "0", "--mode", "lockstep", "--record", str(tmp_path)]
    with process("serve", "--json", *options, NMES_PASSWORD=PASSWORD) as server:
        info = ready(server)
        with Peer(info["port"]) as peer:
            assert peer.ask({"type": "auth", "password": PASSWORD})["type"] == "auth_success"
            places = [[1.2 * (n % 20), 1 + n // 20, 0.7 * (n // 20)] for n in range(200)]
            peer.ask({"type": "batch", "commands": [{"type": "spawn_cube", "position": place} for place in places]})
            peer.ask({"type": "subscribe", "events": ["tick"]})
            peer.say({"type": "step", "ticks": 10_000})  # for half a minute
            assert peer.hear()["frame"] == 1
            began = time.monotonic()
            server.send_signal(signal.SIGTERM)
            assert types(peer.rest())[-1] == "world_closed"
        assert server.wait(PATIENCE) == 0, server.communicate()
        assert time.monotonic() - began < 5.0
    recording = Recording(info["recording"])
    assert recording.complete
    ticks = recording.summary().ticks
    assert 0 < ticks < 10_000
    # Whoever goes on from there does so at the tick at which it ended.
    report = replay(recording)
    assert (report.verdict, report.frames) == ("reproduced", (0, ticks))
    world = world_at(recording)
    assert world.ticks == ticks
    world.close()
