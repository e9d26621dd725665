"""What recordings cost: time in a tick, room on a disk, and time to check one.

The world is one of 150 cubes that fly and spin on courses of their own, ticking 60 times a second, and a client turns
one of them once a second, or ten times. Its recording is flushed once a second of simulation, as a world in real time
would be. A minute of it is measured; an hour is sixty of them.
"""

from __future__ import annotations

import random
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median

from measure import Figure, in_turns, summary
from nmes import World
from nmes.recording import Recorder, Recording

CUBES = 150
RATE = 60
BUDGET = 1 / RATE  # s: what a tick may take in real time
MINUTE = 60 * RATE
ROUNDS = 12


class Swarm:
    """The world, recorded or not."""

    def __init__(self, record_to: Path | None = None, pose_rate: float = 10.0, pushes: int = 1) -> None:
        """Spawns the cubes; there are to be so many pushes a second."""
        self._push_every = RATE // pushes
        self._rng = rng = random.Random(1)
        # As a host is: a keyframe every ten seconds. Without poses, inputs and digests alone.
        keyframes = 10 if pose_rate else 0
        self.world = World({"mode": "lockstep", "gravity": [0, 0, 0], "tick_rate": RATE, "keyframes": keyframes})
        self.recorder = None
        if record_to is not None:
            self.recorder = self.world.journal = Recorder(record_to, self.world, pose_rate=pose_rate)
        self._client = self.world.join()
        self._names = []
        for i in range(CUBES):
            answer = self.world.execute(
                self._client,
                {
                    "type": "spawn_cube",
                    "position": [20.0 * (i % 10), 30.0 + 20.0 * (i // 100), 20.0 * (i // 10 % 10)],
                    "linear_velocity": [rng.uniform(-0.1, 0.1) for _ in range(3)],
                    "angular_velocity": [rng.uniform(-1, 1) for _ in range(3)],
                },
            )
            self._names.append(answer["spawned"])

    def fly(self, ticks: int) -> float:
        """Ticks, with the pushes; returns how long that took (s)."""
        began = time.perf_counter()
        for _ in range(ticks):
            if self.world.frame % self._push_every == 0:
                push = {"cube_name": self._rng.choice(self._names), "torque": [self._rng.gauss(0, 0.1) for _ in "xyz"]}
                self.world.execute(self._client, {"type": "apply_physics", **push})
            self.world.tick()
            if self.recorder is not None and self.world.frame % RATE == 0:
                self.recorder.flush()
        return time.perf_counter() - began

    def second(self) -> float:
        """Flies for a second; returns what a tick took (s)."""
        return self.fly(RATE) / RATE

    def close(self) -> None:
        """Completes the recording."""
        if self.recorder is not None:
            self.recorder.close()
        self.world.close()


def hour(path: Path, pose_rate: float, pushes: int = 1) -> float:
    """Records a minute; returns what an hour would take up (MB)."""
    swarm = Swarm(path, pose_rate, pushes)
    assert swarm.recorder is not None
    swarm.fly(RATE)
    begun = path.stat().st_size
    swarm.fly(MINUTE)
    size = path.stat().st_size
    swarm.close()
    return (begun + 60 * (size - begun)) / 1e6


def verifying(path: Path) -> float:
    """Checks a recording; returns how fast that was (MB/s of the file)."""
    recording = Recording(path)
    began = time.perf_counter()
    assert recording.complete
    return recording.size / (time.perf_counter() - began) / 1e6


def figures() -> Iterator[Figure]:
    """Measures recording and reading."""
    with tempfile.TemporaryDirectory() as folder:
        files = {name: Path(folder) / f"{name}.mcap" for name in ("live", "with", "without", "pushed")}
        swarms = {"bare": Swarm(pushes=10), "recorded": Swarm(files["live"], pushes=10)}
        samples = in_turns({name: swarm.second for name, swarm in swarms.items()}, ROUNDS)
        for swarm in swarms.values():
            swarm.close()
        cost = median(a - b for a, b in zip(samples["recorded"], samples["bare"], strict=True))
        yield Figure(
            f"recording {CUBES} moving cubes, of the budget of a tick at {RATE} Hz",
            100 * cost / BUDGET,
            "%",
            at_most=5,
            details={"tick [us]": summary(samples, 1e-6)},
        )
        yield Figure("an hour of it, with poses at 10 Hz and keyframes", hour(files["with"], 10.0), "MB", at_most=250)
        without = hour(files["without"], 0.0)
        yield Figure("an hour of it, inputs and digests alone", without, "MB", at_most=10)
        each = (hour(files["pushed"], 0.0, 10) - without) * 1e6 / (9 * 3600)
        yield Figure("a command and its reply more", each, "bytes")
        for name in ("with", "without"):
            speeds = [verifying(files[name]) for _ in range(5)]
            yield Figure(f"verifying it, {name} poses", median(speeds), "MB/s", at_least=100, details={"all": speeds})
