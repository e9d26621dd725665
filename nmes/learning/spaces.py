"""What a creature senses and does, as Gymnasium's spaces: bounds, names and units."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from gymnasium import spaces

from nmes.errors import WorldError
from nmes.genome import Genome
from nmes.genome.body import Body, Sensor

__all__ = ["of", "units"]

_PART: Final = 1.0 + 1e-9  # of what is 1 at most, up to the rounding of what it is computed from
_FAR: Final = 1e12  # farther, and faster, than anything gets before its world faults; checkers take no infinity
_SEEN: Final = ("target", "other", "food")  # what sensors tell the direction and distance of
_BOUNDS: Final = {
    "effort": (-_PART, _PART),
    "up": (-_PART, _PART),
    "touch": (0.0, 1.0),
    "hear": (-_PART, _PART),
    "camera": (0.0, _PART),
    "range": (0.0, _FAR),
    **{f"{whose}_smell": (0.0, _FAR) for whose in _SEEN},
    **{f"{whose}_direction": (-_PART, _PART) for whose in _SEEN},
    **{f"{whose}_distance": (0.0, _FAR) for whose in _SEEN},
}
_UNITS: Final = {
    "height": "m",
    "velocity": "m/s",
    "spin": "10 rad/s",
    "acceleration": "10 m/s²",
    "range": "m",
    **{f"{whose}_distance": "m" for whose in _SEEN},
    **{f"{whose}_velocity": "m/s" for whose in _SEEN},
}


def of(genome: Genome) -> tuple[spaces.Box[Any], spaces.Box[Any]]:
    """Returns the space of observations, float64 as worlds compute them, and that of actions, float32 from -1 to 1.

    Raises:
        WorldError: `invalid`: it has no motors, or no sensors, so that there is nothing to learn.
    """
    body = genome.body
    for what, parts in (("motors", body.motors), ("sensors", body.sensors)):
        if not parts:
            raise WorldError("invalid", f"{genome.name!r} has no {what}: there is nothing to learn", "genome")
    low, high = np.array([_bounds(sensor) for sensor in body.sensors]).T
    actions = len(body.outputs)
    return spaces.Box(low, high, dtype=np.float64), spaces.Box(-1.0, 1.0, (actions,), np.float32)


def _bounds(sensor: Sensor) -> tuple[float, float]:
    noisy = sensor.flaws is not None and sensor.flaws.noise > 0.0
    low, high = (-_FAR, _FAR) if noisy else _BOUNDS.get(sensor.type, (-_FAR, _FAR))
    return (min(low, 0.0), high) if sensor.flaws is not None else (low, high)


def units(genome: Genome) -> dict[str, str]:
    """Returns the unit in which each sensor reads, by its id; empty where it is a part or a direction."""
    return {sensor.id: _unit(genome.body, sensor) for sensor in genome.body.sensors}


def _unit(body: Body, sensor: Sensor) -> str:
    if sensor.of == "cube":
        return _UNITS.get(sensor.type, "")
    hinge = next(joint.kind for joint in body.joints if joint.id == sensor.target) == "hinge"
    turning = {"position": "rad", "velocity": "10 rad/s"}
    return (turning if hinge else {"position": "m", "velocity": "m/s"}).get(sensor.type, "")
