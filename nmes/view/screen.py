"""The screen of Rerun: a window, a browser, or a file for later.

It hides how Rerun's programs are started and ended, and how worlds, curves and log are laid out. The programs listen on
this machine's own address unless the caller asks for another.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from math import cos, radians, sin
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import quote

import numpy as np

from nmes.backend import Array
from nmes.errors import MachineError
from nmes.server.door import cannot_listen
from nmes.view.canvas import Canvas, load_rerun

if TYPE_CHECKING:
    import rerun as rr

__all__ = ["LOCAL", "Screen", "has_display", "lay_out", "screen"]

LOCAL = "127.0.0.1"
_LISTENS = 30.0  # s that Rerun has to begin to listen, or to end
_BEGINS = 64 << 10  # bytes: more than Rerun writes before it says that it can
_ENDS = b"RRF2FOOT\x01\0\0\0"  # how a whole file of Rerun ends
_WRITES = 600.0  # s that it has to write what waits: on a full disk it may wait for ever
_ELEVATION, _AZIMUTH = radians(20.0), radians(30.0)  # of the eye
_AWAY = 2.2  # radii of the scene: how far the eye is
_NEAREST, _NOTHING = 1.0, 4.0  # m: the smallest radius, and that of a world without cubes
_GRID = (128, 128, 128, 90)
_SHOWN = ["$origin/scene/**", "$origin/cubes", "$origin/joints", "$origin/contacts", "$origin/forces"]


def lay_out(stream: rr.RecordingStream, worlds: Mapping[str, Canvas], live: bool) -> None:
    """Arranges the views: the worlds side by side, curves below them, the log at their right.

    Args:
        stream: The Rerun stream.
        worlds: The worlds by name. The eye of each is where all cubes that have been drawn so far can be seen.
        live: True for a world that goes on, which has no curves; False for recordings, with a time line.
    """
    rrb = load_rerun().blueprint
    views = [_planar_view(name, world) if world.planar else _view(name, world) for name, world in worlds.items()]
    scenes = rrb.Horizontal(*views)
    if not live:
        # One view a curve, as their units are not the same; of all worlds together.
        names = dict.fromkeys(name for world in worlds.values() for name in world.curves)
        curves = [
            rrb.TimeSeriesView(
                origin="/", contents=[w.curves[name] for w in worlds.values() if name in w.curves], name=name
            )
            for name in names
        ]
        if len(worlds) > 1:
            curves.append(rrb.TimeSeriesView(origin="/drift", name="drift"))
        scenes = rrb.Vertical(scenes, rrb.Horizontal(*curves), row_shares=[3, 1])
    columns = rrb.archetypes.TextLogColumns(
        timeline_columns=[rrb.encodings.TimelineColumn("time")],
        text_log_columns=[
            rrb.encodings.TextLogColumn("EntityPath", visible=len(worlds) > 1),
            rrb.encodings.TextLogColumn("LogLevel", visible=False),
            rrb.encodings.TextLogColumn("Body"),
        ],
    )
    log = rrb.TextLogView(
        origin="/",
        contents=[f"/{world.entity}/{log}" for world in worlds.values() for log in ("log", "divergence")],
        name="what was said",
        columns=columns,
        rows=rrb.archetypes.TextLogRows(filter_by_log_level=["INFO", "WARN", "ERROR"]),
    )
    time_panel = rrb.TimePanel(timeline="time", play_state="following" if live else "playing", state="collapsed")
    panels = rrb.BlueprintPanel(state="collapsed"), rrb.SelectionPanel(state="collapsed"), time_panel
    stream.send_blueprint(rrb.Blueprint(rrb.Horizontal(scenes, log, column_shares=[4, 1]), *panels))


def _view(name: str, world: Canvas) -> Any:
    rr, rrb = load_rerun(), load_rerun().blueprint
    middle, radius = _ball(world)
    up, aside = sin(_ELEVATION), cos(_ELEVATION)
    direction = np.array([aside * sin(_AZIMUTH), up, aside * cos(_AZIMUTH)])
    eye = rrb.EyeControls3D(
        position=middle + _AWAY * radius * direction,
        look_target=middle,
        eye_up=(0.0, 1.0, 0.0),
        tracking_entity=f"{world.entity}/cubes",
    )
    grid = rrb.LineGrid3D(plane=rr.components.Plane3D([0.0, 1.0, 0.0], 0.0), color=_GRID)
    return rrb.Spatial3DView(origin=world.entity, contents=_SHOWN, name=name, line_grid=grid, eye_controls=eye)


def _planar_view(name: str, world: Canvas) -> Any:
    rrb = load_rerun().blueprint
    (x, y, _), radius = _ball(world)
    bounds = rrb.VisualBounds2D(x_range=(x - radius, x + radius), y_range=(-y - radius, -y + radius))
    return rrb.Spatial2DView(origin=world.entity, contents=_SHOWN, name=name, visual_bounds=bounds)


def _ball(world: Canvas) -> tuple[Array, float]:
    """Returns the middle of a world's cubes, array (3,), and the radius of a ball round them, m."""
    if world.extent is None:
        return np.array([0.0, 1.0, 0.0]), _NOTHING
    low, high = world.extent
    return (low + high) / 2.0, max(float(np.linalg.norm(high - low)) / 2.0, _NEAREST)


def has_display() -> bool:
    """Whether windows can be opened on this machine."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


class Screen(NamedTuple):
    """A Rerun stream and the program that shows it.

    Attributes:
        stream: The stream to draw to.
        address: The address for a browser; None where none is served.
        process: Rerun's program; None where none was started.
    """

    stream: rr.RecordingStream
    address: str | None = None
    process: subprocess.Popen[bytes] | None = None

    def wait(self) -> None:
        """Waits until Rerun's program has ended."""
        if self.process is not None:
            self.process.wait()


@contextmanager
def screen(
    name: str, *, web: bool = False, save: Path | None = None, host: str = LOCAL, port: int = 0
) -> Iterator[Screen]:
    """Opens Rerun's window, its viewer for browsers, or a file for later, and gives a stream to it.

    A window stays open; the viewer for browsers ends with the context.

    Args:
        name: The name that Rerun shows.
        web: Whether to serve a viewer for browsers, in place of a window.
        save: The file (`.rrd`) to write, in place of a window.
        host: The address that Rerun listens on.
        port: The TCP port of the viewer for browsers; 0 for any that is free.

    Raises:
        MissingPackage: Rerun is not installed.
        OSError: The file cannot be written, as on a full disk.
        MachineError: There is no display for a window (`no_display`), Rerun does not begin to listen or ends too early
            (`no_viewer`), or the address is taken or not of this machine (`cannot_listen`).
    """
    stream = load_rerun().RecordingStream("nmes", send_properties=False)
    stream.send_recording_name(name)
    if save is not None:
        with _written(stream, save):
            yield Screen(stream)
        return
    if not web and not has_display():
        message = "there is no display for a window: use --web for a browser, or --save for a file"
        raise MachineError("no_display", message)
    grpc, http = _free_port(host), _free_port(host, port)
    options = ["--serve-web", "--web-viewer-port", str(http)] if web else ["--expect-data-soon"]
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "rerun_cli", "--bind", host, "--port", str(grpc), *options],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        stdin=subprocess.DEVNULL,
        start_new_session=True,
    )
    ends = True  # with the context
    try:
        _await(process, host, [grpc, http] if web else [grpc])
        ends = web
        reached = f"rerun+http://{host}:{grpc}/proxy"
        stream.connect_grpc(reached)
        address = f"http://{host}:{http}/?url={quote(reached, safe='')}" if web else None
        yield Screen(stream, address, process)
        _flush(stream, process if web else None)
    finally:
        stream.disconnect()
        if ends:
            # The program is a child of the one that was started, so that only its port tells when it is gone.
            with suppress(ProcessLookupError):  # it ended by itself
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            _await_end(host, http)


@contextmanager
def _written(stream: rr.RecordingStream, path: Path) -> Iterator[None]:
    """Writes a stream to a file, which is whole at the end of the context.

    Raises:
        OSError: The file cannot be written.
    """
    if path.is_file():
        path.write_bytes(bytes(_BEGINS))  # where there is no room for it, Rerun would wait for ever
    try:
        stream.save(str(path))
        yield
        stream.flush(timeout_sec=_WRITES)
    except RuntimeError as error:  # what Rerun raises, of whatever its writer's thread met
        raise OSError(f"Rerun cannot go on writing: {error}") from error
    finally:
        stream.disconnect()
    if path.is_file():
        _check_end(path)


def _check_end(path: Path) -> None:
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - len(_ENDS)))
        if file.read() != _ENDS:  # it tells of nothing that fails at the end
            raise OSError("Rerun wrote no end: is the disk full?")


def _flush(stream: rr.RecordingStream, served: subprocess.Popen[bytes] | None) -> None:
    """Sends all that waits; `served` is the program that shows it to browsers, which must be there still.

    Raises:
        MachineError: `no_viewer`.
    """
    message = "Rerun has ended, or takes nothing more: what it was to show is not all there"
    try:
        stream.flush()
    except RuntimeError as error:  # what Rerun raises
        raise MachineError("no_viewer", message) from error
    if served is not None and served.poll() is not None:
        raise MachineError("no_viewer", message)


def _free_port(host: str, port: int = 0) -> int:
    """Returns a port on which nobody listens: the one that is asked for, or any for 0.

    Raises:
        MachineError: `cannot_listen`.
    """
    try:
        with socket.create_server((host, port)) as server:
            return int(server.getsockname()[1])
    except OSError as error:
        raise cannot_listen(host, port, error) from error


def _await_end(host: str, port: int) -> None:
    until = time.monotonic() + _LISTENS
    while time.monotonic() < until:
        try:
            socket.create_connection((host, port), timeout=1.0).close()
        except OSError:
            return
        time.sleep(0.01)


def _await(process: subprocess.Popen[bytes], host: str, ports: Sequence[int]) -> None:
    until = time.monotonic() + _LISTENS
    for port in ports:
        while True:
            try:
                socket.create_connection((host, port), timeout=1.0).close()
                break
            except OSError as error:
                if process.poll() is not None or time.monotonic() > until:
                    raise MachineError("no_viewer", f"Rerun does not begin to listen on {host}:{port}") from error
                time.sleep(0.05)
    if process.poll() is not None:  # whoever listens there is another
        raise MachineError("no_viewer", f"Rerun ended when it began to listen on {host}:{ports[-1]}")
