"""Short runs of several populations: carts that drive at each other for a third of a second."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from duels import DUEL, push
from nmes.evolution.run import Run
from nmes.evolution.run_settings import RunSettings

__all__ = ["DUEL_RUN", "MOMENT", "begin_duel"]

MOMENT: dict[str, Any] = {**DUEL, "name": "moment", "duration": 0.3, "settle": 0, "settle_limit": 0.5}
"""A match of a moment."""
DUEL_RUN: dict[str, Any] = {
    "format": "nmes-run/1",
    "task": MOMENT,
    "algorithm": "ga",
    "options": {"founders": 4, "population": 4, "window": 3, "era": 4, "latest": 1, "famous": 1},
    "budget": 30,
    "seed": 3,
    "populations": [{"role": "red", "starts": [push()]}, {"role": "blue", "starts": [push(3.0)]}],
}
"""The settings of a run of two populations, seven eras long."""


def begin_duel(folder: Path, **settings: Any) -> Run:
    """Makes a run of two populations that has not begun yet."""
    return Run.create(folder, RunSettings.read({**DUEL_RUN, **settings}))
