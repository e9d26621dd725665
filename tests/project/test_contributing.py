"""What CONTRIBUTING.md shows is really added to a copy of the tree, and really works there."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from layout import PROJECT, ROOT, lay_out

PATIENCE = 300.0  # s
PASSWORD = "secret"
NMES = [sys.executable, "-c", "from nmes.cli import main; main()"]
PAGE = (ROOT / "CONTRIBUTING.md").read_text()


def section(heading: str) -> str:
    """Returns the text of a section of CONTRIBUTING.md."""
    return re.split(r"^## ", PAGE.split(f"## {heading}\n", 1)[1], maxsplit=1, flags=re.MULTILINE)[0]


def blocks(text: str) -> list[tuple[str, str, str]]:
    """Returns the code blocks that have a title: the file, the place in it (or nothing), and the code."""
    pattern = r'^```\w+ title="([^":]+)(?:: (\w+))?"\n(.*?)^```$'
    matches = re.finditer(pattern, text, flags=re.DOTALL | re.MULTILINE)
    return [(match[1], match[2] or "", match[3]) for match in matches]


MESSAGE = blocks(section("Adding a message"))


def installed(root: Path, path: str) -> Path:
    """Returns where a file of the repository lies in the laid-out tree."""
    folders: dict[str, str] = PROJECT["tool"]["setuptools"]["package-dir"]
    for package, folder in folders.items():
        if path.startswith(f"{folder}/"):
            return root / package.replace(".", "/") / path.removeprefix(f"{folder}/")
    return root / path


def add(file: Path, place: str, code: str) -> None:
    """Adds a code block of the page to a file, at the place that its title names."""
    before = file.read_text() if file.exists() else ""
    if place == "imports":
        after = before.replace(
            "from __future__ import annotations\n\n", f"from __future__ import annotations\n\n{code}"
        )
    elif place:
        after = before.replace(f"\n{place} = {{\n", f"\n{place} = {{\n{code}")
    elif "\nCOMMANDS = {\n" in before:
        after = before.replace("\nCOMMANDS = {\n", f"\n{code}\n\nCOMMANDS = {{\n")
    else:
        after = f"{before}\n\n{code}" if before else code
    assert after != before, (file, place)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(after)


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the tree as it is once installed, with the message of the page in it."""
    root = tmp_path_factory.mktemp("contributing")
    lay_out(root, copy=True)
    (root / "tests" / "world").mkdir(parents=True)
    shutil.copy(ROOT / "pyproject.toml", root)
    shutil.copy(ROOT / "tests" / "world" / "test_world.py", root / "tests" / "world")
    for path, place, code in MESSAGE:
        add(installed(root, path), place, code)
    return root


def environment(tree: Path) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(tree), "NMES_PASSWORD": PASSWORD}


def run(tree: Path, *command: str, check: bool = True) -> str:
    """Runs a program with the package of the tree; returns its output."""
    done = subprocess.run(
        command, cwd=tree, env=environment(tree), capture_output=True, text=True, check=False, timeout=PATIENCE
    )
    assert not check or done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture
def server(tree: Path, tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], dict[str, Any]]]:
    """A server of the tree that records into `tmp_path`, and what it says when it is ready."""
    options = ["--port", "0", "--mode", "lockstep", "--backend", "ballistic", "--record", str(tmp_path), "--json"]
    with subprocess.Popen(
        [*NMES, "serve", *options], cwd=tree, env=environment(tree), stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            yield process, json.loads(process.stdout.readline())
        finally:
            process.terminate()


def address(ready: dict[str, Any]) -> str:
    return f"127.0.0.1:{ready['port']}"


def test_a_message_takes_the_four_files_that_the_page_lists() -> None:
    listed = re.findall(r"^\| `([^`]+)` \|", section("Adding a message"), flags=re.MULTILINE)
    assert len(listed) <= 4
    assert list(dict.fromkeys(path for path, _, _ in MESSAGE)) == listed
    assert all(not (ROOT / path).exists() for path in listed if path.startswith("schemas/"))


CONVERSATION = """
import json, sys
import nmes.world
from nmes import Client
from nmes.errors import CommandFailed

with Client("127.0.0.1", int(sys.argv[1]), password="secret") as client:
    client.spawn_cube("hip", position=[0, 1, 0])
    client.spawn_cube("foot", position=[3, 5, 0])
    ask = {"type": "get_distance", "cube1": "hip", "cube2": "foot"}
    replies = [client.request(ask), client.request({**ask, "id": 7})]
    try:
        client.request({**ask, "cube2": "nobody"})
    except CommandFailed as error:
        replies.append([error.code, error.path])
    print(json.dumps({"module": nmes.world.__file__, "replies": replies}))
"""


def test_a_client_can_send_the_new_message_and_its_recording_replays(
    tree: Path, server: tuple[subprocess.Popen[str], dict[str, Any]], tmp_path: Path
) -> None:
    process, ready = server
    conversation = json.loads(run(tree, sys.executable, "-c", CONVERSATION, str(ready["port"])))
    assert conversation["module"].startswith(str(tree))
    first, second, refused = conversation["replies"]
    assert first == {"type": "distance", "distance": 5.0}
    assert second["distance"] == 5.0
    assert refused == ["cube_not_found", "cube2"]
    process.terminate()
    assert process.wait(PATIENCE) == 0
    (recording,) = tmp_path.glob("*.mcap")
    assert "reproduced" in run(tree, *NMES, "replay", str(recording))
    assert "get_distance" in run(tree, *NMES, "export", str(recording), "--to", "jsonl")


def test_the_conformance_suite_knows_the_new_message(
    tree: Path, server: tuple[subprocess.Popen[str], dict[str, Any]]
) -> None:
    report = json.loads(run(tree, *NMES, "conform", address(server[1]), "--json"))  # its status is 0: nothing failed
    assert report["counts"]["failed"] == 0 and report["counts"]["ok"] > 600
    assert "get_distance" in report["capabilities"]
    verdicts = {result["case"]: result["verdict"] for result in report["results"] if "get_distance" in result["case"]}
    fields = {case.removeprefix("6.1:") for case in verdicts if case.startswith("6.1:")}
    assert fields == {"get_distance.cube1", "get_distance.cube2"}
    assert set(verdicts.values()) == {"ok"}, verdicts


def test_the_reference_page_describes_the_new_message(tree: Path) -> None:
    page = run(tree, sys.executable, "-m", "nmes.schemas")
    assert "### get_distance\n" in page and "### distance\n" in page


def test_the_test_of_the_new_message_passes(tree: Path) -> None:
    name = next(re.search(r"def (test_\w+)", code) for path, _, code in MESSAGE if path.startswith("tests/"))
    assert name is not None
    options = ["-q", "-p", "no:cacheprovider", f"tests/world/test_world.py::{name[1]}"]
    assert "1 passed" in run(tree, sys.executable, "-m", "pytest", *options)
