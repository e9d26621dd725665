"""The protocol from the other side: clients of a world, blocking and awaiting."""

from __future__ import annotations

from nmes.client.async_client import AsyncClient
from nmes.client.client import Client

__all__ = ["AsyncClient", "Client"]
