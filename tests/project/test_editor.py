"""What an editor shows of the package: asked of a language server, as editors ask."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from layout import ROOT, lay_out

LAYOUT = ROOT / "build" / "layout"
EXAMPLE = ROOT / "tests" / "project" / "editor_example.py"


class LanguageServer:
    """A language server that has this repository open, over its standard input and output."""

    def __init__(self) -> None:
        program = [str(Path(sys.executable).parent / "basedpyright-langserver"), "--stdio"]
        self._process = subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT)
        folder = {"uri": ROOT.as_uri(), "name": "nmes"}
        self.ask("initialize", processId=None, rootUri=ROOT.as_uri(), workspaceFolders=[folder], capabilities={})
        self._say(method="initialized", params={})
        text = {"uri": EXAMPLE.as_uri(), "languageId": "python", "version": 1, "text": EXAMPLE.read_text()}
        self._say(method="textDocument/didOpen", params={"textDocument": text})

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()

    def ask(self, method: str, **params: Any) -> Any:
        """Asks, and returns the result."""
        self._say(id=1, method=method, params=params)
        while "result" not in (message := self._hear()):
            if "id" in message:  # it asks back, for settings; there are none
                self._say(id=message["id"], result=[])
        return message["result"]

    def at(self, method: str, word: str) -> str:
        """Asks about the last letter of a word's first occurrence in the example; returns the answer as text."""
        before, _, _ = EXAMPLE.read_text().partition(word)
        line = before.count("\n")
        column = len(before) - before.rfind("\n") - 1 + len(word) - 1
        position = {"line": line, "character": column}
        result = self.ask(method, textDocument={"uri": EXAMPLE.as_uri()}, position=position)
        return json.dumps(result, ensure_ascii=False)

    def _say(self, **message: Any) -> None:
        assert self._process.stdin is not None
        body = json.dumps({"jsonrpc": "2.0", **message}).encode()
        self._process.stdin.write(b"Content-Length: %d\r\n\r\n%s" % (len(body), body))
        self._process.stdin.flush()

    def _hear(self) -> Any:
        assert self._process.stdout is not None
        length = 0
        while line := self._process.stdout.readline().strip():
            name, _, value = line.partition(b":")
            length = int(value) if name == b"Content-Length" else length
        assert length, "the language server has ended"
        return json.loads(self._process.stdout.read(length))


@pytest.fixture(scope="module")
def server() -> Iterator[LanguageServer]:
    if not LAYOUT.exists():  # `make setup` has made it
        lay_out(LAYOUT)
    running = LanguageServer()
    yield running
    running.close()


def test_the_example_is_free_of_errors_for_a_type_checker_that_knows_no_package_dir(server: LanguageServer) -> None:
    checker = str(Path(sys.executable).parent / "basedpyright")
    result = subprocess.run([checker, str(EXAMPLE)], cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout


@pytest.mark.parametrize(("call", "reply"), [("client.spawn_cube", "CubeList"), ("awaiting.spawn_cube", "Coroutine")])
def test_a_command_shows_its_fields_units_defaults_and_errors(server: LanguageServer, call: str, reply: str) -> None:
    text = server.at("textDocument/hover", call)
    assert reply in text
    assert "mass: float | None = None" in text
    assert "mass: Mass in kg, from 0.000001 to 1,000,000,000. Default: 1." in text
    assert "CommandFailed: The server refused it: `cube_exists`" in text


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("nmes.schemas.schema_hash", "schemas/__init__.py"),
        ("BallisticBackend", "backends/ballistic.py"),
        ("SUBCOMMANDS", "cli/__init__.py"),
    ],
)
def test_definitions_in_the_mapped_folders_are_found(server: LanguageServer, name: str, file: str) -> None:
    assert file in server.at("textDocument/definition", name)
