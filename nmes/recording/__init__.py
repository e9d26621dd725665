"""Recordings: one world's history written down as it happens, and read again."""

from __future__ import annotations

from nmes.recording.reader import Recording
from nmes.recording.recorder import Recorder
from nmes.recording.records import FORMAT, PROFILE, REFUSED_LIMIT, Kind, Record
from nmes.recording.seeking import Start
from nmes.recording.summary import Summary

__all__ = [
    "FORMAT",
    "PROFILE",
    "REFUSED_LIMIT",
    "Kind",
    "Record",
    "Recorder",
    "Recording",
    "Start",
    "Summary",
]
