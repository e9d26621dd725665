from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from goldens import CORPUS, REPLAYS, Golden, contents, make, positions
from nmes.backend import load_backend
from nmes.backend.fingerprint import differences, fingerprint
from nmes.playback import replay
from nmes.playback.drift import measure_drift
from nmes.recording import Recording

goldens = pytest.mark.parametrize("golden", CORPUS, ids=lambda golden: golden.name)


def description(golden: Golden) -> dict[str, Any]:
    document = json.loads(golden.description.read_text())
    assert isinstance(document, dict)
    return document


def drift(golden: Golden) -> float:
    """Returns how far (m) the cubes come from where they were recorded."""
    report = measure_drift(golden.recording, golden.config["backend"])
    assert report.ended is None or description(golden)["faults"]
    assert report.refused == {}
    return max(each.distance for drifts in report.cubes.values() for each in drifts)


@goldens
def test_each_golden_is_reproduced(golden: Golden) -> None:
    report = replay(golden.recording)
    assert report.damage is None
    if report.verdict == "not_comparable":  # on a machine that computes otherwise
        assert report.differences
        assert drift(golden) <= golden.tolerance
    else:
        assert report.verdict == "reproduced", report.divergence
        assert report.ticks == description(golden)["ticks"]


@pytest.mark.parametrize("path", sorted(REPLAYS.rglob("*.mcap")), ids=lambda path: path.stem)
def test_each_recording_that_ships_was_made_with_the_library_of_the_engine(path: Path) -> None:
    """Else what comes out otherwise would be "not comparable" on every machine, and pass as such."""
    recorded = Recording(path).fingerprint
    here = fingerprint(load_backend(recorded["backend"]))
    if sys.platform != "linux" or any(recorded[name] != here[name] for name in ("architecture", "engine.version")):
        pytest.skip("this is another version of the engine, or another kind of machine")
    assert differences(recorded, here).keys() <= {"probe"}


def test_every_part_of_a_golden_with_keyframes_is_reproduced() -> None:
    (golden,) = [golden for golden in CORPUS if "keyframes" in golden.config]
    recording = Recording(golden.recording)
    keyframes, ticks = recording.summary().keyframes, description(golden)["ticks"]
    starts = set()
    for first in (*range(0, ticks, 11), ticks):
        report = replay(recording, first=first)
        assert report.frames[1] == ticks
        starts.add(report.frames[0])
        assert report.verdict == "reproduced", report.divergence
    assert len(starts) == keyframes + 1 > 6


@goldens
def test_the_json_file_of_a_golden_describes_its_recording(golden: Golden) -> None:
    document = description(golden)
    assert document == {
        "shows": golden.shows,
        **contents(golden),
        "positions_at_the_end": document["positions_at_the_end"],
    }
    assert Recording(golden.recording).config == golden.world().config


@goldens
def test_the_script_of_a_golden_gives_its_final_positions(golden: Golden) -> None:
    world = golden.world()
    golden.play(world, world.join())
    expected = description(golden)["positions_at_the_end"]
    assert list(positions(world)) == list(expected)
    for name, place in positions(world).items():
        assert place == pytest.approx(expected[name], abs=golden.tolerance)


@pytest.mark.parametrize("name", ["mujoco-edits", "mujoco-planets", "pymunk-edits", "pymunk-fault"])
def test_a_golden_on_another_machine_stays_within_its_tolerance(name: str) -> None:
    (golden,) = [golden for golden in CORPUS if golden.name == name]
    assert drift(golden) <= golden.tolerance  # as far as that can be tested here


def test_every_golden_has_its_files() -> None:
    assert len(CORPUS) >= 12
    assert {golden.config["backend"] for golden in CORPUS} == {"mujoco", "pymunk"}
    files = {path for golden in CORPUS for path in (golden.recording, golden.description)} | {REPLAYS / "README.md"}
    assert {path for path in REPLAYS.iterdir() if path.is_file()} == files
    assert all(golden.recording.stat().st_size < 160 << 10 for golden in CORPUS)


def test_a_golden_can_be_recorded_anew(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("goldens.REPLAYS", tmp_path_factory.mktemp("replays"))
    golden = next(golden for golden in CORPUS if golden.name == "pymunk-refused")
    before = json.loads((REPLAYS / golden.description.name).read_text())
    for _ in range(2):
        make(golden)
        document = description(golden)
        assert {**document, "last_digest": ""} == {**before, "last_digest": ""}
        assert replay(golden.recording).verdict == "reproduced"
