"""The law of falling, and the tolerances: for cases that watch cubes move."""

from __future__ import annotations

import math

from nmes.conformance.trial import Trial
from nmes.conformance.wire import Message

__all__ = ["GIVE", "STEPS", "STILL", "TIME", "G", "fallen"]

G = 9.81
TIME = ("time",)
STEPS = ("stepping", "step")
STILL = 0.05  # m/s or rad/s below which a cube is called still
GIVE = 0.05  # m by which a cube may sink, hover, or hang off its joint


def fallen(t: Trial, info: Message, height: float, least: float) -> None:
    """Makes sure that a cube which fell from rest at that height by at least `least` has the velocity for it."""
    drop = height - info["position"][1]
    t.true(drop > least, f"a cube that fell by more than {least} m", f"{drop:.3f} m")
    speed = math.sqrt(2 * G * drop)
    t.close(info["linear_velocity"][1], -speed, 0.08 * speed + 0.1, f"velocity after falling {drop:.3f} m")
