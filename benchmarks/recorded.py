"""What recordings cost: time in a tick, room on a disk, and time to check one.

The world is one of 150 cubes that fly and spin on courses of their own, ticking 60 times a second, and a client turns
one of them once a second, or ten times. Its recording is flushed once a second of simulation, as a world in real time
would be. A minute of it is measured; an hour is sixty of them. Only for the seek an hour is recorded, at ten ticks a
second: with as many keyframes, poses and flushes as at sixty, it is as large and has as many places to look at.
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
from nmes.playback import make_world
from nmes.recording import Recorder, Recording

CUBES = 150
RATE = 60
BUDGET = 1 / RATE  # s: what a tick may take in real time
MINUTE = 60 * RATE
ROUNDS = 12


class Swarm:
    """The world, recorded or not."""

    def __init__(
        self,
        record_to: Path | None = None,
        pose_rate: float = 10.0,
        pushes: int = 1,
        *,
        rate: int = RATE,
        cubes: int = CUBES,
        keyframes: float | None = None,
    ) -> None:
        """Spawns the cubes; there are to be so many pushes a second."""
        self._rate = rate
        self._push_every = rate // pushes
        self._rng = rng = random.Random(1)
        # As a host is: a keyframe every ten seconds. Without poses, inputs and digests alone.
        keyframes = (10 if pose_rate else 0) if keyframes is None else keyframes
        self.world = World({"mode": "lockstep", "gravity": [0, 0, 0], "tick_rate": rate, "keyframes": keyframes})
        self.recorder = None
        if record_to is not None:
            self.recorder = self.world.journal = Recorder(record_to, self.world, pose_rate=pose_rate)
        self._client = self.world.join()
        self._names = []
        for i in range(cubes):
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
            if self.recorder is not None and self.world.frame % self._rate == 0:
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


def hour(path: Path, pose_rate: float, pushes: int = 1, keyframes: float | None = None) -> float:
    """Records a minute; returns what an hour would take up (MB)."""
    swarm = Swarm(path, pose_rate, pushes, keyframes=keyframes)
    assert swarm.recorder is not None
    swarm.fly(RATE)
    begun = path.stat().st_size
    swarm.fly(MINUTE)
    size = path.stat().st_size
    swarm.close()
    return (begun + 60 * (size - begun)) / 1e6


def seeking(path: Path) -> list[float]:
    """Goes to the middle of an hour; returns how long that took (s): a few times at its keyframe."""
    rate, took = 10, []
    swarm = Swarm(path, rate=rate)
    swarm.fly(3600 * rate)
    swarm.close()
    for _ in range(5):
        began = time.perf_counter()
        recording = Recording(path)
        start = recording.start(1800 * rate + rate)
        world = make_world(recording, start)
        took.append(time.perf_counter() - began)
        assert world.ticks == start.frame == 1800 * rate
        world.close()
    return took


def keeping(path: Path, cubes: int) -> list[float]:
    """How much longer (s) ticks take on which the world saves itself than those before them."""
    every, more = 10, []
    swarm = Swarm(path, cubes=cubes, keyframes=every / RATE)
    for _ in range(ROUNDS):
        swarm.fly(every - 2)
        usual = swarm.fly(1)
        more.append(swarm.fly(1) - usual)
    assert swarm.world.ticks % every == 0
    swarm.close()
    return more


def verifying(path: Path) -> float:
    """Checks a recording; returns how fast that was (MB/s of the file)."""
    recording = Recording(path)
    began = time.perf_counter()
    assert recording.complete
    return recording.size / (time.perf_counter() - began) / 1e6


def figures() -> Iterator[Figure]:
    """Measures recording and reading."""
    with tempfile.TemporaryDirectory() as folder:
        names = ("live", "with", "without", "pushed", "saved", "hour", "150", "1000")
        files = {name: Path(folder) / f"{name}.mcap" for name in names}
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
        yield Figure("an hour of keyframes, every 10 s", hour(files["saved"], 0.0, 1, 10) - without, "MB")
        each = (hour(files["pushed"], 0.0, 10) - without) * 1e6 / (9 * 3600)
        yield Figure("a command and its reply more", each, "bytes")
        for name in ("with", "without"):
            speeds = [verifying(files[name]) for _ in range(9)]
            yield Figure(f"verifying it, {name} poses", median(speeds), "MB/s", at_least=100, details={"all": speeds})
        for cubes in (150, 1000):
            more = [1e3 * took for took in keeping(files[str(cubes)], cubes)]
            yield Figure(
                f"a keyframe of {cubes} moving cubes, in the tick it falls on",
                median(more),
                "ms",
                details={"all": more},
            )
        took = seeking(files["hour"])
        yield Figure("going to the middle of an hour", median(took), "s", at_most=1, details={"all": took})
