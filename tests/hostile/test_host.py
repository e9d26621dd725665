"""A host among clients that mean it no good: it keeps serving the others, and keeps what was acknowledged."""

from __future__ import annotations

from pathlib import Path

from nmes.playback import replay
from nmes.protocol import parse
from nmes.recording import Kind, Recorder, Recording
from nmes.world import World

# -- recordings ------------------------------------------------------------------------------------------------------


def test_any_number_of_clients_may_come_and_go_while_a_world_is_recorded(tmp_path: Path) -> None:
    clients = 22_000  # with three channels each, as once, over the 65,535 that a file may have
    world = World({"backend": "ballistic", "mode": "lockstep"})
    world.journal = recorder = Recorder(tmp_path / "x.mcap", world)
    ping, nonsense = parse(b'{"type":"ping"}'), parse(b"nonsense")
    for number in range(1, clients + 1):
        assert world.join() == number
        world.handle(number, ping)
        world.handle(number, nonsense)
        world.leave(number)
    assert world.fault is None
    recorder.close()
    records = list(Recording(recorder.path))
    for kind in (Kind.COMMAND, Kind.REFUSED):
        assert [record.client for record in records if record.kind is kind] == list(range(1, clients + 1))
    assert {record.data for record in records if record.kind is Kind.REFUSED} == {b"nonsense"}
    assert replay(recorder.path).verdict == "reproduced"
