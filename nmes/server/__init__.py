"""Serving worlds over TCP."""

from __future__ import annotations

from nmes.server.host import Host

__all__ = ["Host"]
