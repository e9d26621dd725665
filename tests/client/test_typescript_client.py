"""The TypeScript client: as fresh as the schemas, and good by its own tests; skipped, and says so, without Node."""

from __future__ import annotations

import json
import os
import re
import shutil
import ssl
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
import trustme

import ts_messages
from layout import ROOT
from nmes.conformance import Verdict
from nmes.conformance.clients import judge
from servers import PASSWORD, Served, served

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
