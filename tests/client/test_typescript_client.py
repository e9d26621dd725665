"""The TypeScript client: as fresh as the schemas, and good by its own tests; skipped, and says so, without Node."""

from __future__ import annotations

import json
import os
import re
import shutil
import ssl
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlencode

import pytest
import trustme

import ts_messages
from lab_browser import running_browser
from layout import ROOT
from nmes import Client
from nmes.conformance import Verdict
from nmes.conformance.clients import judge
from nmes.playback import replay
from processes import process, ready
from servers import PASSWORD, PATIENCE, Served, served, until

NODE, NPM = shutil.which("node"), shutil.which("npm")
CLIENT = ROOT / "clients" / "typescript"
PAGE = ROOT / "docs" / "typescript.md"
INSTALLING = 120.0  # s
RUNNING = 120.0  # s


def test_its_messages_are_those_of_the_schemas() -> None:
    assert ts_messages.PATH.read_text() == ts_messages.written(), "run make clients"


def test_it_needs_nothing_but_the_platform_and_names_no_place_where_packages_are() -> None:
    package = json.loads((CLIENT / "package.json").read_text())
    assert not {"dependencies", "peerDependencies", "optionalDependencies"} & package.keys()
    lock = (CLIENT / "package-lock.json").read_text()
    assert "resolved" not in lock and "://" not in re.sub(r'"url": "[^"]*"', "", lock)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Returns the folder of a copy of the client that is checked and built, its page's programs too."""
    if NODE is None or NPM is None:
        pytest.skip("Node or npm is not installed: the TypeScript client was not built and not run")
    folder = tmp_path_factory.mktemp("typescript") / "client"
    shutil.copytree(CLIENT, folder, ignore=shutil.ignore_patterns("node_modules", "dist"))
    for number, block in enumerate(blocks()):
        (folder / "examples" / f"page_{number}.ts").write_text(block.replace('"nmes-client/node"', '"../src/node.js"'))
    if (CLIENT / "node_modules").is_dir():
        (folder / "node_modules").symlink_to(CLIENT / "node_modules")
    else:
        installed = subprocess.run(
            [NPM, "ci", "--ignore-scripts"], cwd=folder, timeout=INSTALLING, capture_output=True, text=True, check=False
        )
        if installed.returncode:
            pytest.skip(f"npm cannot install TypeScript: the client was not built and not run: {installed.stderr}")
    checked = subprocess.run(
        [NODE, "node_modules/typescript/bin/tsc", "-p", "."], cwd=folder, capture_output=True, text=True, check=False
    )
    assert checked.returncode == 0, checked.stdout
    return folder


def blocks() -> list[str]:
    """Returns the programs of the client's page; each is one by itself."""
    return re.findall(r"^```ts\n(.*?)^```", PAGE.read_text(), flags=re.DOTALL | re.MULTILINE)


@pytest.fixture
def server() -> Iterator[Served]:
    with served() as running:
        yield running


def node(folder: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Runs Node in the folder, with the password of the tests' servers."""
    assert NODE is not None
    return subprocess.run(
        [NODE, *arguments],
        cwd=folder, env={**os.environ, "NMES_PASSWORD": PASSWORD, **environment}, timeout=RUNNING,
        capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_it_is_good_by_its_own_tests(built: Path, server: Served, tmp_path: Path) -> None:
    authority = trustme.CA()
    authority.cert_pem.write_to_path(tmp_path / "ca.pem")
    identity = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    authority.issue_cert("127.0.0.1").configure_cert(identity)
    # Node 20 has WebSocket, but only where that is asked for; later ones have it anyway, and know the option.
    with served(tls=identity) as secure:
        tested = node(
            built, "--experimental-websocket", "--test", "dist/test/client.test.js",
            NMES_PORT=str(server.port), NMES_TLS_PORT=str(secure.port), NMES_TLS_CA=str(tmp_path / "ca.pem"),
        )  # fmt: skip
    assert tested.returncode == 0, tested.stdout + tested.stderr


@contextmanager
def static_server(folder: Path) -> Iterator[str]:
    """Serves the files of a folder, in a process of its own; gives its origin."""
    command = [sys.executable, "-u", "-m", "http.server", "--bind", "127.0.0.1", "--directory", str(folder), "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as web:
        try:
            assert web.stdout is not None
            port = re.search(r"port (\d+)", web.stdout.readline())
            assert port is not None
            yield f"http://127.0.0.1:{port[1]}"
        finally:
            web.kill()


def test_a_page_of_40_lines_drives_a_cube(built: Path, tmp_path: Path) -> None:
    page = built / "examples" / "drive.html"
    assert len(page.read_text().splitlines()) == 40
    # Each in a process of its own: the page comes from another address than the world's, which is told to let it in.
    with static_server(built) as origin:
        options = ["--port", "0", "--http", "0", "--http-origin", origin, "--json", "--record", str(tmp_path)]
        with process("serve", *options, NMES_PASSWORD=PASSWORD) as running, running_browser() as browser:
            told = ready(running)
            view = browser.new_page()
            complaints: list[str] = []
            view.on("pageerror", lambda error: complaints.append(str(error)))
            server = f"ws://127.0.0.1:{told['http_port']}/ws"
            view.goto(f"{origin}/examples/drive.html#{urlencode({'server': server, 'password': PASSWORD})}")
            view.get_by_text("You are ").wait_for()
            name = view.locator("output").inner_text().removeprefix("You are ").removesuffix(".")
            view.keyboard.down("ArrowRight")
            with Client(port=told["port"], password=PASSWORD) as client:
                until(lambda: client.get_cube_state(name)["position"][0] > 1.0)
                client.pause()  # or it slides out of the picture
            view.keyboard.up("ArrowRight")
            right = "document.querySelector('canvas').getContext('2d').getImageData(331, 300, 200, 1).data"
            view.wait_for_function(f"[...{right}].includes(180)")  # the cube is drawn where it went to
            assert complaints == []
            running.terminate()
            assert running.wait(PATIENCE) == 0
    (recording,) = tmp_path.glob("*.mcap")
    assert replay(recording).verdict == "reproduced"


def test_it_conforms(built: Path) -> None:
    assert NODE is not None
    results = judge([NODE, str(built / "dist" / "conform" / "driver.js")])
    assert [(each.case.number, each.received) for each in results if each.verdict is not Verdict.OK] == []


def test_the_swarm_gathers(built: Path, server: Served) -> None:
    swarm = node(built, "dist/examples/swarm.js", "127.0.0.1", str(server.port))
    assert swarm.returncode == 0, swarm.stderr
    first, last = map(float, swarm.stdout.split())
    assert first == 15.0 and 0.5 < last < 6.0


def test_the_programs_of_its_page_run(built: Path, server: Served) -> None:
    assert len(blocks()) >= 3
    for number in range(len(blocks())):
        shown = node(built, f"dist/examples/page_{number}.js", NMES_PORT=str(server.port))
        assert shown.returncode == 0 and shown.stdout, shown.stderr
