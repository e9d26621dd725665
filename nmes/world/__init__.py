"""The world: a deterministic state machine of cubes, joints, creatures, clients and frames over any engine."""

from __future__ import annotations

from nmes.world.state import Barrier, Fault
from nmes.world.world import World

__all__ = ["Barrier", "Fault", "World"]
