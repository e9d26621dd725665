"""What crowds of cubes cost: some that move, beside others that are frozen, lie there, or move too.

Hides the scene, which is the same on every engine: a row of pairs of cubes on flat ground, the two of a pair joined by
a hinge where the engine has hinges. Those that move are pushed upwards and a little aside before they land. Pushes
are no part of the time of a tick.
"""

from __future__ import annotations

import os
import statistics
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Any, Final

from nmes.errors import SimulationFault
from nmes.measure.turns import in_turns, ratio
from nmes.variation.draw import Draw
from nmes.world import World

__all__ = ["KINDS", "CrowdCost", "WorldCost", "measure_crowd"]

KINDS: Final = ("alone", "frozen", "resting", "moving")
"""The worlds: those that move alone; with the others frozen; with the others at rest; with the others moving too."""
_SETTLE: Final = 60  # ticks before anything is measured: who lies there falls asleep, where the engine lets it
_HOP: Final = 12  # ticks between pushes, fewer than a flight takes
_UP: Final = 1.5  # N s, on a cube of 1 kg: 0.3 s of flight
_ASIDE: Final = 0.3  # N s at most
_PAIR: Final = 1.2  # m from one cube of a pair to the other
_APART: Final = 3.0  # m from pair to pair


@dataclass(frozen=True, slots=True)
class WorldCost:
    """What ticks of a world cost.

    Attributes:
        cubes: How many there are.
        milliseconds: The median of a tick, ms.
        pace: How fast the world runs at the most: seconds of its time in one of the clock's, by the median tick.
        late: The part of its ticks that took longer than a tick is to last.
        ratio: The time of a tick over that of the world in which those that move are alone; the median of all rounds.
    """

    cubes: int
    milliseconds: float
    pace: float
    late: float
    ratio: float


@dataclass(frozen=True, slots=True)
class CrowdCost:
    """What a crowd costs.

    Attributes:
        backend: The engine.
        hinges: Whether pairs are joined.
        worlds: By kind.
        asleep: How many of those that lie at rest sleep in the end, in the world in which they are not frozen.
        bytes_per_cube: By how much the process has grown, divided by the cubes of all worlds, with their joints; None
            where the system does not tell.
        digest: Of all worlds in the end, 32 hexadecimal digits: it follows from engine, numbers and seed.
    """

    backend: str
    hinges: bool
    worlds: dict[str, WorldCost]
    asleep: int
    bytes_per_cube: float | None
    digest: str


def measure_crowd(backend: str, active: int, still: int, seed: int, rounds: int) -> CrowdCost:
    """Measures what a crowd costs on an engine.

    Args:
        backend: The engine's name.
        active: How many cubes move.
        still: How many there are besides.
        seed: Of the pushes.
        rounds: How often each world is measured, for a hop each.

    Raises:
        BackendNotFound: There is no such engine.
        SimulationFault: The engine failed.
    """
    _Crowd(backend, 2, 0, "alone", seed).hop()  # what the engine loads at first is no part of what cubes take
    before = _resident()
    crowds = {kind: _Crowd(backend, active, still, kind, seed) for kind in KINDS}
    samples = in_turns({kind: crowd.hop for kind, crowd in crowds.items()}, rounds)
    after = _resident()
    cubes = sum(len(crowd.names) for crowd in crowds.values())
    grown = None if before is None or after is None else (after - before) / cubes
    worlds = {kind: _cost(crowd, ratio(samples, kind, "alone")) for kind, crowd in crowds.items()}
    digest = blake2b(b"".join(crowd.world.digest() for crowd in crowds.values()), digest_size=16).hexdigest()
    return CrowdCost(backend, crowds["alone"].hinges, worlds, crowds["resting"].asleep(), grown, digest)


class _Crowd:
    """A world with its cubes, settled.

    Attributes:
        world: The world.
        names: Of its cubes; those that move come first.
        hinges: Whether pairs are joined.
        times: What each tick of a hop took, s.
    """

    def __init__(self, backend: str, active: int, still: int, kind: str, seed: int) -> None:
        self.world = World({"mode": "lockstep", "backend": backend, "seed": seed})
        self._client, self._draw = self.world.join(), Draw(seed, "crowd", kind)
        self.hinges = "joint.hinge" in self.world.backend.capabilities
        count = active + (0 if kind == "alone" else still)
        self.names = [self._spawn(number) for number in range(count)]
        if self.hinges:
            for one, other in zip(self.names[::2], self.names[1::2], strict=False):
                self._do(type="create_joint", cube1=one, cube2=other, joint_type="hinge")
        if kind == "frozen":
            for name in self.names[active:]:
                self._do(type="freeze_cube", cube_name=name, freeze=True)
        self._moving = self.names if kind == "moving" else self.names[:active]
        self.times: list[float] = []
        for _ in range(_SETTLE // _HOP):
            self.hop()
        self.times.clear()

    def hop(self) -> float:
        """Pushes those that move, and ticks until they land; returns the mean time of a tick, s."""
        aside = [self._draw.uniform(-_ASIDE, _ASIDE) for _ in self._moving]
        for name, along in zip(self._moving, aside, strict=True):
            self._do(type="apply_physics", cube_name=name, impulse=[along, _UP, 0.0])
        for _ in range(_HOP):
            began = time.perf_counter()
            self.world.tick()
            self.times.append(time.perf_counter() - began)
        if (fault := self.world.fault) is not None:
            raise SimulationFault(fault.code, fault.message)
        return statistics.fmean(self.times[-_HOP:])

    def asleep(self) -> int:
        """Returns how many cubes sleep."""
        return sum(self._do(type="get_cube_info", cube_name=name)["sleeping"] for name in self.names)

    def _spawn(self, number: int) -> str:
        place = [_APART * (number // 2) + _PAIR * (number % 2), 0.5, 0.0]
        spawned: str = self._do(type="spawn_cube", position=place, list=False)["spawned"]
        return spawned

    def _do(self, **command: Any) -> Mapping[str, Any]:
        reply = self.world.execute(self._client, command)
        if reply["type"] == "error":
            raise SimulationFault(reply["code"], reply["message"])
        return reply


def _cost(crowd: _Crowd, ratio: float) -> WorldCost:
    tick = 1.0 / crowd.world.config["tick_rate"]
    middle = statistics.median(crowd.times)
    late = sum(each > tick for each in crowd.times) / len(crowd.times)
    return WorldCost(len(crowd.names), 1e3 * middle, tick / middle, late, ratio)


def _resident() -> int | None:
    """Returns how much memory (bytes) this process has, where the system tells."""
    if sys.platform != "linux":
        return None
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
