"""The ecosystem that ships: it lives with nobody there, clients take part, and its recording comes out again."""

from __future__ import annotations

import signal
from pathlib import Path

from ecosystems import config, run
from nmes import Client, World
from nmes.genome import Genome
from nmes.playback import replay
from nmes.recording import Kind, Recording
from nmes.server.world_recorder import Origin, WorldRecorder
from processes import process, ready
from servers import PASSWORD, PATIENCE


def test_a_served_ecosystem_lives_by_itself_and_clients_take_part(tmp_path: Path) -> None:
    arguments = ["--config", "ecosystem", "--mode", "fast", "--keyframes", "1", "--record", str(tmp_path)]
    with process("serve", "--json", "--port", "0", *arguments, NMES_PASSWORD=PASSWORD) as server:
        info = ready(server)
        with Client(port=info["port"], password=PASSWORD) as client:
            client.subscribe(events=["life"])
            assert any(event["type"] == "food_eaten" for event in client.events(timeout=PATIENCE))
            life = client.get_life()
            assert len(life["living"]) >= 30 and life["frame"] > 0 and len(life["food"]) > 50
            genome = client.get_genome(life["living"][-1]["creature"])["genome"]
            assert Genome(genome).brain().inputs
            client.feed([0, 0, 0], energy=1)
            client.spawn_creature(genome, name="guest", position=[60, 0, 60], autonomous=True)
            client.pause()
            assert client.get_life()["frame"] > life["frame"]
        server.send_signal(signal.SIGINT)
        _, err = server.communicate(timeout=PATIENCE)
    assert (server.returncode, "Traceback" in err) == (0, False), err
    recording = Recording(info["recording"])
    lines = [record.about for record in recording if record.kind is Kind.LIFE]
    assert lines[0] is not None and [event["cause"] for event in lines[0]["events"][:30]] == ["founder"] * 30
    assert replay(recording).verdict == "reproduced"
    assert replay(recording, first=recording.summary().ticks).verdict == "reproduced"


def test_a_recording_that_goes_on_has_poses_as_often_as_its_parent(tmp_path: Path) -> None:
    counts, origin = [], None
    for _ in range(2):
        world = World(config())
        recorder = WorldRecorder(world, tmp_path, 1.0, origin)
        first = world.frame
        run(world, 80)
        recorder.close()
        world.close()
        origin = Origin.end(recorder.path)
        assert world.frame - first == 80
        counts.append(sum(record.kind is Kind.POSES for record in origin.recording))
    assert counts == [8, 8]  # twice a second, of 20 ticks


def test_a_config_that_is_neither_a_file_nor_shipped_is_refused() -> None:
    with process("serve", "--config", "ecosystm", "--port", "0", NMES_PASSWORD=PASSWORD) as server:
        _, err = server.communicate(timeout=PATIENCE)
    assert server.returncode == 2 and "no world config 'ecosystm'" in err and "ecosystem" in err
