"""Lines of JSON that are kept to go on from, each with a digest of itself.

It guards against accidents: a disk that fails, an editor, a line that was mended by hand. Whoever wants to deceive
computes the digest anew; what convinces a stranger are recordings.
"""

from __future__ import annotations

from hashlib import sha256
from typing import Any, Final

import orjson

from nmes.schemas.documents import JsonObject

__all__ = ["ChangedLine", "sealed", "unsealed"]

_SEAL: Final = b',"digest":"%s"}'
_DIGITS: Final = 32
_LENGTH: Final = len(_SEAL) - len(b"%s") + _DIGITS


class ChangedLine(ValueError):
    """A line that is not as it was written."""


def sealed(fields: JsonObject) -> bytes:
    """Returns the line of an object, which has a digest of all else at its end."""
    text = orjson.dumps(fields)
    return text[:-1] + _SEAL % _digest(text) + b"\n"


def unsealed(line: bytes) -> JsonObject:
    """Returns the object of a line, with or without its line feed.

    Raises:
        ChangedLine: It has the digest of something else.
        ValueError: It is no object in JSON that has a digest.
    """
    line = line.rstrip(b"\n")
    fields: Any = orjson.loads(line)
    if not isinstance(fields, dict) or "digest" not in fields:
        raise ValueError("it is no object that has a digest")
    text = line[:-_LENGTH] + b"}"
    if line != text[:-1] + _SEAL % _digest(text):
        raise ChangedLine("it does not have the digest of what it says")
    del fields["digest"]
    return fields


def _digest(text: bytes) -> bytes:
    return sha256(text).hexdigest()[:_DIGITS].encode()
