"""The ecosystem that ships, for as long as it is meant to run: its speed, its recording, and that it goes on."""

from __future__ import annotations

import json
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import orjson
import pytest

from nmes.recording import Recorder
from nmes.schemas.documents import ShippedDocuments
from nmes.world import World
from processes import NMES

CONFIG = orjson.loads(ShippedDocuments("world config", "nmes.world", "shipped").read("ecosystem"))
RATE = CONFIG["tick_rate"]


@dataclass
class Life:
    """How a run went: its censuses, one a minute, its last digest, and the CPU time that it took, s."""

    censuses: list[dict[str, Any]]
    digest: str
    cpu: float


def live(seconds: int, path: Path | None = None) -> Life:
    world = World({**CONFIG, "mode": "lockstep"}, emit=lambda _, event: events.append(event))
    events: list[bytes] = []
    world.execute(world.join(), {"type": "subscribe", "events": ["life"]})
    recorder = None
    if path is not None:
        recorder = world.journal = Recorder(path, world, pose_rate=2.0)
    censuses = []
    began = time.process_time()
    for _ in range(min(seconds, 60), seconds + 1, 60):
        for _ in range(min(seconds, 60) * RATE):
            world.tick()
        assert world.fault is None, world.fault
        censuses.append(orjson.loads(next(event for event in reversed(events) if b'"census"' in event)))
        events.clear()
    cpu, digest = time.process_time() - began, world.digest().hex()
    if recorder is not None:
        recorder.close()
    return Life(censuses, digest, cpu)


def replayed(path: Path, *options: str) -> str:
    """Runs a recording again in a process of its own; returns the verdict."""
    done = subprocess.run([NMES, "replay", path, "--json", *options], capture_output=True, check=False)
    verdict: str = json.loads(done.stdout)["verdict"]
    return verdict


def check_recorded(seconds: int, path: Path, frames: list[int]) -> Life:
    life = live(seconds, path)
    assert path.stat().st_size < 300e6 * seconds / 3600 + 1e6
    assert replayed(path) == "reproduced"
    assert [replayed(path, "--from", str(frame)) for frame in frames] == ["reproduced"] * len(frames)
    return life


def test_some_seconds_of_the_ecosystem_are_recorded_and_come_out_again(tmp_path: Path) -> None:
    life = check_recorded(8, tmp_path / "short.mcap", [])
    assert life.censuses[-1]["born"] > 5 and life.censuses[-1]["population"] > 30


@pytest.mark.long
@pytest.mark.timeout(20_000)
def test_an_hour_of_the_ecosystem_runs_twice_as_fast_as_real_time_and_comes_out_again(tmp_path: Path) -> None:
    life = check_recorded(3600, tmp_path / "hour.mcap", [RATE * second for second in (61, 1800, 3599)])
    assert life.cpu < 3600 / 2
    assert life.censuses[-1]["born"] > 500 and life.censuses[-1]["died"] > 500


@pytest.mark.long
@pytest.mark.timeout(60_000)
def test_a_population_lives_for_ten_hours_with_traits_that_change() -> None:
    one = live(36_000)
    counts = [census["population"] for census in one.censuses]
    assert min(counts) >= 10 and max(counts[5:]) < CONFIG["life"]["population"]["most"]
    first, last = one.censuses[0]["means"], one.censuses[-1]["means"]
    assert last["generation"] > 50 and abs(last["mass"] / first["mass"] - 1.0) > 0.05
    assert live(36_000).digest == one.digest
