"""Recordings: one world's history written down as it happens, and read again."""

from __future__ import annotations

from nmes.recording.reader import (
    FORMAT,
    PROFILE,
    REFUSED_LIMIT,
    Kind,
    Record,
    Recorder,
    Recording,
    Start,
    Summary,
)

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
