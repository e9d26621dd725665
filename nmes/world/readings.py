"""What a cube's sensors read, as replies have it: contacts by face, readings along the cube's own axes, pictures.

Hides how a face is told from a contact's normal, and the PNG format. It knows neither the world nor an engine.
"""

from __future__ import annotations

import base64
import struct
import zlib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from nmes.backend import Contact, Image, Quaternion, Vector
from nmes.backend.rotation import conjugate, rotate

__all__ = ["contact_list", "own_axes", "png"]


def own_axes(quaternion: Quaternion, vector: Vector) -> Vector:
    """Turns a world vector into the frame of a cube."""
    return rotate(conjugate(quaternion), vector)


def contact_list(contacts: Iterable[Contact], quaternion: Quaternion, names: Mapping[int, str]) -> list[dict[str, Any]]:
    """Returns a cube's contacts as `cube_info` has them; `names` are those of the engine's bodies."""
    faces: dict[Vector, str] = {}  # most contacts of a cube share their normal with others
    found = []
    for other, position, normal, force in contacts:
        face = faces.get(normal)
        if face is None:
            face = faces[normal] = _face(own_axes(quaternion, normal))
        found.append(
            {
                "cube_name": None if other is None else names[other],
                "face": face,
                "position": position,
                "normal": normal,
                "force": force,
            }
        )
    return found


def _face(normal: Vector) -> str:
    """Names the face that is pushed: the normal points from outside through it."""
    x, y, z = (abs(part) for part in normal)
    axis = 0 if x >= y and x >= z else 1 if y >= z else 2
    return ("-" if normal[axis] > 0.0 else "+") + "xyz"[axis]


def png(image: Image) -> str:
    """Writes a picture as a PNG file, in base64."""
    height, width, _ = image.shape
    # Each row begins with the number of its filter: none.
    rows = np.hstack([np.zeros((height, 1), np.uint8), image.reshape(height, -1)]).tobytes()
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)  # 8 bits each of red, green and blue
    parts = ((b"IHDR", header), (b"IDAT", zlib.compress(rows)), (b"IEND", b""))
    chunks = (struct.pack(">I", len(d)) + kind + d + struct.pack(">I", zlib.crc32(kind + d)) for kind, d in parts)
    return base64.b64encode(b"\x89PNG\r\n\x1a\n" + b"".join(chunks)).decode()
