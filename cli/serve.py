"""`nmes serve`: host a world over TCP until told to stop."""

from __future__ import annotations

import asyncio
import base64
import ipaddress
import json
import logging
import os
import secrets
import signal
from pathlib import Path
from typing import Any

import click

from nmes.errors import RejectedMessage
from nmes.server import Host

PASSWORD_VARIABLE = "NMES_PASSWORD"


@click.command("serve", short_help="Host a world that clients drive over TCP.")
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on.")
@click.option(
    "--port",
    default=14000,
    show_default=True,
    type=click.IntRange(0, 65535),
    help="Port to listen on; 0 finds a free one.",
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
@click.option("--password", help=f"Password that clients must give; better in the variable {PASSWORD_VARIABLE}.")
@click.option(
    "--password-file",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="File whose first line is the password.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object when ready, for scripts.")
def command(
    host: str,
    port: int,
    backend: str | None,
    config_file: Path | None,
    seed: int | None,
    mode: str | None,
    rate: float | None,
    record_to: Path,
    no_record: bool,
    password: str | None,
    password_file: Path | None,
    as_json: bool,
) -> None:
    """Host a world that clients drive over TCP.

    The world is recorded to a new file. Ctrl-C or SIGTERM closes the recording and ends with status 0. Without a
    password one is made up and printed, which is allowed only on an address of this machine alone.
    """
    config = _read_config(config_file) if config_file is not None else {}
    config |= {
        key: value
        for key, value in {"backend": backend, "seed": seed, "mode": mode, "rate": rate}.items()
        if value is not None
    }
    password, source = _choose_password(password, password_file)
    if source == "generated" and not _is_local(host):
        raise click.UsageError(
            f"{host} can be reached from elsewhere: give a password, in {PASSWORD_VARIABLE} or with --password-file"
        )
    logging.basicConfig(format="%(asctime)s %(levelname)s %(name)s: %(message)s", level=logging.INFO)
    _raise_open_files_limit()
    asyncio.run(_serve(config, host, port, password, source, None if no_record else record_to, as_json))


async def _serve(
    config: dict[str, Any], host: str, port: int, password: str, source: str, record_to: Path | None, as_json: bool
) -> None:
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    async with Host(password, record_to=record_to) as server:
        try:
            hosted = server.add(config)
        except RejectedMessage as error:
            raise click.UsageError(f"world config: {error.message}") from error
        address, port = await server.listen(host, port)
        world = hosted.world
        if as_json:
            ready = {
                "host": address,
                "port": port,
                "password_source": source,
                "world": hosted.name,
                "backend": world.backend.name,
                "mode": world.mode,
                "rate": world.rate,
                "seed": world.seed,
                "recording": None if hosted.recording is None else str(hosted.recording),
            }
            if source == "generated":
                ready["password"] = password
            click.echo(json.dumps(ready))
        else:
            pace = f"{world.mode} x {world.rate:g}" if world.mode == "realtime" else world.mode
            click.echo(
                f"World {hosted.name!r}: {world.backend.name} {world.backend.version()}, {pace}, seed {world.seed}"
            )
            click.echo(f"Listening on {address}:{port}")
            if source == "generated":
                click.echo(f"Password: {password}  (made up for this run)")
            else:
                click.echo(f"Password: given by {source}")
            click.echo(f"Recording to {hosted.recording}" if hosted.recording else "Not recording")
            click.echo("Ctrl-C stops")
        await stop.wait()
    if not as_json:
        click.echo(f"Stopped at frame {world.frame}")


def _read_config(path: Path) -> dict[str, Any]:
    try:
        config = json.loads(path.read_bytes())
    except (OSError, ValueError) as error:
        raise click.UsageError(f"{path}: {error}") from error
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


def _choose_password(given: str | None, file: Path | None) -> tuple[str, str]:
    """Returns the password and where it is from; the most explicit source wins."""
    if given is not None and file is not None:
        raise click.UsageError("give --password or --password-file, not both")
    if given is not None:
        password, source = given, "option"
    elif file is not None:
        try:
            lines = file.read_text("utf-8").splitlines()
        except (OSError, ValueError) as error:
            raise click.UsageError(f"{file}: {error}") from error
        password, source = (lines[0] if lines else ""), "file"
    elif PASSWORD_VARIABLE in os.environ:
        password, source = os.environ[PASSWORD_VARIABLE], "environment"
    else:
        return secrets.token_urlsafe(12), "generated"
    if not password:
        raise click.UsageError(f"the password given by {source} is empty")
    return password, source


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
