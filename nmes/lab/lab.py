"""A lab: its folder, its host, what the folder holds, and the commands that it has started."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from typing import Any, Final, TypeVar

from nmes.lab.folder import Folder
from nmes.lab.index import Index
from nmes.lab.jobs import Jobs
from nmes.schemas.documents import ShippedDocuments, parse_document
from nmes.server import Host
from nmes.server.catalog import DEFAULT, Catalog

__all__ = ["KEYFRAMES", "Lab", "open_lab"]

_THREADS: Final = 2  # that answer what takes a while
KEYFRAMES: Final = {"keyframes": 10.0}
"""Of the config of each world of a lab, s: so that recordings can be scrubbed."""
_WORLDS: Final = ShippedDocuments("world config", "nmes.world", "shipped")

T = TypeVar("T")


class Lab:
    """What the pages of a lab are about.

    Attributes:
        folder: Where it keeps things.
        host: Its worlds.
        port: The host's, for clients over TCP.
        templates: What worlds can be created from.
        index: The lists of the folder.
        jobs: The commands that it has started.
    """

    def __init__(self, folder: Folder, host: Host, templates: list[str], most_jobs: int) -> None:
        """Makes a lab.

        Args:
            folder: Where it keeps things.
            host: Its worlds.
            templates: What worlds can be created from.
            most_jobs: How many commands may run at once.
        """
        self.folder, self.host, self.templates = folder, host, templates
        self.port = 0
        self.index = Index(folder)
        self.jobs = Jobs(most_jobs)
        self._threads = ThreadPoolExecutor(_THREADS, "nmes-lab")

    async def do(self, work: Callable[..., T], *arguments: Any) -> T:
        """Does in a thread what takes a while."""
        return await asyncio.get_running_loop().run_in_executor(self._threads, work, *arguments)

    async def close(self) -> None:
        """Ends all work for pages; no page may be open any more."""
        await self.index.close()
        await asyncio.to_thread(self._threads.shutdown)


@asynccontextmanager
async def open_lab(folder: Folder, password: str, most_jobs: int) -> AsyncIterator[Lab]:
    """Opens a lab with one world, `main`; when it is closed, its commands are interrupted first, then its worlds end.

    Args:
        folder: Where it keeps things.
        password: What opens its worlds.
        most_jobs: How many commands may run at once.
    """
    templates = {DEFAULT: KEYFRAMES}
    for name in _WORLDS.names():
        templates[name] = {**KEYFRAMES, **parse_document(_WORLDS.read(name))}
    host = Host(password, catalog=Catalog(templates), record_to=folder.path / "recordings", hibernate_after=60.0)
    lab = Lab(folder, host, list(templates), most_jobs)
    try:
        async with host:
            host.offer({**KEYFRAMES, "name": "main"})
            try:
                yield lab
            finally:
                await lab.jobs.close()
    finally:
        await lab.close()
