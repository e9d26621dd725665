"""A world's figures over time: height, speed, work and contacts, tick by tick, for plots.

Invariant: it only looks; the code that runs the world calls `note` after each tick.
"""

from __future__ import annotations

import numpy as np

from nmes.backend import Array
from nmes.world import World

__all__ = ["TimeSeries"]


class TimeSeries:
    """The figures of a world, tick by tick; where there is no cube, they are NaN."""

    def __init__(self) -> None:
        self._rows: list[tuple[float, float, float, float]] = []
        self._touching: list[set[str]] = []
        self._names: dict[str, None] = {}

    def note(self, world: World) -> None:
        """Adds a row: the world's figures after a tick."""
        names, states = world.poses()
        height = speed = work = float("nan")
        if names:
            work = world.motor_work()
            height = float(states[:, 1].mean())
            speed = float(np.linalg.norm(states[:, 7:10].mean(axis=0)))
        self._rows.append((world.ticks / world.config["tick_rate"], height, speed, work))
        self._names.update(dict.fromkeys(names))
        touching = world.touches(names, 0)[:, 0].tolist()
        self._touching.append({name for name, flag in zip(names, touching, strict=True) if flag})

    @property
    def times(self) -> Array:
        """The ticks' times, array (n,), s; a `reset` does not set them back."""
        return self._column(0)

    def curves(self) -> dict[str, Array]:
        """Returns the curves, arrays (n,), by names that tell their units."""
        return {
            "height of the middle (m)": self._column(1),
            "speed of the middle (m/s)": self._column(2),
            "work of the motors (J)": self._column(3),
        }

    def gait(self) -> dict[str, list[tuple[float, float]]]:
        """Returns, by cube, the spans of time in which it touched something: (begin, end), s."""
        spans: dict[str, list[tuple[float, float]]] = {name: [] for name in self._names}
        before: set[str] = set()
        times = self.times.tolist()
        for time, touching in zip(times, self._touching, strict=True):
            for name in touching:
                since = spans[name].pop()[0] if name in before else time
                spans[name].append((since, time))
            before = touching
        return spans

    def _column(self, number: int) -> Array:
        return np.array(self._rows, float).reshape(-1, 4)[:, number]
