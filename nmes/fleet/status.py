"""How the hosts of a fleet fare: each is asked for its list of worlds, side by side, and none for longer than a while.

A host that does not answer, or whose answer is none, is no failure of the others: it is told with the reason.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any, NamedTuple

from nmes.client import AsyncClient
from nmes.errors import NmesError, RejectedMessage
from nmes.protocol import validate_reply

__all__ = ["HostStatus", "ask_hosts"]

AT_ONCE = 64  # hosts that are asked at the same time
PART = 1000  # worlds that are judged at once: so many a message may list


class HostStatus(NamedTuple):
    """How a host fares.

    Attributes:
        host: Its address.
        port: Its port.
        error: Why it is not known how it fares; None: it is.
        worlds: The number of its worlds.
        awake: Those that are live and do not hibernate.
        asleep: Those that hibernate; nobody has used the others yet.
        clients: The clients in all worlds.
        lagging: The worlds that fall behind the clock.
        ratio: How fast the slowest of these runs, as a part of the pace asked for; 1 where all keep up.
        faulted: The names of the worlds that a fault has stopped.
    """

    host: str
    port: int
    error: str | None = None
    worlds: int = 0
    awake: int = 0
    asleep: int = 0
    clients: int = 0
    lagging: int = 0
    ratio: float = 1.0
    faulted: Sequence[str] = ()


async def ask_hosts(clients: Sequence[AsyncClient], timeout: float) -> list[HostStatus]:
    """Returns how hosts fare, in their order; of each it is known after `timeout` s, counted from when it is asked."""
    places = asyncio.Semaphore(AT_ONCE)

    async def ask(client: AsyncClient) -> HostStatus:
        try:
            async with places, asyncio.timeout(timeout):
                worlds: list[Any] = list(await client.worlds())
            for start in range(0, len(worlds), PART):
                validate_reply({"type": "world_list", "worlds": worlds[start : start + PART]})
        except TimeoutError:
            return HostStatus(client.host, client.port, f"no answer within {timeout:g} s")
        except RejectedMessage as error:
            return HostStatus(client.host, client.port, f"this is no NMES server: {error.message}")
        except NmesError as error:
            return HostStatus(client.host, client.port, error.message)
        return _status(client, worlds)

    return list(await asyncio.gather(*map(ask, clients)))


def _status(client: AsyncClient, worlds: Sequence[Any]) -> HostStatus:
    ratios = [world["ratio"] for world in worlds if world.get("ratio") is not None]  # older servers do not tell
    asleep = [world for world in worlds if world.get("asleep")]
    used = [world for world in worlds if world["frame"] is not None]
    return HostStatus(
        client.host,
        client.port,
        None,
        len(worlds),
        len([world for world in used if not world.get("asleep")]),
        len(asleep),
        sum(world["clients"] for world in worlds),
        len(ratios),
        min(ratios, default=1.0),
        [world["world"] for world in worlds if world["fault"]],
    )
