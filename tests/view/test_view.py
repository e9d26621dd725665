"""Worlds and recordings as Rerun is told of them, in files, over sockets and in a browser."""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn
from urllib.error import URLError

import numpy as np
import orjson
import pytest
from PIL import Image
from rerun.chunk import RrdReader

from nmes import Client
from nmes.errors import CommandFailed, MachineError, WorldError
from nmes.recording import Recording
from nmes.server.metrics import Metrics
from nmes.view.canvas import load_rerun
from nmes.view.moments import moments
from nmes.view.recordings import show_recording
from nmes.view.screen import screen
from nmes.world import World
from nmes.world.commands import COMMANDS
from recordings import Line, record, rewrite, send
from servers import PASSWORD, PATIENCE, Served, served, until

NMES = str(Path(sys.executable).parent / "nmes")
BROWSERS = ("chromium", "chromium-browser", "google-chrome")  # as .ci/run looks for them
Rows = dict[str, list[dict[str, Any]]]


def read(path: Path) -> Rows:
    """What an .rrd file holds: by entity a row for each message, with its components and `time` (s; None: always)."""
    entities: Rows = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        index = batch.schema.get_field_index("time")
        columns = {name: batch.column(name).to_pylist() for name in batch.schema.names if ":" in name}
        for i in range(batch.num_rows):
            row = {name: values[i] for name, values in columns.items() if values[i] is not None}
            when = None if index < 0 else batch.column(index)[i].value / 1e9
            entities.setdefault(chunk.entity_path, []).append(row | {"time": when})
    for rows in entities.values():
        rows.sort(key=lambda row: (row["time"] is not None, row["time"]))
    return entities


@pytest.fixture(scope="session")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """A home of its own: Rerun asks whether it may collect statistics only where it was never run before, and waits."""
    home = str(tmp_path_factory.mktemp("home"))
    return {**os.environ, "HOME": home, "XDG_CONFIG_HOME": home, "NMES_PASSWORD": PASSWORD}


def view(environment: dict[str, str], *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [NMES, "view", *arguments], env=environment, capture_output=True, text=True, timeout=2 * PATIENCE
    )


seen: dict[int, dict[str, list[float]]] = {}


def play(world: World, client: int) -> None:
    """A red cube lies, a blue one hangs on it by a hinge with limits; a third is pushed at frame 40."""
    send(world, client, type="spawn_cube", cube_name="red", position=[0, 0.5, 0], color=[1, 0, 0, 1])
    send(world, client, type="freeze_cube", cube_name="red", freeze=True)
    send(world, client, type="spawn_cube", cube_name="blue", position=[1, 2, 0], color=[0, 0, 1, 1])
    joint = {"cube1": "red", "cube2": "blue", "joint_type": "hinge", "axis": [0, 0, 1], "position": [0.5, 1.25, 0]}
    send(world, client, type="create_joint", limits=[-0.5, 1.0], **joint)
    send(world, client, type="spawn_cube", cube_name="green", position=[4, 0.5, 0], color=[0, 1, 0, 1])
    send(world, client, type="set_objective", cubes=["green"], expression="displacement.x")
    for _ in range(60):
        if world.frame == 40:
            send(world, client, type="apply_physics", cube_name="green", force=[0, 0, 60.0], at=[4, 0.5, 0.5])
            send(world, client, type="batch", commands=[{"type": "apply_physics", "impulse": [0.5, 0, 0]}])
            send(world, client, type="despawn_cube", cube_name="nobody")
        send(world, client, type="step")
        send(world, client, type="get_world_state")
        names, states = world.poses()
        seen[world.frame] = {name: state.tolist() for name, state in zip(names, states, strict=True)}
    send(world, client, type="compute_reward")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("view") / "hinged cubes.mcap", play, {"backend": "mujoco"})


@pytest.fixture(scope="module")
def shown(recording: Path, environment: dict[str, str]) -> Rows:
    saved = recording.with_suffix(".rrd")
    run = view(environment, recording, "--save", saved)
    assert run.returncode == 0, run.stderr
    assert "reproduced" in run.stdout
    assert run.stderr == ""
    return {path.removeprefix("/hinged\\ cubes"): rows for path, rows in read(saved).items()}


def test_the_viewer_has_the_recorded_poses(shown: Rows) -> None:
    first, *rest = shown["/cubes"]
    assert first["Boxes3D:labels"] == ["red", "blue", "green"]
    assert [f"{color:08x}" for color in first["Boxes3D:colors"]] == ["ff0000ff", "0000ffff", "00ff00ff"]
    assert first["Boxes3D:half_sizes"] == [[0.5, 0.5, 0.5]] * 3
    assert rest and all("Boxes3D:half_sizes" not in row for row in rest), "shapes were sent again"
    for row in (first, *rest):
        frame = round(row["time"] * 60)
        assert frame % 2 == 0
        for place, turn, state in zip(
            row["Boxes3D:centers"], row["Boxes3D:quaternions"], seen[frame].values(), strict=True
        ):
            assert [*place, *turn] == pytest.approx(state[:7], abs=1e-6)


def test_joints_show_axis_and_limits(shown: Rows) -> None:
    for row in shown["/joints"]:
        assert len(set(row["LineStrips3D:labels"])) == 1
        axis, arc, spoke = (np.array(strip) for strip in row["LineStrips3D:strips"])
        anchor = spoke[0]
        assert anchor == pytest.approx([0.5, 1.25, 0], abs=0.01)
        assert axis.mean(axis=0) == pytest.approx(anchor, abs=1e-6)
        assert abs(np.cross(axis[1] - axis[0], [0, 0, 1])).max() < 1e-6
        reach = np.linalg.norm(arc - anchor, axis=1)
        assert reach == pytest.approx(reach[0], rel=1e-5)
        ends = (arc[[0, -1]] - anchor) / reach[0]
        assert np.arccos(ends[0] @ ends[1]) == pytest.approx(1.5, abs=1e-3)


def test_forces_are_drawn_while_they_act(shown: Rows) -> None:
    arrows, gone = shown["/forces"]
    assert round(arrows["time"] * 60) == 41
    assert arrows["Arrows3D:labels"] == ["green", "green"]
    (at, middle), (push, knock) = arrows["Arrows3D:origins"], arrows["Arrows3D:vectors"]
    assert at == [4, 0.5, 0.5]
    assert middle == pytest.approx(seen[40]["green"][:3], abs=1e-6)
    assert push == pytest.approx([0, 0, 0.12])
    assert knock == pytest.approx([0.06, 0, 0]), "0.5 N s in a tick are 30 N"
    assert round(gone["time"] * 60) == 42
    assert not gone.get("Arrows3D:origins")


def test_contact_arrows_point_up_under_resting_cubes(shown: Rows) -> None:
    rows = [row for row in shown["/contacts"] if row.get("Arrows3D:origins")]
    assert rows
    at = np.array(rows[-1]["Arrows3D:origins"])
    vectors = np.array(rows[-1]["Arrows3D:vectors"])
    beneath = abs(at[:, 0] - seen[60]["green"][0]) < 0.6
    assert beneath.any()
    assert (vectors[beneath, 1] > 0).all()


def test_a_heavy_plain_cube_is_solid_coloured_and_not_hidden_by_its_contacts(
    environment: dict[str, str], tmp_path: Path
) -> None:
    def rest(world: World, client: int) -> None:
        send(world, client, type="spawn_cube", cube_name="rock", position=[0, 0.5, 0], mass=500)
        send(world, client, type="step", ticks=20)

    path = record(tmp_path / "rock.mcap", rest, {"backend": "mujoco"})
    run = view(environment, path, "--save", path.with_suffix(".rrd"))
    assert run.returncode == 0, run.stderr
    rows = read(path.with_suffix(".rrd"))
    first = rows["/rock/cubes"][0]
    assert first["Boxes3D:fill_mode"] == [3], "solid"
    color = f"{first['Boxes3D:colors'][0]:08x}"
    assert color[6:] == "ff" and len({color[i : i + 2] for i in (0, 2, 4)}) > 1, "not grey"
    arrows = np.concatenate([row["Arrows3D:vectors"] for row in rows["/rock/contacts"] if row.get("Arrows3D:vectors")])
    lengths = np.linalg.norm(arrows, axis=1)
    assert 0.5 < lengths.max() <= 0.6 + 1e-6


def test_messages_are_shown_at_their_time(shown: Rows) -> None:
    lines = [(round(row["time"] * 60), row["TextLog:level"][0], row["TextLog:text"][0]) for row in shown["/log"]]
    assert lines[0] == (0, "INFO", "client 1 joined")
    assert lines[1][2].startswith('client 1: spawn_cube cube_name="red" position=[0,0.5,0]')
    (refused,) = [line for line in lines if line[1] == "WARN"]
    assert refused[0] == 40
    assert "cube_not_found" in refused[2]
    steps = [frame for frame, level, text in lines if text == "client 1: step" and level == "TRACE"]
    assert steps == list(range(60))


def test_curves_have_a_value_for_every_tick(shown: Rows) -> None:
    rows = [row for row in shown["/plots/height\\ of\\ the\\ middle\\ \\(m\\)"] if "Scalars:scalars" in row]
    assert [round(row["time"] * 60) for row in rows] == list(range(1, 61))
    for row in rows:
        height = np.mean([state[1] for state in seen[round(row["time"] * 60)].values()])
        assert row["Scalars:scalars"][0] == pytest.approx(height)
    (reward,) = [row for row in shown["/plots/reward\\ of\\ client\\ 1"] if "Scalars:scalars" in row]
    assert round(reward["time"] * 60) == 60
    assert reward["Scalars:scalars"][0] == pytest.approx(seen[60]["green"][0] - 4.0, abs=1e-6)


def test_only_moved_cubes_are_sent_to_the_viewer(tmp_path: Path, environment: dict[str, str]) -> None:
    def wait_then_move(world: World, client: int) -> None:
        send(world, client, type="spawn_cube", cube_name="still", position=[0, 3, 0])
        send(world, client, type="step", ticks=60)
        send(world, client, type="set_cube_state", cube_name="still", linear_velocity=[1, 0, 0])
        send(world, client, type="step", ticks=20)

    path = record(tmp_path / "waits.mcap", wait_then_move, {"gravity": [0, 0, 0]})
    assert view(environment, path, "--save", tmp_path / "waits.rrd").returncode == 0
    times = [round(row["time"] * 60) for row in read(tmp_path / "waits.rrd")["/waits/cubes"]]
    assert times == [2, *range(62, 81, 2)]


def test_a_divergence_is_marked_at_its_tick(tmp_path: Path, environment: dict[str, str]) -> None:
    def fly(world: World, client: int) -> None:
        send(world, client, type="spawn_cube", position=[0, 9, 0])
        for _ in range(60):
            world.tick()

    good = 0

    def spoil(lines: list[Line]) -> list[Line]:
        nonlocal good
        at = next(i for i, line in enumerate(lines) if line.topic == "ticks")
        ticks = orjson.loads(lines[at].data)
        good = len(ticks["digests"]) - 1
        ticks["digests"][good] = "0" * 32
        return [*lines[:at], lines[at]._replace(data=orjson.dumps(ticks)), *lines[at + 1 :]]

    spoiled = rewrite(record(tmp_path / "sound.mcap", fly), tmp_path / "spoiled.mcap", spoil)
    run = view(environment, spoiled, "--save", tmp_path / "spoiled.rrd")
    assert "diverged" in run.stdout
    rows = read(tmp_path / "spoiled.rrd")
    (mark,) = rows["/spoiled/divergence"]
    assert good > 0
    assert round(mark["time"] * 60) == good, "the last tick that came out as it was recorded"
    assert mark["TextLog:level"] == ["ERROR"]
    assert len(rows["/spoiled/cubes"]) == 30, "what comes after it is shown all the same"


def test_two_recordings_stand_side_by_side_with_their_drift(tmp_path: Path, environment: dict[str, str]) -> None:
    def throw(speed: float) -> Any:
        def play(world: World, client: int) -> None:
            send(world, client, type="spawn_cube", cube_name="a", position=[0, 9, 0], linear_velocity=[speed, 0, 0])
            send(world, client, type="step", ticks=60)

        return play

    paths = [record(tmp_path / f"{name}.mcap", throw(speed)) for name, speed in (("slow", 1.0), ("fast", 3.0))]
    assert view(environment, *paths, "--save", tmp_path / "both.rrd").returncode == 0
    rows = read(tmp_path / "both.rrd")
    assert {"/slow/cubes", "/fast/cubes"} <= rows.keys()
    drift = {row["time"]: row["Scalars:scalars"][0] for row in rows["/drift/at\\ most\\ \\(m\\)"]}
    assert drift[1.0] == pytest.approx(2.0, abs=1e-6)
    assert drift[0.5] == pytest.approx(1.0, abs=1e-6)


def test_where_cubes_were_is_kept_only_to_be_compared(recording: Path) -> None:
    """And then that alone: what is kept grows with ticks and cubes."""
    source, stream = Recording(recording), load_rerun().RecordingStream("test")
    assert not show_recording(source, stream, "one").places
    kept = show_recording(source, stream, "one", keep_places=True).places
    assert [round(places.time * 60) for places in kept] == list(range(2, 61, 2))
    for places in kept:
        assert places.positions == pytest.approx(np.array([*seen[round(places.time * 60)].values()])[:, :3])
        assert owned(places.positions) == places.positions.nbytes
    assert all(owned(moment.poses) == moment.poses.nbytes for moment in moments(source))


def owned(array: np.ndarray[Any, Any]) -> int:
    """The bytes that an array keeps in memory, those of the array that it is a view of among them."""
    return array.nbytes if array.base is None else max(array.nbytes, owned(array.base))


def test_a_planar_world_is_drawn_in_the_plane(tmp_path: Path, environment: dict[str, str]) -> None:
    def play(world: World, client: int) -> None:
        send(world, client, type="spawn_cube", cube_name="a", position=[2, 5, 0], size=[1, 2, 1])
        send(world, client, type="step", ticks=2)

    path = record(tmp_path / "flat.mcap", play, {"backend": "pymunk", "gravity": [0, 0, 0]})
    assert view(environment, path, "--save", tmp_path / "flat.rrd").returncode == 0
    (outline,) = read(tmp_path / "flat.rrd")["/flat/cubes"]
    corners = {tuple(corner) for corner in outline["LineStrips2D:strips"][0]}
    assert corners == {(1.5, -4.0), (2.5, -4.0), (2.5, -6.0), (1.5, -6.0)}, "Rerun's y points downwards"


# -- live -------------------------------------------------------------------------------------------------------------


def watch_live(running: Served, environment: dict[str, str], saved: Path) -> subprocess.Popen[str]:
    """Starts a viewer of the world, and waits until it looks on."""
    clients = len(running.call(running.hosted.world.clients))
    command = [NMES, "view", f"127.0.0.1:{running.port}", "--save", str(saved)]
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def looks_on() -> bool:
        assert process.poll() is None, process.communicate()
        world = running.hosted.world
        return running.call(lambda: sum(client.subscription is not None for client in world._clients.values())) > 0

    until(lambda: len(running.call(running.hosted.world.clients)) > clients)
    until(looks_on)
    return process


def shapes_asked(metrics: Metrics) -> int:
    """How often clients have asked for a cube's shape."""
    lines = [line for line in metrics.page().decode().splitlines() if "get_cube_info" in line and "_total{" in line]
    return round(sum(float(line.split()[-1]) for line in lines))


def drive(
    running: Served, come: Callable[[], object] = lambda: None, seen: Callable[[int], None] = lambda cubes: None
) -> list[bytes]:
    """Does things to a world; returns its digests.

    Calls `come` in their midst, and `seen` with how many cubes a viewer should have seen by then.
    """
    digests = []
    with running.client() as client:
        client.spawn_cube(cube_name="a", position=[0, 9, 0], color=[1, 0, 0, 1], linear_velocity=[1, 0, 0])
        client.spawn_cube(cube_name="still", position=[5, 9, 0])
        client.freeze_cube("still", freeze=True)
        client.step(ticks=30)
        come()
        for tick in range(30):
            if tick == 10:
                client.spawn_cube(cube_name="b", position=[0, 20, 0], size=2)
            if tick == 20:
                client.despawn_cube("a")
            client.step()
            seen(3 if tick >= 11 else 0)  # every other tick is told
            digests.append(running.call(running.hosted.world.digest))
        client.reset()
        client.spawn_cube(cube_name="still", position=[0, 1, 0], size=3)
        client.step(ticks=10)
        seen(4)
        digests.append(running.call(running.hosted.world.digest))
    return digests


def test_a_late_viewer_sees_the_whole_live_world(tmp_path: Path, environment: dict[str, str]) -> None:
    viewers: list[subprocess.Popen[str]] = []

    metrics = Metrics()
    with served({}, metrics=metrics) as running:
        watched = drive(
            running,
            lambda: viewers.append(watch_live(running, environment, tmp_path / "live.rrd")),
            lambda cubes: until(lambda: running.call(lambda: shapes_asked(metrics)) >= cubes),
        )
    output, errors = viewers[0].communicate(timeout=PATIENCE)
    assert viewers[0].returncode == 0, errors
    assert "The world was closed" in output
    with served({}) as running:
        assert drive(running) == watched
    rows = read(tmp_path / "live.rrd")
    shapes = [row for row in rows["/main/cubes"] if "Boxes3D:half_sizes" in row]
    assert [row["Boxes3D:labels"] for row in shapes] == [
        ["a", "still"],
        ["a", "still", "b"],
        ["still", "b"],
        ["still"],
    ]
    assert shapes[0]["Boxes3D:half_sizes"] == [[0.5] * 3] * 2
    assert shapes[1]["Boxes3D:half_sizes"][2] == [1] * 3
    assert shapes[3]["Boxes3D:half_sizes"] == [[1.5] * 3], "the cube of the same name after the reset"
    assert shapes[3]["time"] > shapes[2]["time"], "time does not go back"
    assert f"{shapes[0]['Boxes3D:colors'][0]:08x}" == "ff0000ff"
    assert [row["TextLog:text"][0] for row in rows["/main/log"]] == ["the world was reset", "the world was closed"]


def test_a_fault_is_shown_at_its_tick(tmp_path: Path, environment: dict[str, str]) -> None:
    with served({"backend": "mujoco"}) as running, running.client() as client:
        name = client.spawn_cube(position=[0, 5, 0])["spawned"]
        process = watch_live(running, environment, tmp_path / "fault.rrd")
        client.step(ticks=4)
        client.apply_physics(name, force=[1e15, 0, 0])
        with pytest.raises(CommandFailed):
            client.step(ticks=60)
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, errors
    fault, closed = read(tmp_path / "fault.rrd")["/main/log"]
    assert fault["TextLog:level"] == ["ERROR"]
    assert name in fault["TextLog:text"][0]
    assert closed["TextLog:text"] == ["the world was closed"]


@pytest.mark.parametrize("lacking", ["batch", "get_joint_list"])
def test_a_server_without_joint_queries_is_shown_without_joints(
    tmp_path: Path, environment: dict[str, str], monkeypatch: pytest.MonkeyPatch, lacking: str
) -> None:
    def refuse(*_: object) -> NoReturn:
        raise WorldError("unsupported", "not here")

    monkeypatch.setitem(COMMANDS, lacking, refuse)
    metrics = Metrics()
    with served({}, metrics=metrics) as running, running.client() as client:
        for name in ("a", "b"):
            client.spawn_cube(cube_name=name, position=[0, 5, ord(name)])
        client.create_joint("a", "b", "fixed")
        process = watch_live(running, environment, tmp_path / "plain.rrd")
        client.step(ticks=4)
        until(lambda: running.call(lambda: shapes_asked(metrics)) >= 2)
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, errors
    rows = read(tmp_path / "plain.rrd")
    assert rows["/main/cubes"][0]["Boxes3D:labels"] == ["a", "b"]
    assert "/main/joints" not in rows


def test_a_killed_viewer_does_not_disturb_the_host(tmp_path: Path, environment: dict[str, str]) -> None:
    with served({}) as running:
        process = watch_live(running, environment, tmp_path / "killed.rrd")
        process.kill()
        process.communicate()
        until(lambda: not running.call(running.hosted.world.clients))
        assert len(drive(running)) == 31


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a window opens")
def test_serve_view_shows_the_world_and_ends_with_the_host(environment: dict[str, str]) -> None:
    bare = {name: value for name, value in environment.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    command = [NMES, "serve", "--port", "0", "--no-record", "--mode", "lockstep", "--view", "--json"]
    host = subprocess.Popen(command, env=bare, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert host.stdout is not None and host.stderr is not None
    try:
        port = json.loads(host.stdout.readline())["port"]
        address = next(line for line in host.stderr if line.startswith("Look at ")).split()[2]
        with Client(port=port, password=PASSWORD) as client:
            until(lambda: client.get_world_info()["counts"]["clients"] == 2)
        with urllib.request.urlopen(address) as page:
            assert b"Rerun" in page.read()
    finally:
        host.send_signal(signal.SIGINT)
        rest = host.communicate(timeout=PATIENCE)
    assert host.returncode == 0, rest
    with pytest.raises(URLError):
        urllib.request.urlopen(address)


# -- Rerun's programs ------------------------------------------------------------------------------------------------


def listening(group: int) -> set[str]:
    """The addresses, as the kernel writes them in hexadecimal, on which processes of a group listen."""
    inodes = set()
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if os.getpgid(int(folder.name)) == group:
                inodes |= {os.readlink(link) for link in (folder / "fd").iterdir()}
        except (ProcessLookupError, FileNotFoundError, PermissionError):
            continue
    addresses = set()
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in Path(table).read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == "0A" and f"socket:[{fields[9]}]" in inodes:
                addresses.add(fields[1].split(":")[0])
    return addresses


@pytest.fixture
def browsable(recording: Path, environment: dict[str, str]) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A viewer for browsers that is up, and its address."""
    process = subprocess.Popen(
        [NMES, "view", str(recording), "--web"],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert process.stdout is not None
    try:
        address = process.stdout.readline().removeprefix("Look at ").strip()
        for line in process.stdout:
            if line.startswith("Ctrl-C"):
                break
        yield process, address
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=PATIENCE)


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_rerun_listens_on_this_machine_alone_and_ends_with_the_command(
    browsable: tuple[subprocess.Popen[str], str],
) -> None:
    process, address = browsable
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    (group,) = {os.getpgid(int(child)) for child in children}
    assert address.startswith("http://127.0.0.1:")
    assert listening(group) == {"0100007F"}
    process.send_signal(signal.SIGINT)
    process.wait(PATIENCE)
    assert process.returncode == 0
    assert listening(group) == set()


def test_a_browser_shows_coloured_cubes(browsable: tuple[subprocess.Popen[str], str], tmp_path: Path) -> None:
    playwright = pytest.importorskip("playwright.sync_api", reason="no browser to look with: Playwright is missing")
    chromium = next(filter(None, map(shutil.which, BROWSERS)), None)
    if chromium is None:
        pytest.skip("no browser to look with: Chromium is missing")
    options = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-gpu-sandbox"]
    with playwright.sync_playwright() as running:
        browser = running.chromium.launch(executable_path=chromium, args=options)
        page = browser.new_page(viewport={"width": 640, "height": 480})
        page.goto(f"{browsable[1]}&renderer=webgl")
        until_time = time.monotonic() + 2 * PATIENCE
        while True:
            page.screenshot(path=tmp_path / "seen.png")
            shown_colors = colors(np.asarray(Image.open(tmp_path / "seen.png").convert("RGB"), int))
            if shown_colors == {"red", "green", "blue"} or time.monotonic() > until_time:
                break
            page.wait_for_timeout(500)
        browser.close()
    assert shown_colors == {"red", "green", "blue"}


def colors(pixels: np.ndarray[Any, np.dtype[Any]]) -> set[str]:
    """The colours of which there is an area: the view of the world is the upper left part of the window."""
    area = pixels[40:320, :440]
    names = set()
    for channel, name in enumerate(("red", "green", "blue")):
        others = [other for other in range(3) if other != channel]
        if (area[..., channel] - area[..., others].max(axis=2) > 25).sum() > 50:
            names.add(name)
    return names


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_a_viewer_that_ends_too_early_is_told_as_such(browsable: tuple[subprocess.Popen[str], str]) -> None:
    process, _ = browsable
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    (group,) = {os.getpgid(int(child)) for child in children}
    os.killpg(group, signal.SIGKILL)
    output, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    assert "Traceback" not in output and output.splitlines()[-1].startswith("Error: Rerun has ended")


def test_a_viewer_that_does_not_start_is_told_as_such(recording: Path, environment: dict[str, str]) -> None:
    failing = shutil.which("false")
    assert failing is not None
    run = view({**environment, "RERUN_CLI_PATH": failing}, recording, "--web")
    assert run.returncode == 1 and "Look at" not in run.stdout
    assert run.stderr.startswith("Error: Rerun does not begin to listen on 127.0.0.1:")


def test_a_port_that_another_listens_on_is_refused(recording: Path, environment: dict[str, str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        run = view(environment, recording, "--web", "--port", str(port))
    assert (run.returncode, run.stdout) == (1, "")
    assert run.stderr == f"Error: cannot listen on 127.0.0.1:{port}: {os.strerror(errno.EADDRINUSE)}\n"


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_a_window_that_does_not_come_up_is_not_left_running(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def left() -> list[str]:
        """The processes that have the path of the program below in their environment."""
        found = []
        for folder in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):
                if folder.name != str(os.getpid()) and os.fsencode(program) in (folder / "environ").read_bytes():
                    found.append(folder.name)
        return found

    program = tmp_path / "rerun"
    program.write_text("#!/bin/sh\nexec sleep 600\n")
    program.chmod(0o755)
    monkeypatch.setenv("RERUN_CLI_PATH", str(program))
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("nmes.view.screen._LISTENS", 0.0)
    with pytest.raises(MachineError, match="does not begin to listen"), screen("nothing"):
        pass
    until(lambda: not left())


def test_without_a_display_the_error_says_what_to_do(recording: Path, environment: dict[str, str]) -> None:
    bare = {name: value for name, value in environment.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    run = view(bare, recording)
    assert run.returncode == 1
    assert "no display" in run.stderr
    assert "--web" in run.stderr


def test_without_rerun_the_error_names_the_extra(recording: Path, tmp_path: Path, environment: dict[str, str]) -> None:
    (tmp_path / "rerun.py").write_text("raise ImportError('it is not here')\n")
    run = view({**environment, "PYTHONPATH": str(tmp_path)}, recording, "--web")
    assert run.returncode == 1
    assert "pip install 'nmes[view]'" in run.stderr
    assert "Traceback" not in run.stderr


def test_an_unreachable_world_is_named_in_the_error(environment: dict[str, str], tmp_path: Path) -> None:
    run = view(environment, "127.0.0.1:1", "--save", tmp_path / "x.rrd")
    assert run.returncode == 1
    assert "cannot connect to 127.0.0.1:1" in run.stderr
