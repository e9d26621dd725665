"""What it costs a lab to show a world to a browser, and how soon a list of very many recordings is there.

`python benchmarks/lab.py` runs a lab of its own on this machine's loopback, and prints its figures as JSON: the part of
a core that the process takes while 1,000 cubes fall, unwatched and watched in turns; how many frames came; and how long
the first page of 10,000 recordings takes, in a folder that the lab has never seen. With Playwright and Chromium it also
tells what a browser without a graphics processor makes of it: how many pictures of 300 cubes that turn it draws in a
second, in windows of two sizes, and how long it takes until the page of 10,000 recordings, or runs, has been painted.
"""

from __future__ import annotations

import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

CUBES = 1000
RECORDINGS = 10_000
WATCH = 5.0  # s of each turn
TURNS = 4
PAGES = 20
TURNING = 300  # cubes that a browser draws
WINDOWS = ((1280, 720), (1920, 1080))
SOFTWARE = ["--no-sandbox", "--use-gl=swiftshader", "--enable-unsafe-swiftshader", "--disable-gpu-sandbox"]


class Lab:
    """A lab in a process of its own."""

    def __init__(self, process: subprocess.Popen[str], about: dict[str, Any]) -> None:
        self._process = process
        self.port: int = about["port"]
        self.url: str = about["url"]
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


def turn(lab: Lab) -> None:
    """Fills a world with cubes that turn for ever, each on an axis of its own."""
    with lab.socket("/ws") as world:
        ask(world, {"type": "auth", "create": {"world": "turning"}})
    with lab.socket("/ws") as world:
        ask(world, {"type": "auth", "world": "turning"})
        ask(world, {"type": "spawn_cube", "cube_name": "hub", "position": [16, 30, 0], "frozen": True, "list": False})
        for number in range(TURNING):
            name, place = f"c{number}", [1.6 * (number % 20), 2 + 1.6 * (number // 20), 0]
            ask(
                world,
                {"type": "spawn_cube", "cube_name": name, "position": place, "size": [1, 0.5, 0.5], "list": False},
            )
            motor = {"motor_enabled": True, "motor_target_velocity": 2.0, "motor_max_force": 100.0}
            joint = {"type": "create_joint", "joint_type": "hinge", "cube1": "hub", "cube2": name, "axis": [0, 0, 1]}
            ask(world, {**joint, "position": place, **motor})


def browsing(lab: Lab) -> dict[str, Any]:
    """Measures what a browser without a graphics processor makes of it."""
    from playwright.sync_api import sync_playwright

    turn(lab)
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    figures: dict[str, Any] = {"cubes": TURNING}
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=SOFTWARE)
        for width, height in WINDOWS:
            page = browser.new_page(viewport={"width": width, "height": height})
            page.goto(lab.url)
            page.goto(f"http://127.0.0.1:{lab.port}/#/worlds/turning")
            page.wait_for_timeout(WATCH * 1000)
            stage = page.locator(".stage")
            first, began = int(stage.get_attribute("data-drawn") or 0), time.perf_counter()
            page.wait_for_timeout(WATCH * 1000)
            drawn = int(stage.get_attribute("data-drawn") or 0) - first
            rate = drawn / (time.perf_counter() - began)
            figures[f"pictures_a_second_{width}x{height}"] = rate
            figures[f"ratio_{width}x{height}"] = float(stage.get_attribute("data-ratio") or 0)
            page.close()
        for path, rows in (("recordings", "tbody tr"), ("evolve", "tbody tr")):
            times = []
            for _ in range(3):
                context = browser.new_context()
                page = context.new_page()
                page.goto(lab.url)
                began = time.perf_counter()
                page.goto(f"http://127.0.0.1:{lab.port}/health")
                page.goto(f"http://127.0.0.1:{lab.port}/#/{path}")
                page.locator(rows).first.wait_for()
                times.append(time.perf_counter() - began)
                context.close()
            figures[f"list_of_{path}_s"] = statistics.median(times)
        browser.close()
    return figures


def main() -> None:
    """Prints the figures."""
    with tempfile.TemporaryDirectory() as folder:
        recordings = Path(folder) / "recordings"
        recordings.mkdir()
        for number in range(RECORDINGS):
            (recordings / f"r{number}.mcap").write_bytes(b"\x89MCAP0\r\n")
            run = Path(folder) / "runs" / f"r{number}"
            run.mkdir(parents=True)
            (run / "run.json").write_text('{"format": "nmes-run/1"}')
        with running(Path(folder)) as lab:
            figures = {"listing": listing(lab), "watching": watching(lab)}
            if find_spec("playwright") is not None:
                figures["browsing"] = browsing(lab)
    print(json.dumps(figures, indent=2))


if __name__ == "__main__":
    main()
