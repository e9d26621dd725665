"""The server in Go is driven by our client and judged by the suite, and so are copies of it with one mistake each.

Where Go is not installed, this is skipped and says so.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from layout import ROOT
from nmes import Client
from nmes.conformance import Options, Report, Target, Verdict, run
from nmes.errors import CommandFailed

GO = shutil.which("go", path=os.pathsep.join([os.environ.get("PATH", os.defpath), "/usr/local/go/bin"]))
SOURCE = ROOT / "examples" / "go-server"
BUILDING = 300.0  # s; the first build compiles the standard library
PASSWORD = "open sesame"
# No network is needed, and nothing of the user's is touched.
ENVIRONMENT = {**os.environ, "GOTOOLCHAIN": "local", "GOFLAGS": "-mod=readonly", "GOPROXY": "off"}

needs_go = pytest.mark.skipif(GO is None, reason="Go is not installed: the server in Go was not built and not judged")

# A mistake: the file, what it says, what it says instead, the category of the cases that find it.
MISTAKES = {
    "a delimiter that comes in two pieces is missed": (
        "host.go",
        "searched = max(len(buffer)-len(delimiter)+1, 0)",
        "searched = len(buffer)",
        "framing",
    ),
    "a wrong password costs nothing": ("host.go", "penance     = time.Second", "penance     = 0", "auth"),
    "the raw dialect is told of errors": (
        "host.go",
        "c.raw && silent {",
        "c.raw && silent && wrong == nil {",
        "dialects",
    ),
    "the last of two equal keys is taken": ("json.go", "fields[key]; twice {", "fields[key]; twice && false {", "json"),
    "errors lose the id": (
        "host.go",
        'failed(wrong, said.id, said.fields["type"])',
        'failed(wrong, nil, said.fields["type"])',
        "errors",
    ),
    "a name is used again": ("world.go", "if w.used[called] {", "if w.cube(called) != nil {", "names"),
    "a force lasts": ("world.go", "c.force, c.torque, c.impulse", "_, c.torque, c.impulse", "physics"),
    "every hinge turns about z": (
        "world.go",
        'axis := vec(given["axis"], 0, 0, 1)',
        "axis := Vec{0, 0, 1}",
        "physics",
    ),
}


def go(*arguments: str | Path, cwd: Path) -> str:
    assert GO is not None
    return subprocess.run(
        [GO, *arguments], cwd=cwd, env=ENVIRONMENT, timeout=BUILDING, check=True, capture_output=True, text=True
    ).stdout


@contextmanager
def served(program: Path, *options: str) -> Iterator[Target]:
    """Runs the program on a free port."""
    process = subprocess.Popen(
        [program, "-addr", "127.0.0.1:0", *options],
        env={**ENVIRONMENT, "NMES_PASSWORD": PASSWORD},
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        yield Target("127.0.0.1", int(process.stdout.readline().rsplit(":")[-1]), PASSWORD)
    finally:
        process.kill()
        process.communicate()


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    built = tmp_path_factory.mktemp("go") / "server"
    go("build", "-o", built, ".", cwd=SOURCE)
    return built


def findings(report: Report) -> list[str]:
    return [
        f"{result.case.number} {result.verdict}: {result.expected}, got {result.received}; {result.reason}"
        for result in report.results
        if result.verdict in (Verdict.FAILED, Verdict.FAULT, Verdict.NON_STRICT)
    ]


def test_the_go_server_needs_the_standard_library_only() -> None:
    assert "require" not in (SOURCE / "go.mod").read_text()
    assert {path.suffix for path in SOURCE.iterdir()} == {".mod", ".go"}


@needs_go
def test_the_go_server_is_formatted_and_vetted() -> None:
    assert GO is not None
    go("vet", ".", cwd=SOURCE)
    formatter = Path(GO).resolve().with_name("gofmt")
    done = subprocess.run([formatter, "-l", SOURCE], capture_output=True, text=True, check=True)
    assert done.stdout == ""


@needs_go
def test_our_client_drives_the_go_server(program: Path) -> None:
    with served(program, "-mode", "lockstep") as target:
        with Client(target.host, target.port, password=PASSWORD) as client:
            base = client.spawn_cube("post", position=[0, 3, 0], is_base=True)["spawned"]
            arm = client.spawn_cube("arm", position=[1, 3, 0], size=[1, 0.2, 0.2])["spawned"]
            hinge = client.create_joint(base, arm, "hinge", position=[0.5, 3, 0], axis=[0, 1, 0])["joint_name"]
            client.set_joint_param(hinge, "motor_target_velocity", 1.5)
            stone = client.spawn_cube(position=[5, 4, 0])["spawned"]
            assert client.step(ticks=60) == {"type": "stepped", "frame": 60, "t": 1.0}
            turned = client.get_cube_info(arm)
            assert turned["rotation"][1] == pytest.approx(1.5, abs=0.05)
            assert turned["position"][1] == pytest.approx(3, abs=0.01)
            client.step(ticks=60)
            assert client.get_cube_info(stone)["position"] == pytest.approx([5, 0.5, 0], abs=0.01)
            with pytest.raises(CommandFailed, match="does not have subscribe"):
                client.subscribe(events=["tick"])
        with (
            pytest.raises(CommandFailed, match="password is wrong"),
            Client(target.host, target.port, password="wrong") as client,
        ):
            client.ping()


@needs_go
@pytest.mark.parametrize(
    ("mode", "categories", "least"), [("lockstep", [], 450), ("realtime", ["time", "physics", "clients"], 50)]
)
def test_the_go_server_conforms(program: Path, mode: str, categories: list[str], least: int) -> None:
    with served(program, "-mode", mode) as target:
        report = run(target, Options(categories=categories))
    assert not findings(report), "\n".join(findings(report))
    assert report.exit_status == 0
    assert sum(result.verdict == Verdict.OK for result in report.results) >= least


@needs_go
@pytest.mark.parametrize("mistake", MISTAKES)
def test_the_suite_finds_a_mistake_in_the_go_server(mistake: str, tmp_path: Path) -> None:
    name, right, wrong, category = MISTAKES[mistake]
    copy = tmp_path / "source"
    shutil.copytree(SOURCE, copy)
    text = (copy / name).read_text()
    assert text.count(right) == 1
    (copy / name).write_text(text.replace(right, wrong))
    go("build", "-o", tmp_path / "server", ".", cwd=copy)
    with served(tmp_path / "server", "-mode", "lockstep") as target:
        report = run(target, Options(categories=[category]))
    assert any(result.verdict == Verdict.FAILED for result in report.results), mistake
    assert report.exit_status == 1
