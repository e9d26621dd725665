"""Robots over rosbridge: what a server takes for many controllers, each of which answers every state with a command.

`python benchmarks/rosbridge.py [ROBOTS] [--rate HZ] [--seconds S]` runs a server of its own on this machine's loopback,
recorded, and prints its figures as JSON: the processor's time that the server takes with nobody there, with the robots
driven over rosbridge, a WebSocket each, and with the same robots driven by the protocol over TCP, a connection each.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from websockets.asyncio.client import connect

from fleet import PASSWORD, Host
from nmes.protocol import DELIMITER, decode, encode

MOST = 500
ROCKER = {
    "format": "nmes-genome/1",
    "name": "rocker",
    "body": {
        "cubes": [
            {"id": "torso", "size": 0.4, "mass": 2, "position": [0, 0.2, 0]},
            {"id": "arm", "size": [0.6, 0.1, 0.1], "mass": 0.5, "position": [0.4, 0.3, 0]},
        ],
        "joints": [
            {
                "id": "shoulder",
                "cube1": "torso",
                "cube2": "arm",
                "type": "hinge",
                "anchor": [0.15, 0.3, 0],
                "motor": {"mode": "position", "range": [-0.8, 0.8], "max_effort": 10},
            }
        ],
    },
}


class Count:
    """How many states were heard."""

    states = 0


async def by_rosbridge(ready: dict[str, Any], name: str, count: Count) -> None:
    """Drives a robot: each state is answered by a command."""
    url = f"ws://127.0.0.1:{ready['rosbridge_port']}/?password={PASSWORD}"
    async with connect(url, max_size=None, compression=None) as socket:
        listen = {"op": "subscribe", "topic": f"/{name}/joint_states", "type": "sensor_msgs/JointState"}
        await socket.send(json.dumps(listen))
        command = f'{{"op": "publish", "topic": "/{name}/shoulder/command", "msg": {{"data": %.3f}}}}'
        async for message in socket:
            position = decode(message.encode() if isinstance(message, str) else message)["msg"]["position"][0]
            count.states += 1
            await socket.send(command % (0.4 - 0.2 * position))


async def by_tcp(ready: dict[str, Any], name: str, count: Count) -> None:
    """Drives a robot by the protocol: at each tick it asks for its joint, and answers with a command."""
    reader, writer = await asyncio.open_connection("127.0.0.1", ready["port"], limit=1 << 20)
    first = ({"type": "auth", "password": PASSWORD}, {"type": "subscribe", "events": ["tick"]})
    writer.write(b"".join(encode(message) + DELIMITER for message in first))
    ask = encode({"type": "get_joint_info", "joint_name": f"{name}.shoulder"}) + DELIMITER
    turn = {"type": "set_joint_param", "joint_name": f"{name}.shoulder", "param_name": "target_position"}
    while True:
        message = decode((await reader.readuntil(DELIMITER))[: -len(DELIMITER)])
        if message["type"] == "tick":
            writer.write(ask)
        elif message["type"] == "joint_info":
            count.states += 1
            writer.write(encode({**turn, "value": round(0.4 - 0.2 * message["position"], 3)}) + DELIMITER)


async def spawn(ready: dict[str, Any], robots: int) -> None:
    """Puts the robots into the world, side by side."""
    reader, writer = await asyncio.open_connection("127.0.0.1", ready["port"], limit=1 << 24)
    spawns = [
        {"type": "spawn_creature", "name": f"r{n}", "genome": ROCKER, "position": [2 * (n % 25), 0, 2 * (n // 25)]}
        for n in range(robots)
    ]
    messages = ({"type": "auth", "password": PASSWORD}, {"type": "batch", "commands": spawns})
    writer.write(b"".join(encode(message) + DELIMITER for message in messages))
    for _ in messages:
        answer = decode((await reader.readuntil(DELIMITER))[: -len(DELIMITER)])
        if answer["type"] == "error":
            raise RuntimeError(f"the server says {answer}")
    writer.close()


@asynccontextmanager
async def server(rate: int, robots: int) -> AsyncIterator[tuple[dict[str, Any], Host]]:
    """Runs a server of a world in which the robots are."""
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "world.json"
        config.write_text(json.dumps({"name": "main", "tick_rate": rate}))
        command = [str(Path(sys.executable).parent / "nmes"), "serve", "--json", "--port", "0", "--rosbridge", "0"]
        options = ["--config", str(config), "--record", folder]
        environment = {**os.environ, "NMES_PASSWORD": PASSWORD}
        with subprocess.Popen([*command, *options], env=environment, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            ready = json.loads(process.stdout.readline())
            await spawn(ready, robots)
            yield ready, Host(process, ready["port"])
            process.terminate()


Drive = Callable[[dict[str, Any], str, Count], Coroutine[Any, Any, None]]


async def measure(drive: Drive | None, robots: int, rate: int, seconds: float) -> dict[str, float]:
    """Returns what part of a core the server takes, and how many states a robot heard each second."""
    async with server(rate, robots) as (ready, host):
        count = Count()
        tasks = [] if drive is None else [asyncio.create_task(drive(ready, f"r{n}", count)) for n in range(robots)]
        await asyncio.sleep(2.0)
        before, states = host.used, count.states
        await asyncio.sleep(seconds)
        cores, heard = (host.used - before) / seconds, count.states - states
        for task in tasks:
            task.cancel()
        for result in await asyncio.gather(*tasks, return_exceptions=True):
            if isinstance(result, Exception):
                raise result
        return {"cores": round(cores, 3), "states_a_second": round(heard / seconds / robots, 2)}


async def main() -> None:
    """Measures, and prints the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="?", type=int, default=50)
    parser.add_argument("--rate", type=int, default=50, help="ticks, states and commands a second")
    parser.add_argument("--seconds", type=float, default=10.0)
    options = parser.parse_args()
    if not 1 <= options.robots <= MOST:
        parser.error(f"from 1 to {MOST} robots")
    figures: dict[str, Any] = {"robots": options.robots, "rate": options.rate}
    for name, drive in (("nobody", None), ("rosbridge", by_rosbridge), ("protocol", by_tcp)):
        figures[name] = await measure(drive, options.robots, options.rate, options.seconds)
    figures["rosbridge_beyond_the_world"] = round(figures["rosbridge"]["cores"] - figures["nobody"]["cores"], 3)
    figures["load"] = round(os.getloadavg()[0], 1)
    print(json.dumps(figures, indent=2))


asyncio.run(main())
