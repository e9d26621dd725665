"""What it costs a lab to show a world to a browser, and how soon a list of very many recordings is there.

`python benchmarks/lab.py` runs a lab of its own on this machine's loopback, and prints its figures as JSON: the part of
a core that the process takes while 1,000 cubes fall, unwatched and watched in turns; how many frames came; and how long
the first page of 10,000 recordings takes, in a folder that the lab has never seen.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

CUBES = 1000
RECORDINGS = 10_000
WATCH = 5.0  # s of each turn
TURNS = 4
PAGES = 20


class Lab:
    """A lab in a process of its own."""

    def __init__(self, process: subprocess.Popen[str], about: dict[str, Any]) -> None:
        self._process = process
        self.port: int = about["port"]
        self.headers = {"Authorization": f"Bearer {about['token']}"}

    @contextmanager
    def socket(self, path: str) -> Iterator[ClientConnection]:
        """Opens a WebSocket."""
        address = f"ws://127.0.0.1:{self.port}{path}"
        with connect(address, additional_headers=self.headers, max_queue=None) as connection:
            yield connection

    def get(self, path: str) -> Any:
        """Asks for something."""
        request = urllib.request.Request(f"http://127.0.0.1:{self.port}{path}", headers=self.headers)
        with urllib.request.urlopen(request) as response:
            return json.loads(response.read())

    def time(self) -> float:
        """The time of the processor that the process has taken, s."""
        fields = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def running(folder: Path) -> Iterator[Lab]:
    """Runs a lab."""
    nmes = str(Path(sys.executable).parent / "nmes")
    arguments = [nmes, "lab", "--dir", str(folder), "--port", "0", "--json"]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout is not None
        yield Lab(process, json.loads(process.stdout.readline()))
        process.terminate()


def ask(world: ClientConnection, message: dict[str, Any]) -> Any:
    """Returns the answer to a message."""
    world.send(json.dumps(message))
    return json.loads(world.recv())


def watching(lab: Lab) -> dict[str, Any]:
    """Measures what it costs to watch falling cubes."""
    with lab.socket("/ws") as world:
        ask(world, {"type": "auth"})
        places = [(4.0 * (number % 32), 9000.0, 4.0 * (number // 32)) for number in range(CUBES)]
        cubes = [{"type": "spawn_cube", "position": place, "list": False} for place in places]
        ask(world, {"type": "batch", "commands": cubes})
        unwatched, watched, rates, paces = [], [], [], []
        for _ in range(TURNS):
            unwatched.append(load(lab))
            with lab.socket("/ws/poses") as watcher:
                sizes: list[int] = []
                reader = threading.Thread(target=read, args=(watcher, sizes))
                reader.start()
                first = ask(world, {"type": "get_world_info"})["frame"]
                watched.append(load(lab))
                paces.append((ask(world, {"type": "get_world_info"})["frame"] - first) / WATCH)
                rates.append(len(sizes) / WATCH)
            reader.join()
    differences = [with_it - without for with_it, without in zip(watched, unwatched, strict=True)]
    return {
        "cubes": CUBES,
        "ticks_a_second": statistics.median(paces),
        "frames_a_second": statistics.median(rates),
        "core_unwatched": statistics.median(unwatched),
        "core_watched": statistics.median(watched),
        "core_of_watching": statistics.median(differences),
    }


def read(watcher: ClientConnection, sizes: list[int]) -> None:
    """Notes the sizes of the frames, until the end."""
    with suppress(ConnectionClosed):
        for message in watcher:
            if isinstance(message, bytes):
                sizes.append(len(message))


def load(lab: Lab) -> float:
    """Returns the part of a core that the lab takes."""
    before = lab.time()
    time.sleep(WATCH)
    return (lab.time() - before) / WATCH


def listing(lab: Lab) -> dict[str, Any]:
    """Measures how soon the first page of a long list is there."""
    times = []
    for _ in range(PAGES + 1):
        began = time.perf_counter()
        page = lab.get("/api/recordings")
        times.append((time.perf_counter() - began) * 1e3)
    assert len(page["items"]) == 100
    return {"recordings": page["count"], "first_ms": times[0], "then_ms": statistics.median(times[1:])}


def main() -> None:
    """Prints the figures."""
    with tempfile.TemporaryDirectory() as folder:
        recordings = Path(folder) / "recordings"
        recordings.mkdir()
        for number in range(RECORDINGS):
            (recordings / f"r{number}.mcap").write_bytes(b"\x89MCAP0\r\n")
        with running(Path(folder)) as lab:
            figures = {"listing": listing(lab), "watching": watching(lab)}
    print(json.dumps(figures, indent=2))


if __name__ == "__main__":
    main()
