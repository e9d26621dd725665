"""A recorded history run again: compared, watched, forked, run on another engine, played to another server."""

from __future__ import annotations

from nmes.playback.divergence import Difference, Divergence
from nmes.playback.recording_replay import ReplayReport, replay
from nmes.playback.restore import make_world, restore_into, world_at
from nmes.playback.watch import States, states, watch

__all__ = [
    "Difference",
    "Divergence",
    "ReplayReport",
    "States",
    "make_world",
    "replay",
    "restore_into",
    "states",
    "watch",
    "world_at",
]
