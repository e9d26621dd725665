"""What being looked at costs a world: a thousand cubes that all move, with a viewer's subscription and without.

What the viewer does with it is its own process's business; a world's tick is slowed by finding out what moved, and by
writing it down for the socket.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

from measure import Figure, in_turns, ratio, summary
from nmes import World
from nmes.view.live import SHIFT, TURN

CUBES = 1000
TICKS = 20
ROUNDS = 10
EVERY = 2  # ticks: 30 Hz of 60


class Swarm:
    """Cubes that all move for as long as they are timed: hopping about on the ground, or flying in empty space."""

    def __init__(self, *, ground: bool, watched: bool) -> None:
        self.events = self.bytes = 0
        gravity = [0.0, -9.81, 0.0] if ground else [0.0, 0.0, 0.0]
        self.world = World({"mode": "lockstep", "gravity": gravity}, emit=self._emit)
        self.client = self.world.join()
        self.names = []
        for i in range(CUBES):
            place = [3.0 * (i % 32), 0.5 if ground else 50.0, 3.0 * (i // 32)]
            self.names.append(self.execute(type="spawn_cube", position=place, list=False)["spawned"])
        self.execute(type="step", ticks=2)
        if watched:
            wish = {"every": EVERY, "position_threshold": SHIFT, "rotation_threshold": TURN}
            self.execute(type="subscribe", events=["state"], **wish)

    def execute(self, **command: Any) -> dict[str, Any]:
        """Executes a command that must succeed."""
        reply = self.world.execute(self.client, command)
        assert reply["type"] != "error", reply
        return reply

    def _emit(self, client: int, event: bytes) -> None:
        self.events += 1
        self.bytes += len(event)

    def ticks(self) -> float:
        """Pushes all cubes, and ticks; returns the seconds that a tick took."""
        for i, name in enumerate(self.names):
            push = [1.5 * (-1) ** i, 1.0, 0.5]
            self.execute(type="apply_physics", cube_name=name, impulse=push, angular_impulse=[0.0, 0.1, 0.1])
        self.world.tick()
        self.world.tick()
        began = time.perf_counter()
        for _ in range(TICKS):
            self.world.tick()
        return (time.perf_counter() - began) / TICKS


def figures() -> Iterator[Figure]:
    """Measures."""
    # Cubes that touch nothing are the least work that there is: the same event weighs most there.
    for where, ground in (("on the ground", True), ("in empty space", False)):
        alone, watched = (Swarm(ground=ground, watched=seen) for seen in (False, True))
        samples = in_turns({"alone": alone.ticks, "watched": watched.ticks}, ROUNDS)
        each = watched.bytes / watched.events
        assert watched.events >= ROUNDS * TICKS // EVERY and each > 300 * CUBES, "not all moved"
        details = {"microseconds a tick": summary(samples, 1e-6), "bytes an event": each}
        name = f"tick of {CUBES:,} cubes moving {where}: seen / not"
        yield Figure(name, ratio(samples, "watched", "alone"), "x", at_most=1.1, details=details)
