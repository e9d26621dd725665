"""What a lab marks on the time line of a recording."""

from __future__ import annotations

from pathlib import Path

from ecosystems import config
from nmes.lab.recordings import about_recording
from nmes.recording import Kind, Recorder, Recording
from nmes.world import World


def test_births_and_deaths_of_an_ecosystem_are_marks(tmp_path: Path) -> None:
    world = World(config(death={"age": 3}))
    recorder = world.journal = Recorder(path := tmp_path / "pond.mcap", world)
    for _ in range(100):
        world.tick()
    recorder.close()
    kinds = {"creature_born": "birth", "creature_died": "death"}
    events = [event for r in Recording(path) if r.kind is Kind.LIFE and r.about for event in r.about["events"]]
    expected = [(e["frame"], kinds[e["type"]], e["creature"]) for e in events if e["type"] in kinds]
    assert {kind for _, kind, _ in expected} == {"birth", "death"}
    marks = [mark for mark in about_recording(path)["marks"] if mark["kind"] in kinds.values()]
    assert [(mark["frame"], mark["kind"], mark["what"]) for mark in marks] == expected
