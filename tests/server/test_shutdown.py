"""A host that is told to stop while it is busy."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path

from nmes import Client
from nmes.errors import Disconnected
from nmes.playback import replay, world_at
from nmes.recording import Recording
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
