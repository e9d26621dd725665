"""Where the signature of a recording lies, so that whoever would replace one that is signed can be stopped."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

from nmes.errors import RecordingError

__all__ = ["SUFFIX", "require_unsigned", "signature_of"]

SUFFIX: Final = ".sig"
"""What a signature's file has in its name beyond the recording's."""


def signature_of(recording: Path) -> Path:
    """Returns the path of a recording's signature, whether there is one or not."""
    return recording.with_name(recording.name + SUFFIX)


def require_unsigned(recording: Path) -> None:
    """Refuses to replace a recording that is signed: only who has the key could sign the new one.

    Raises:
        RecordingError: There is a signature of it (`signed`).
    """
    signature = signature_of(recording)
    if os.path.lexists(signature):
        what = f"{recording} is signed ({signature.name} lies beside it) and is not replaced"
        raise RecordingError("signed", f"{what}: write to another folder, or move both away")
