"""The head that all reports of a history run again share, and what it means that one comes out otherwise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

from nmes.backend import load_backend
from nmes.backend.fingerprint import differences, fingerprint
from nmes.errors import BackendNotFound, RecordingError
from nmes.recording import Recording

__all__ = ["RunReport", "departure", "fingerprint_differences"]


@dataclass(slots=True)
class RunReport:
    """Base of the reports: how much was run again, and how it came out.

    Attributes:
        verdict: The result in a word; each report names its own.
        commands: How many frames of clients were executed; where they are compared, were answered the same.
        ticks: How many ticks the world made; where they are compared, came out the same.
        wall_seconds: How long it took, s.
        differences: How the two sides were set up differently: an item's name, with its value when recorded and its
            value in this run.
        damage: Why the recording ends early, if it does. A log has none: a line of it that cannot be read is an error.
    """

    verdict: str
    commands: int = 0
    ticks: int = 0
    wall_seconds: float = 0.0
    differences: dict[str, tuple[Any, Any]] = field(default_factory=dict)
    damage: str | None = None

    def to_json(self) -> dict[str, Any]:
        """Makes a dict of it for JSON, with a key for each attribute."""
        return {each.name: _plain(getattr(self, each.name)) for each in fields(self)}


def _plain(value: Any) -> Any:
    """Makes plain data of an attribute: of parts that have a form of their own (`to_json`, named tuples) just that."""
    if hasattr(value, "to_json"):
        return value.to_json()
    if is_dataclass(value):
        return {each.name: _plain(getattr(value, each.name)) for each in fields(value)}
    if hasattr(value, "_asdict"):
        return value._asdict()
    if isinstance(value, dict):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    return value


def fingerprint_differences(backend: str, recorded: Mapping[str, str]) -> dict[str, tuple[Any, Any]]:
    """Compares a recorded fingerprint with this machine's for an engine.

    Args:
        backend: The name of the engine.
        recorded: The recorded fingerprint.

    Returns:
        The decisive items that differ: recorded, here. An engine that is not installed is one.
    """
    try:
        here = fingerprint(load_backend(backend))
    except BackendNotFound:
        return {"backend": (backend, "not installed")}
    return dict(differences(recorded, here))


def departure(recording: Recording, message: str) -> RecordingError:
    """Returns the error for a recording that does not come out as recorded: `diverged`, or `not_comparable`.

    Args:
        recording: The recording.
        message: Where it departs from what was recorded.
    """
    differences = fingerprint_differences(recording.config["backend"], recording.fingerprint)
    if not differences:
        return RecordingError("diverged", message)
    pairs = ", ".join(f"{name} {was or 'none'} (here {here or 'none'})" for name, (was, here) in differences.items())
    return RecordingError("not_comparable", f"{message}; it was recorded with another {pairs}")
