"""Go in tests: where it is, and programs of the client in `clients/go` that are run."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from layout import ROOT

__all__ = ["BUILDING", "CLIENT", "GO", "go"]

GO = shutil.which("go", path=os.pathsep.join([os.environ.get("PATH", os.defpath), "/usr/local/go/bin"]))
CLIENT = ROOT / "clients" / "go"
BUILDING = 300.0  # s; the first build compiles the standard library


def go(
    *arguments: str, cwd: Path = CLIENT, told: str = "", environment: dict[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Runs Go on the client; no network is needed, and nothing of the user's is touched.

    Args:
        arguments: Of the command.
        cwd: The folder of the module.
        told: What the program reads from its standard input.
        environment: What else the program's environment has.
    """
    assert GO is not None
    offline = {"GOTOOLCHAIN": "local", "GOFLAGS": "-mod=readonly", "GOPROXY": "off"}
    program = str(Path(sys.executable).parent / "nmes")
    return subprocess.run(
        [GO, *arguments],
        cwd=cwd,
        env={**os.environ, **offline, "NMES_PROGRAM": program, **(environment or {})},
        input=told,
        timeout=BUILDING,
        capture_output=True,
        text=True,
        check=False,
    )
