"""What ticks cost: a grid of nine cubes and twelve hinges through `World`, and replayed, beside bare `mj_step`.

The grid hops without end. The bare loop steps the very model that the world compiled, from the very states that the
world went through at the start of each hop, so that both solve the same contacts. In water nothing has weight, so that
neither side has contacts: what is compared is what the water costs.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import mean
from typing import Any

import mujoco

from measure import Figure, in_turns, ratio, summary
from nmes import World
from nmes.playback import replay
from nmes.recording import Recorder

FLIGHT = 59  # ticks from one push to the next; with the one in which the push acts, a second
HOPS = 50
ROUNDS = 20
SPACING = 1.2


class Grid:
    """Nine jointed cubes in a world, pushed upwards at the start of every hop."""

    def __init__(self, record_to: Path | None = None, **config: Any) -> None:
        """Builds the grid in a world of such a configuration, and lets it settle."""
        self.world = World({"mode": "lockstep", **config})
        self.recorder = None
        if record_to is not None:
            self.recorder = self.world.journal = Recorder(record_to, self.world)
        self.client = self.world.join()
        self.names = []
        for i in range(9):
            position = [SPACING * (i % 3 - 1), 0.5, SPACING * (i // 3 - 1)]
            self.names.append(self.execute(type="spawn_cube", position=position, list=False)["spawned"])
        for i, name in enumerate(self.names):
            if i % 3 < 2:
                self.join(name, self.names[i + 1], [0, 0, 1])
            if i // 3 < 2:
                self.join(name, self.names[i + 3], [1, 0, 0])
        self.execute(type="step", ticks=60)
        self.model = self.world.simulation.running.model  # type: ignore[attr-defined]

    def close(self) -> None:
        """Completes the recording."""
        if self.recorder is not None:
            self.recorder.close()

    def execute(self, **command: Any) -> dict[str, Any]:
        """Executes a command that must succeed."""
        reply = self.world.execute(self.client, command)
        assert reply["type"] != "error", reply
        return reply

    def join(self, cube1: str, cube2: str, axis: list[float]) -> None:
        """Joins two cubes by a hinge."""
        self.execute(type="create_joint", cube1=cube1, cube2=cube2, joint_type="hinge", axis=axis)

    def hop(self) -> mujoco.MjData:
        """Begins a hop: one tick, in which a push acts. Returns the state that it leads to."""
        for name in self.names:
            self.execute(type="apply_physics", cube_name=name, impulse=[0.0, 4.0, 0.0])
        self.world.tick()
        state = mujoco.MjData(self.model)
        mujoco.mj_copyData(state, self.model, self.world.simulation.running.data)  # type: ignore[attr-defined]
        return state

    def fly(self) -> float:
        """Ticks until the next hop; returns the seconds that a tick took."""
        tick = self.world.tick
        began = time.perf_counter()
        for _ in range(FLIGHT):
            tick()
        return (time.perf_counter() - began) / FLIGHT

    def hops(self) -> float:
        """Hops many times; returns the seconds that a tick took."""
        times = []
        for _ in range(HOPS):
            self.hop()
            times.append(self.fly())
        return mean(times)


def bare_flight(model: mujoco.MjModel, data: mujoco.MjData, start: mujoco.MjData, substeps: int) -> float:
    """Steps through the ticks of one flight with nothing around `mj_step`; returns the seconds that a tick took."""
    mujoco.mj_copyData(data, model, start)
    step = mujoco.mj_step
    began = time.perf_counter()
    for _ in range(FLIGHT):
        step(model, data, nstep=substeps)
    return (time.perf_counter() - began) / FLIGHT


def figures() -> Iterator[Figure]:
    """Measures."""
    yield from _dry()
    yield from _wet()


def _dry() -> Iterator[Figure]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "replayed.mcap"
        subject = Grid(path)
        starts = []
        for _ in range(HOPS):
            starts.append(subject.hop())
            subject.fly()
        subject.close()
        model, substeps = subject.model, subject.world.config["substeps"]
        data = mujoco.MjData(model)

        def bare() -> float:
            return mean([bare_flight(model, data, start, substeps) for start in starts])

        def replayed() -> float:
            began = time.perf_counter()
            report = replay(path)
            took = time.perf_counter() - began
            assert report.verdict == "reproduced", report
            return took / subject.world.frame

        world, recorded = Grid(), Grid(Path(folder) / "grid.mcap")
        samples = in_turns({"bare": bare, "world": world.hops, "recorded": recorded.hops, "replay": replayed}, ROUNDS)
        recorded.close()
    times = {"microseconds a tick": summary(samples, 1e-6), "substeps": substeps}
    name = "grid: tick of World / mj_step"
    yield Figure(name, ratio(samples, "world", "bare"), "x", at_most=1.25, details=times)
    yield Figure("grid: recorded tick / mj_step", ratio(samples, "recorded", "bare"), "x", details=times)
    name = "grid: speed of replay / mj_step"
    yield Figure(name, ratio(samples, "bare", "replay"), "x", at_least=0.5, details=times)


def _wet() -> Iterator[Figure]:
    wet = Grid(gravity=[0, 0, 0], medium={"level": 1e5})
    starts = [wet.hop() for _ in range(HOPS)]
    model, substeps = wet.model, wet.world.config["substeps"]
    data = mujoco.MjData(model)

    def bare() -> float:
        return mean([bare_flight(model, data, start, substeps) for start in starts])

    samples = in_turns({"bare": bare, "world": wet.hops}, ROUNDS)
    times = {"microseconds a tick": summary(samples, 1e-6), "substeps": substeps}
    yield Figure(
        "grid in water with a level: tick of World / mj_step", ratio(samples, "world", "bare"), "x", details=times
    )
