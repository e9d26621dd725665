"""`nmes serve`: host one world or many over TCP until told to stop."""

from __future__ import annotations

import asyncio
import base64
import ipaddress
import json
import os
import secrets
import signal
import ssl
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import click

from nmes.cli import _logs
from nmes.cli._password import PASSWORD_VARIABLE, choose_password, password_options
from nmes.cli.info import open_recording
from nmes.errors import RejectedMessage, WorldError
from nmes.protocol import parse_json
from nmes.recording import Recording
from nmes.server import Host
from nmes.server.metrics import Metrics
from nmes.view.screen import has_display
from nmes.world import World

MOST_WORLDS = 1000
VIEWER_ENDS = 10.0  # s that it has
KEYFRAMES = 10.0  # s of a world's time


class _Worlds(click.ParamType["int | list[str]"]):
    """A number of worlds, or their names."""

    name = "N|NAMES"

    def convert(self, value: Any, parameter: click.Parameter | None, context: click.Context | None) -> int | list[str]:
        if not isinstance(value, str):
            return value  # type: ignore[no-any-return]
        if not value.isdecimal():
            return value.split(",")
        if not 1 <= int(value) <= MOST_WORLDS:
            self.fail(f"a number of worlds is from 1 to {MOST_WORLDS}", parameter, context)
        return int(value)


def _open_parent(context: click.Context, parameter: click.Parameter, value: str | None) -> Recording | None:
    return None if value is None else open_recording(context, parameter, value)


@click.command("serve", short_help="Host worlds that clients drive over TCP.")
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on.")
@click.option(
    "--port",
    default=14000,
    show_default=True,
    type=click.IntRange(0, 65535),
    help="Port to listen on; 0 finds a free one.",
)
@click.option(
    "--worlds",
    type=_Worlds(),
    help="Number of worlds, one port each; or their names, separated by commas, on one port.",
)
@click.option(
    "--port-step", type=click.IntRange(1, 65535), help="From the port of one world to that of the next.  [default: 1]"
)
@click.option("--backend", help="Physics engine.  [default: mujoco]")
@click.option(
    "--config",
    "config_file",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="World config, a JSON file; the other options win over it.",
)
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), help="Seed of all that the world draws.  [default: 0]")
@click.option(
    "--mode", type=click.Choice(["realtime", "lockstep", "fast"]), help="What makes it tick.  [default: realtime]"
)
@click.option("--rate", type=float, help="How many times faster than real time `realtime` is.  [default: 1]")
@click.option(
    "--record",
    "record_to",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("recordings"),
    show_default=True,
    help="Directory for the recording.",
)
@click.option("--no-record", is_flag=True, help="Record nothing.")
@click.option(
    "--flush-interval",
    type=click.FloatRange(0, 3600),
    default=1.0,
    show_default=True,
    help="Seconds of the recording that a crash may lose; with 0 nothing is told before it is on disk.",
)
@click.option(
    "--keyframes",
    type=click.FloatRange(0, 86400),
    help="Seconds of a world's time after which it saves itself, so that recordings can be replayed or resumed from "
    "there; 0 for never.  [default: 10]",
)
@click.option(
    "--resume",
    metavar="FILE",
    callback=_open_parent,
    help="Go on from a recording, in a new one; its world is what its own config says.",
)
@click.option("--at", "frame", type=click.IntRange(0), help="With --resume: from this frame.  [default: the last]")
@password_options(f"Password that clients must give; better in the variable {PASSWORD_VARIABLE}.")
@click.option(
    "--tls-cert",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="Speak TLS, with the certificate in this PEM file.",
)
@click.option(
    "--tls-key",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="The certificate's private key, a PEM file.",
)
@click.option(
    "--log-format", type=click.Choice(["text", "json"]), default="text", show_default=True, help="How logs are written."
)
@click.option(
    "--metrics-port",
    type=click.IntRange(0, 65535),
    help="Port on this machine that tells Prometheus what the host does; 0 finds a free one.",
)
@click.option("--view", is_flag=True, help="Look at the world, as `nmes view` does: in a window, or else in a browser.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object when ready, for scripts.")
def command(
    host: str,
    port: int,
    worlds: int | list[str] | None,
    port_step: int | None,
    backend: str | None,
    config_file: Path | None,
    seed: int | None,
    mode: str | None,
    rate: float | None,
    record_to: Path,
    no_record: bool,
    flush_interval: float,
    keyframes: float | None,
    resume: Recording | None,
    frame: int | None,
    password: str | None,
    password_file: Path | None,
    tls_cert: Path | None,
    tls_key: Path | None,
    log_format: str,
    metrics_port: int | None,
    view: bool,
    as_json: bool,
) -> None:
    """Host a world that clients drive over TCP, or many.

    Each world is recorded to a new file. With --resume it goes on from where a recording ends, or from any frame of it;
    those who were in it then have left. Ctrl-C or SIGTERM closes the recording and ends with status 0. Without a
    password one is made up and printed, which is allowed only on an address of this machine alone.

    For example:

    \b
        nmes serve --mode lockstep --seed 7 --password-file secret
        nmes serve --worlds 20 --port 14000 --port-step 3
        nmes serve --resume recordings/main-20260101-120000.mcap --at 3600
    """
    given = {"backend": backend, "seed": seed, "mode": mode, "rate": rate, "keyframes": keyframes}
    given = {key: value for key, value in given.items() if value is not None}
    if resume is not None:
        other = [*given, *(["config"] if config_file is not None else []), *(["worlds"] if worlds is not None else [])]
        if other:
            raise click.UsageError(f"--{other[0]} does not go with --resume: the recording says what its world is")
        config = resume.config
    else:
        if frame is not None:
            raise click.UsageError("--at says from where to --resume")
        config = {"keyframes": KEYFRAMES, **(_read_config(config_file) if config_file is not None else {}), **given}
    password, source = choose_password(password, password_file) or (secrets.token_urlsafe(12), "generated")
    if source == "generated" and not _is_local(host):
        raise click.UsageError(
            f"{host} can be reached from elsewhere: give a password, in {PASSWORD_VARIABLE} or with --password-file"
        )
    _logs.set_up(log_format)
    _raise_open_files_limit()
    names, ports = _lay_out(worlds, config.get("name", "main"), port, port_step)
    metrics = None if metrics_port is None else Metrics()
    server = Host(
        password,
        record_to=None if no_record else record_to,
        flush_interval=flush_interval,
        tls=_load_tls(tls_cert, tls_key),
        metrics=metrics,
    )
    parent = None if resume is None else (resume, frame)
    with ExitStack() as after:  # a viewer sees the world's end

        def look(address: str, port: int) -> None:
            if view:
                after.enter_context(_viewer(address, port, password, tls_cert, as_json))

        asyncio.run(_serve(server, config, parent, names, host, ports, password, source, metrics_port, as_json, look))


async def _serve(
    server: Host,
    config: dict[str, Any],
    parent: tuple[Recording, int | None] | None,
    worlds: list[str],
    host: str,
    ports: list[int],
    password: str,
    source: str,
    metrics_port: int | None,
    as_json: bool,
    look: Callable[[str, int], None],
) -> None:
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    async with server:
        try:
            if worlds:
                for name in worlds:
                    server.offer({**config, "name": name})
                # They are created when first used, but what is wrong with them is told now.
                sample = World({**config, "name": worlds[0]})
                sample.close()
            else:
                sample = (server.add(config) if parent is None else server.resume(*parent)).world
        except RejectedMessage as error:
            raise click.UsageError(f"world config: {error.message}") from error
        except WorldError as error:
            raise click.UsageError(error.message) from error
        resumed = sample.ticks
        listening = []
        for index, port in enumerate(ports):
            address, port = await server.listen(host, port, worlds[index] if len(ports) > 1 else None)
            listening.append(port)
        if metrics_port is not None:
            metrics_port = await server.serve_metrics("127.0.0.1", metrics_port)
        about = {"backend": sample.backend.name, "mode": sample.mode, "rate": sample.rate, "seed": sample.seed}
        if worlds:
            # One port each, or all on one.
            where = dict(zip(worlds, listening * (len(worlds) // len(listening)), strict=True))
            ready: dict[str, Any] = {
                "worlds": [{"world": name, "port": port} for name, port in where.items()],
                **about,
                "recordings": None if server.record_to is None else str(server.record_to),
            }
            named = [f"World {name!r} on {address}:{port}" for name, port in where.items()]
            recording = None if server.record_to is None else f"{server.record_to}, a file for each world"
        else:
            (hosted,) = server.worlds.values()
            recording = None if hosted.recording is None else str(hosted.recording)
            ready = {"world": hosted.name, **about, "recording": recording}
            if parent is not None:
                ready["resumed"] = {"file": str(parent[0].path), "frame": resumed}
            named = [f"World {hosted.name!r}"]
        if as_json:
            ready = {"host": address, "port": listening[0], "password_source": source, **ready}
            if metrics_port is not None:
                ready["metrics_port"] = metrics_port
            if source == "generated":
                ready["password"] = password
            click.echo(json.dumps(ready))
        else:
            pace = f"{sample.mode} x {sample.rate:g}" if sample.mode == "realtime" else sample.mode
            for name in named:
                click.echo(f"{name}: {sample.backend.name} {sample.backend.version()}, {pace}, seed {sample.seed}")
            if not worlds:
                click.echo(f"Listening on {address}:{listening[0]}")
            if source == "generated":
                click.echo(f"Password: {password}  (made up for this run)")
            else:
                click.echo(f"Password: given by {source}")
            if metrics_port is not None:
                click.echo(f"Metrics on http://127.0.0.1:{metrics_port}/metrics")
            if parent is not None:
                click.echo(f"Going on from frame {resumed:,} of {parent[0].path}")
            click.echo(f"Recording to {recording}" if recording else "Not recording")
            click.echo("Ctrl-C stops")
        look(address, listening[0])
        await stop.wait()
    if not as_json:
        for hosted in server.worlds.values():
            name = f"World {hosted.name!r} stopped" if worlds else "Stopped"
            click.echo(f"{name} at frame {hosted.world.frame}")


@contextmanager
def _viewer(address: str, port: int, password: str, tls_cert: Path | None, as_json: bool) -> Iterator[None]:
    """Runs `nmes view` of a host here, as a program of its own so that it takes nothing from the worlds' threads."""
    here = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(address, address)
    where = f"[{here}]:{port}" if ":" in here else f"{here}:{port}"
    options = [] if has_display() else ["--web"]
    if tls_cert is not None:
        options += ["--tls-ca", str(tls_cert)]
    # A session of its own: Ctrl-C is for the host, which then ends the viewer, once.
    process = subprocess.Popen(
        [sys.executable, "-c", "from nmes.cli import main; main()", "view", where, *options],
        env={**os.environ, PASSWORD_VARIABLE: password},
        stdout=sys.stderr.fileno() if as_json else None,
        start_new_session=True,
    )
    try:
        yield
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(VIEWER_ENDS)
        except subprocess.TimeoutExpired:
            process.kill()


def _lay_out(worlds: int | list[str] | None, name: str, port: int, step: int | None) -> tuple[list[str], list[int]]:
    """Returns the names of the worlds, none where there is just one, and the ports."""
    if not isinstance(worlds, int):
        if step is not None:
            raise click.UsageError("--port-step goes with a number of worlds")
        return worlds or [], [port]
    names = [f"{name}-{number}" for number in range(1, worlds + 1)]
    if port == 0:
        return names, [0] * worlds
    ports = [port + number * (step or 1) for number in range(worlds)]
    if ports[-1] > 65535:
        raise click.UsageError(f"{worlds} worlds from port {port} on reach beyond port 65535")
    return names, ports


def _read_config(path: Path) -> dict[str, Any]:
    try:
        config = parse_json(path.read_bytes())
    except OSError as error:
        raise click.UsageError(f"cannot read {path}: {error.strerror}") from error
    except RejectedMessage as error:
        raise click.UsageError(f"{path}: {error.message}") from error
    if not isinstance(config, dict):
        raise click.UsageError(f"{path}: a world config is a JSON object, not {type(config).__name__}")
    _embed_image(config, path)
    return config


def _embed_image(config: dict[str, Any], path: Path) -> None:
    """Replaces the `image_file` of a landscape, beside the config's own file, by the image itself.

    A world reads no file, and a recording must hold all that the world was made of.
    """
    scene = config.get("scene")
    landscape = scene.get("heightfield") if isinstance(scene, dict) else None
    if isinstance(landscape, dict) and isinstance(landscape.get("image_file"), str):
        image = path.parent / landscape.pop("image_file")
        try:
            landscape["image"] = base64.b64encode(image.read_bytes()).decode()
        except OSError as error:
            raise click.UsageError(f"{path}: scene/heightfield/image_file: {error}") from error


def _load_tls(cert: Path | None, key: Path | None) -> ssl.SSLContext | None:
    if cert is None and key is None:
        return None
    if cert is None or key is None:
        raise click.UsageError("--tls-cert and --tls-key go together")
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        context.load_cert_chain(cert, key, password="")  # a key under a passphrase is refused, not asked about
    except (OSError, ValueError) as error:
        raise click.UsageError(f"cannot use {cert} with {key}: {error}") from error
    return context


def _is_local(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _raise_open_files_limit() -> None:
    """Makes room for as many sockets as the system allows: a usual soft limit of 1,024 is too few for 1,024 clients."""
    try:
        import resource
    except ImportError:  # Windows has no such limit
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = 4096 if hard == resource.RLIM_INFINITY else min(4096, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
