"""The drivers of the two clients in Python for `nmes conform-client`: `python_client.py blocking`, or `awaiting`."""

from __future__ import annotations

import asyncio
import json
import sys
from contextlib import suppress
from typing import Any

from nmes import AsyncClient, Client
from nmes.client.declaration import Pending
from nmes.errors import CommandFailed, Disconnected, NmesError

PATIENCE = 30.0  # s
_FAILURES = (CommandFailed, Disconnected)


def failure(error: NmesError) -> dict[str, Any]:
    """Returns why there is no reply."""
    if isinstance(error, CommandFailed):
        return {"error": {"code": error.code, "message": error.message, "field": error.path}}
    return {"lost": f"{error.code}: {error.message}"}


def outcome(call: Pending[Any]) -> dict[str, Any]:
    """Returns what became of a command."""
    try:
        return {"reply": call.result()}
    except _FAILURES as error:
        return failure(error)


def outcome_of_part(part: dict[str, Any]) -> dict[str, Any]:
    """Returns what became of a command of a batch."""
    return {"error": part} if part["type"] == "error" else {"reply": part}


class Blocking:
    """Obeys with `nmes.Client`."""

    client: Client

    def obey(self, do: str, told: dict[str, Any]) -> dict[str, Any]:
        """Does what an instruction says; returns the answer."""
        try:
            if do == "open":
                self.client = Client(**told, timeout=PATIENCE)
                return {"opened": self.client.connect().welcome}
            if do == "send":
                return {"reply": self.client.request(told["command"])}
            if do == "batch":
                results = self.client.request({"type": "batch", "commands": told["commands"]})["results"]
                return {"outcomes": [outcome_of_part(part) for part in results]}
        except _FAILURES as error:
            return failure(error)
        if do == "pipeline":
            with suppress(*_FAILURES), self.client.pipeline() as together:
                calls = [together.request(command) for command in told["commands"]]
            return {"outcomes": [outcome(call) for call in calls]}
        if do == "events":
            events = self.client.events()
            return {"events": [next(events) for _ in range(told["count"])]}
        self.client.close()
        return {}


class Awaiting:
    """Obeys with `nmes.AsyncClient`."""

    client: AsyncClient

    async def obey(self, do: str, told: dict[str, Any]) -> dict[str, Any]:
        """Does what an instruction says; returns the answer."""
        try:
            if do == "open":
                self.client = AsyncClient(**told, timeout=PATIENCE)
                return {"opened": (await self.client.connect()).welcome}
            if do == "send":
                return {"reply": await self.client.request(told["command"])}
            if do == "batch":
                results = (await self.client.request({"type": "batch", "commands": told["commands"]}))["results"]
                return {"outcomes": [outcome_of_part(part) for part in results]}
        except _FAILURES as error:
            return failure(error)
        if do == "pipeline":
            with suppress(*_FAILURES):
                async with self.client.pipeline() as together:
                    calls = [together.request(command) for command in told["commands"]]
            return {"outcomes": [outcome(call) for call in calls]}
        if do == "events":
            events = self.client.events()
            return {"events": [await anext(events) for _ in range(told["count"])]}
        await self.client.close()
        return {}


async def main() -> None:
    """Reads instructions and answers them."""
    blocking = Blocking() if sys.argv[1:] == ["blocking"] else None
    awaiting = Awaiting()
    # Beside the loop, so that it goes on while no instruction comes.
    while line := await asyncio.to_thread(sys.stdin.readline):
        told = json.loads(line)
        do = told.pop("do")
        answer = blocking.obey(do, told) if blocking else await awaiting.obey(do, told)
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    asyncio.run(main())
