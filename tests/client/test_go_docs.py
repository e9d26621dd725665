"""The page of the Go client: each program on it runs against a server, and so does each piece of one."""

from __future__ import annotations

import json
import os
import re
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from go_programs import CLIENT, GO, go
from layout import ROOT
from nmes.playback import replay
from servers import PASSWORD, served

pytestmark = pytest.mark.skipif(GO is None, reason="Go is not installed: what the page shows was not built and not run")

_PAGE = (ROOT / "docs" / "go.md").read_text()
_BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```", _PAGE, flags=re.DOTALL | re.MULTILINE)
_PACKAGES = ("context", "encoding/json", "fmt", "log", "nmes", "nmes/brain", "nmes/evolve", "nmes/fleet", "nmes/genome")
_PIECE = """package main

import (
{imports}
)

func main() {{
	ctx := context.Background()
	client, err := nmes.Dial(ctx, "127.0.0.1:14000", nmes.Options{{}})
	if err != nil {{
		log.Fatal(err)
	}}
	defer client.Close()
	if _, err := client.SetMode(ctx, nmes.SetMode{{Mode: "lockstep"}}); err != nil {{
		log.Fatal(err)
	}}
	{{
		{piece}
	}}
}}
"""


def _program(block: str) -> str:
    """Returns a block as a program: itself, or what it is a piece of."""
    if block.startswith("package main"):
        return block
    whole = _PIECE.format(piece=block, imports="")
    used = [name for name in _PACKAGES if f"{name.rpartition('/')[2]}." in whole]
    return _PIECE.format(piece=block, imports="\n".join(f'\t"{name}"' for name in used))


def _run(program: Path, *arguments: str, password: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [program, *arguments],
        env={**os.environ, "NMES_PASSWORD": password},
        timeout=120,
        capture_output=True,
        text=True,
        check=False,
    )


@contextmanager
def _server(tmp_path: Path) -> Iterator[tuple[str, Path]]:
    """Runs a server of MuJoCo that records; yields its address and the folder of its recordings."""
    recordings = tmp_path / "recordings"
    with served({"backend": "mujoco"}, record_to=recordings) as server:
        yield f"127.0.0.1:{server.port}", recordings


def test_every_block_of_the_page_runs(tmp_path: Path) -> None:
    (module,) = [block for language, block in _BLOCKS if not language]
    blocks = [block for language, block in _BLOCKS if language == "go"]
    assert {language for language, _ in _BLOCKS} == {"", "go"} and len(blocks) >= 5
    (tmp_path / "go.mod").write_text(module.replace("../nmes/clients/go", str(CLIENT)))
    with _server(tmp_path) as (address, _):
        for number, block in enumerate(blocks):
            folder = tmp_path / f"block{number}"
            folder.mkdir()
            (folder / "main.go").write_text(_program(block).replace("127.0.0.1:14000", address))
        built = go("build", "-o", "bin/", "./...", cwd=tmp_path)
        assert built.returncode == 0, built.stderr
        for number, block in enumerate(blocks):
            ran = _run(tmp_path / "bin" / f"block{number}", password=PASSWORD)
            assert ran.returncode == 0, f"{block}\n{ran.stderr}"


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Builds the examples."""
    folder = tmp_path_factory.mktemp("examples")
    built = go("build", "-o", f"{folder}/", "./examples/...")
    assert built.returncode == 0, built.stderr
    return folder


_EXAMPLES = sorted(folder.name for folder in (CLIENT / "examples").glob("tier*"))


def test_the_page_tells_of_every_example() -> None:
    assert re.findall(r"^\| `(tier\w+)`", _PAGE, flags=re.MULTILINE) == _EXAMPLES and len(_EXAMPLES) == 4


@pytest.mark.parametrize("name", _EXAMPLES)
def test_an_example_does_what_it_is_to_do_and_its_recording_replays(name: str, programs: Path, tmp_path: Path) -> None:
    with _server(tmp_path) as (address, recordings):
        ran = _run(programs / name, "-json", "-addr", address, password=PASSWORD)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert len(json.loads(ran.stdout)) >= 2
    (recording,) = recordings.iterdir()
    assert replay(recording).verdict == "reproduced"


def test_an_example_that_is_not_let_in_says_why_in_a_line(programs: Path, tmp_path: Path) -> None:
    with _server(tmp_path) as (address, _):
        refused = _run(programs / _EXAMPLES[0], "-addr", address, password="wrong")
    assert refused.returncode == 1 and refused.stderr.startswith("nmes: auth_failed: ")
    assert refused.stderr.count("\n") == 1 and not refused.stdout
