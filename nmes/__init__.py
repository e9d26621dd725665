"""NMES, the Neural Morphogenetic Evolution System: deterministic worlds driven over TCP, recorded and reproduced."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nmes.client import AsyncClient, Client
    from nmes.world import World

__all__ = ["AsyncClient", "Client", "World"]

_HOMES = {"AsyncClient": "nmes.client", "Client": "nmes.client", "World": "nmes.world"}


def __getattr__(name: str) -> Any:
    # Loaded when first used, so that `import nmes`, and with it `nmes --help`, costs nothing.
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
