"""The Go example drives a served world in both dialects; where Go is not installed, its test is skipped and says so."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from layout import ROOT
from nmes.playback import replay
from servers import PASSWORD, served

GO = shutil.which("go", path=os.pathsep.join([os.environ.get("PATH", os.defpath), "/usr/local/go/bin"]))
EXAMPLE = ROOT / "examples" / "go"
BUILDING = 300.0  # s; the first build compiles the standard library


def test_the_go_example_needs_the_standard_library_only() -> None:
    assert "require" not in (EXAMPLE / "go.mod").read_text()
    assert {path.name for path in EXAMPLE.iterdir()} == {"go.mod", "main.go"}


@pytest.mark.skipif(GO is None, reason="Go is not installed: the Go example was not built and not run")
@pytest.mark.parametrize("mode", ["realtime", "lockstep"])
def test_the_go_example_builds_an_arm_and_a_pole(mode: str, tmp_path: Path) -> None:
    assert GO is not None
    # No network is needed, and nothing of the user's is touched.
    environment = {**os.environ, "GOTOOLCHAIN": "local", "GOFLAGS": "-mod=readonly", "GOPROXY": "off"}
    subprocess.run([GO, "vet", "."], cwd=EXAMPLE, env=environment, timeout=BUILDING, check=True)
    program = tmp_path / "arm"
    subprocess.run([GO, "build", "-o", program, "."], cwd=EXAMPLE, env=environment, timeout=BUILDING, check=True)
    with served({"backend": "mujoco", "mode": mode}, record_to=tmp_path / "recordings") as server:
        done = subprocess.run(
            [program, "-addr", f"127.0.0.1:{server.port}"],
            env={**environment, "NMES_PASSWORD": PASSWORD},
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        figures = json.loads(done.stdout)
        assert 0.5 <= figures["arm_turned"]
        assert 0.3 <= figures["pole_moved"] <= 1.5
        refused = subprocess.run(
            [program, "-addr", f"127.0.0.1:{server.port}", "-password", "wrong"],
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        assert (refused.returncode, refused.stderr) == (1, "arm: the server says auth_failed\n")
    (recording,) = (tmp_path / "recordings").iterdir()
    assert replay(recording).verdict == "reproduced"
