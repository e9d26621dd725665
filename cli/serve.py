"""`nmes serve`: host one world or many over TCP until told to stop."""

from __future__ import annotations

import asyncio
import errno
import gc
import json
import logging
import os
import re
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import AsyncExitStack, ExitStack, contextmanager
from pathlib import Path
from typing import Any

import click

from nmes.cli import _logs
from nmes.cli._options import MOMENT, FiniteRange
from nmes.cli._password import PASSWORD_VARIABLE, password_options
from nmes.cli._serve_process import COLLECTIONS, SWITCH, raise_open_files_limit
from nmes.cli._serve_report import Running, ready_lines, ready_object, stopped_lines
from nmes.cli._serve_settings import DIALECTS, MADE_UP, MANY_WORLDS, MOST_WORKERS, MOST_WORLDS, Settings, read_settings
from nmes.cli._serve_worker import command_of_worker
from nmes.cli._viewer import viewer
from nmes.cli.info import open_recording
from nmes.errors import MachineError, RejectedMessage, WorldError
from nmes.fleet.agones import Sidecar
from nmes.fleet.supervisor import Supervisor
from nmes.recording import Recording
from nmes.server import Host
from nmes.server.access_log import AccessLog
from nmes.server.catalog import Catalog
from nmes.server.kept_worlds import maker_of
from nmes.server.keys import Keys
from nmes.server.metrics import Metrics
from nmes.server.reception import drain
from nmes.world import World

logger = logging.getLogger(__name__)


class _Worlds(click.ParamType["int | list[str]"]):
    """A number of worlds, or their names."""

    name = "N|NAMES"

    def convert(self, value: Any, parameter: click.Parameter | None, context: click.Context | None) -> int | list[str]:
        if not isinstance(value, str):
            return value  # type: ignore[no-any-return]
        if not value.isdecimal():
            return value.split(",")
        if not 1 <= int(value) <= MOST_WORLDS:
            self.fail(f"a number of worlds is from 1 to {MOST_WORLDS:,}", parameter, context)
        return int(value)


class _Role(click.ParamType["tuple[str, Path]"]):
    """A role and the file of its password."""

    name = "NAME=FILE"

    def convert(self, value: Any, parameter: click.Parameter | None, context: click.Context | None) -> tuple[str, Path]:
        role, separator, file = value.partition("=")
        if not (role and separator and file):
            self.fail("say which role, and the file of its password, such as player=secrets/player", parameter, context)
        return role, Path(file)


class _Keep(click.ParamType["tuple[float, str]"]):
    """How long or how much is kept: a number of days or of bytes."""

    name = "DAYS|SIZE"

    def convert(
        self, value: Any, parameter: click.Parameter | None, context: click.Context | None
    ) -> tuple[float, str]:
        match = re.fullmatch(r"([0-9]{1,9}(?:\.[0-9]{1,3})?)(d|MB|GB|TB)", value)
        if match is None or float(match[1]) == 0.0:
            self.fail("say how many days or bytes, such as 30d, 500MB or 20GB", parameter, context)
        number = float(match[1])
        return (number, "days") if match[2] == "d" else (number * {"MB": 1e6, "GB": 1e9, "TB": 1e12}[match[2]], "bytes")


def _open_parent(context: click.Context, parameter: click.Parameter, value: str | None) -> Recording | Path | None:
    if value is None or Path(value).is_dir():
        return None if value is None else Path(value)
    return open_recording(context, parameter, value)


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
    "--port-step",
    type=click.IntRange(0, 65535),
    help="From the port of one world to that of the next; 0 serves all on one.  [default: 1]",
)
@click.option(
    "--dialect",
    type=click.Choice(list(DIALECTS)),
    help="Serve the world that programs for the original server expect: its planets, gravity, damping and frictions. "
    "--config and the other options win over it, field by field.",
)
@click.option("--backend", help="Physics engine.  [default: mujoco]")
@click.option(
    "--config",
    metavar="FILE",
    help="World config: a JSON file, or one that ships, such as ecosystem; the other options win over it.",
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
    help="Directory for the recording.  [default: recordings]",
)
@click.option(
    "--keep",
    type=_Keep(),
    multiple=True,
    help="Remove the oldest recordings of that directory when they are older than that (30d), or all take more (20GB); "
    "never those that are signed or marked with a file NAME.mcap.keep.",
)
@click.option("--no-record", is_flag=True, help="Record nothing.")
@click.option(
    "--flush-interval",
    type=FiniteRange(0, 3600),
    default=1.0,
    show_default=True,
    help="Seconds of the recording that a crash may lose; with 0 nothing is told before it is on disk.",
)
@click.option(
    "--keyframes",
    type=FiniteRange(0, 86400),
    help="Seconds of a world's time after which it saves itself, so that recordings can be replayed or resumed from "
    "there; 0 for never.  [default: 10]",
)
@click.option(
    "--resume",
    metavar="FILE|FOLDER",
    callback=_open_parent,
    help="Go on from a recording, in a new one; its world is what its own config says. Of a folder, host all worlds "
    "that it keeps, each of which goes on from where it ended when somebody enters it.",
)
@click.option("--at", "frame", type=MOMENT, help="With --resume: from this frame or time.  [default: the last]")
@password_options(f"Password that clients must give; better in the variable {PASSWORD_VARIABLE}.")
@click.option(
    "--world-passwords",
    metavar="FOLDER",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="Folder of files named after worlds: the first line of each is a password for that world alone.",
)
@click.option(
    "--role",
    type=_Role(),
    multiple=True,
    help="A password for one of the roles that the world's config names: the first line of the file.",
)
@click.option(
    "--makers",
    metavar="FOLDER",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="Folder of files named after people: the first line of each is a password for creating worlds, and for those.",
)
@click.option(
    "--templates",
    metavar="FOLDER",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="Folder of world configs, *.json, from which worlds may be created over the wire, beside those that ship.",
)
@click.option(
    "--max-worlds",
    type=click.IntRange(1, MOST_WORLDS),
    default=MANY_WORLDS,
    show_default=True,
    help="How many worlds there may be.",
)
@click.option(
    "--max-worlds-each",
    type=click.IntRange(1, MOST_WORLDS),
    default=100,
    show_default=True,
    help="How many of them one of --makers may have.",
)
@click.option(
    "--hibernate-after",
    type=FiniteRange(0, 86_400),
    default=60.0,
    show_default=True,
    help="Seconds after which a world in which nobody is and nothing moves is saved and let go, until somebody comes; "
    "0 for never.",
)
@click.option(
    "--workers",
    metavar="N",
    type=click.IntRange(1, MOST_WORKERS),
    help="Host the worlds in so many processes behind this one address, best one a core; where one dies, its worlds go "
    "on in the others, from their recordings.",
)
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
    help="Port on which probes and Prometheus learn how the host is; 0 finds a free one.",
)
@click.option("--metrics-host", help="Address of that port, which asks for no password.  [default: 127.0.0.1]")
@click.option(
    "--http",
    "http_port",
    type=click.IntRange(0, 65535),
    help="Port for WebSockets too, at /ws, by which browsers come; 0 finds a free one.",
)
@click.option(
    "--rosbridge",
    "rosbridge_port",
    type=click.IntRange(0, 65535),
    help="Port for programs that are written for ROS, which speak rosbridge; 0 finds a free one.",
)
@click.option(
    "--http-origin",
    "http_origins",
    multiple=True,
    metavar="ORIGIN",
    help="Whose pages may come to these two, such as https://lab.example.org, beside those of the address itself.",
)
@click.option(
    "--drain",
    type=FiniteRange(0.0, 86_400.0),
    metavar="SECONDS",
    default=0.0,
    show_default=True,
    help="After SIGTERM, wait so long for clients to leave; nobody new is let in.",
)
@click.option("--agones", is_flag=True, help="Tell the sidecar of Agones how the host is.")
@click.option(
    "--access-log",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Append to this file who comes, from where, to which world, and how it ends: a JSON object a line.",
)
@click.option("--view", is_flag=True, help="Look at the world, as `nmes view` does: in a window, or else in a browser.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object when ready, for scripts.")
def command(log_format: str, view: bool, as_json: bool, **options: Any) -> None:
    """Host a world that clients drive over TCP, or many.

    Each world is recorded to a new file. With --resume it goes on from where a recording ends, or from any frame of it;
    those who were in it then have left. Ctrl-C, SIGTERM or SIGHUP closes the recording and ends with status 0, or with
    1 where a recording could not be written to its end; with --drain, SIGTERM lets clients end first. Without a
    password one is made up and printed, which is allowed only on an address of this machine alone.

    For example:

    \b
        nmes serve --mode lockstep --seed 7 --password-file secret
        nmes serve --dialect original --password-file secret
        nmes serve --worlds 20 --port 14000 --port-step 3
        nmes serve --workers 8 --password-file secret
        nmes serve --resume recordings/main-20260101T120000.123456Z.mcap --at 3600
    """
    settings = read_settings(options)
    sys.setswitchinterval(SWITCH)
    gc.set_threshold(*COLLECTIONS)
    _logs.set_up(log_format)
    raise_open_files_limit(settings.max_worlds)
    with ExitStack() as after:  # a viewer sees the world's end

        def report(running: Running) -> None:
            click.echo(json.dumps(ready_object(running)) if as_json else "\n".join(ready_lines(running)))
            if view:
                address, port = running.address, running.ports[0]
                after.enter_context(viewer(address, port, settings.password, settings.tls_cert, quiet=as_json))

        running, reason = asyncio.run(_serve(settings, log_format, report))
        if not as_json and reason != signal.SIGHUP:  # else the terminal is gone, and writing to it fails
            for line in stopped_lines(running):
                click.echo(line)
    lost = _lost(running.host)
    for name, why in lost:
        click.echo(f"Error: the recording of world {name!r} is not whole: {why}", err=True)
    if isinstance(running.host, Host) and running.host.abandoned:
        sys.stdout.flush()  # else Python waits at its end for the thread, until the engine is done
        sys.stderr.flush()
        os._exit(1 if lost else 0)
    if lost:
        click.get_current_context().exit(1)


def _lost(host: Host | Supervisor) -> list[tuple[str, str]]:
    """Returns the worlds of a closed host whose recordings are not whole, and why."""
    if isinstance(host, Supervisor):
        return host.lost
    return [(each.name, each.lost) for each in (*host.worlds.values(), *host.closed) if each.lost is not None]


async def _serve(
    settings: Settings, log_format: str, report: Callable[[Running], None]
) -> tuple[Running, signal.Signals]:
    """Hosts until a signal comes; `report` is called when clients may connect.

    Returns:
        What was hosted, closed now, and the signal.
    """
    signals: asyncio.Queue[signal.Signals] = asyncio.Queue()  # the first one ends it; those to come are not minded
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:  # as nohup leaves it
            asyncio.get_running_loop().add_signal_handler(number, signals.put_nowait, number)
    async with AsyncExitStack() as beside:  # the sidecar is told that all is over when it is
        catalog = Catalog(settings.templates, settings.max_worlds, settings.max_worlds_each)
        async with _make_host(settings, log_format, catalog) as host:
            running = await _start(host, settings)
            if settings.agones is not None:
                sidecar = Sidecar(settings.agones, lambda: len(catalog), settings.max_worlds, lambda: host.occupied)
                await beside.enter_async_context(sidecar)
            report(running)
            reason = await signals.get()
            if reason == signal.SIGTERM and settings.drain:
                await _drain(host, settings.drain, signals)
    return running, reason


async def _drain(host: Host | Supervisor, seconds: float, signals: asyncio.Queue[signal.Signals]) -> None:
    """Waits until all clients have left, for so long or until another signal comes."""
    logger.info("the host drains for %g s at the most; another signal ends it now", seconds)
    waits = [asyncio.create_task(drain(host, seconds)), asyncio.create_task(signals.get())]
    await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
    for task in waits:
        task.cancel()
    await asyncio.gather(*waits, return_exceptions=True)


def _make_host(settings: Settings, log_format: str, catalog: Catalog) -> Host | Supervisor:
    if settings.workers is not None:
        assert settings.record_to is not None
        return Supervisor(
            Keys(settings.password, settings.role_passwords, settings.makers),
            command_of_worker(log_format, settings.max_worlds),
            record_to=settings.record_to,
            address=settings.address,
            catalog=catalog,
            hibernate_after=settings.hibernate_after,
            flush_interval=settings.flush_interval,
            tls=settings.tls,
            tls_files=settings.tls_files,
            metrics=settings.metrics_port is not None,
            access_log=settings.access_log,
            retention=settings.keep,
        )
    return Host(
        settings.password,
        role_passwords=settings.role_passwords,
        record_to=settings.record_to,
        flush_interval=settings.flush_interval,
        tls=settings.tls,
        metrics=None if settings.metrics_port is None else Metrics(),
        access_log=None if settings.access_log is None else AccessLog(settings.access_log),
        retention=settings.keep,
        makers=settings.makers,
        catalog=catalog,
        hibernate_after=settings.hibernate_after,
    )


def _maker_of(kept: Recording, settings: Settings) -> str | None:
    """Returns the maker of a recorded world, or None: it is the host's own, or its maker is not known here."""
    maker = maker_of(kept)
    if maker is None or maker in settings.makers:
        return maker
    logger.warning(
        "%s is of a world that %r created, who is none of --makers: it is the host's own now", kept.path, maker
    )
    return None


async def _start(host: Host | Supervisor, settings: Settings) -> Running:
    """Listens on the ports and adds the worlds: no recording is begun where a port is taken.

    Nobody is let in meanwhile: between the last port and its one world the event loop has no turn. Of workers nobody
    is asked before all have started, and the one world is in one of them; who comes earlier waits.
    """
    names, metrics_port, address, ports = settings.names, settings.metrics_port, settings.address, []
    http_port, rosbridge_port = settings.http_port, settings.rosbridge_port
    try:
        for name in names:
            password = settings.world_passwords.get(name)
            if name in settings.kept:
                kept = settings.kept[name]
                host.offer(kept.config, password, kept.path, _maker_of(kept, settings))
            else:
                host.offer({**settings.config, "name": name}, password)
        with _free_port_hint("--metrics-port"):
            if metrics_port is not None:
                metrics_port = await host.probes.listen(settings.metrics_host, metrics_port)
        with _free_port_hint("--http"):
            if http_port is not None and isinstance(host, Host):  # with workers there is none
                from nmes.server.websocket import worlds_application  # which takes a while to load

                application = worlds_application(host, [settings.address], settings.http_origins)
                _, http_port = await host.serve_http(settings.address, http_port, application)
        with _free_port_hint("--rosbridge"):
            if rosbridge_port is not None and isinstance(host, Host):
                from nmes.ros import rosbridge_application

                made_up = settings.password if settings.password_source == MADE_UP else None
                bridge = rosbridge_application(host, [settings.address], settings.http_origins, made_up)
                _, rosbridge_port = await host.serve_http(settings.address, rosbridge_port, bridge)
        with _free_port_hint("--port"):
            for index, port in enumerate(settings.ports):
                default = names[index] if len(settings.ports) > 1 else None
                address, port = await host.listen(settings.address, port, default)
                ports.append(port)
        sample = await _open_in_workers(host, settings) if isinstance(host, Supervisor) else _add_world(host, settings)
    except RejectedMessage as error:
        raise click.UsageError(f"world config: {error.message}") from error
    except WorldError as error:
        raise click.UsageError(error.message) from error
    return Running(settings, host, sample, sample.ticks, address, ports, metrics_port, http_port, rosbridge_port)


@contextmanager
def _free_port_hint(option: str) -> Iterator[None]:
    """Adds to the error of a port that is taken how to find a free one."""
    try:
        yield
    except MachineError as error:
        if isinstance(error.__cause__, OSError) and error.__cause__.errno == errno.EADDRINUSE:
            raise click.ClickException(f"{error.message}; {option} 0 finds a free port") from error
        raise


async def _open_in_workers(host: Supervisor, settings: Settings) -> World:
    """Starts the workers and brings up the one world; returns a world like it, or like each of many."""
    assert settings.workers is not None
    sample = _sample(settings)
    await host.start(settings.workers)
    if len(settings.names) == 1 and (failure := await host.open(settings.names[0])) is not None:
        raise click.ClickException(failure.message)
    return sample


def _add_world(host: Host, settings: Settings) -> World:
    """Adds the one world and returns it; of many, which are created when first used, returns one like them."""
    if not settings.names:
        own = next(iter(settings.world_passwords.values()), None)
        if settings.parent is None:
            return host.add(settings.config, own).world
        recording, frame = settings.parent
        return host.resume(recording, frame, own, _maker_of(recording, settings)).world
    return _sample(settings)


def _sample(settings: Settings) -> World:
    """Returns a closed world like each of those that are created later: an error in all of them is shown now."""
    name = settings.names[0]
    sample = World(settings.kept[name].config if name in settings.kept else {**settings.config, "name": name})
    sample.close()
    return sample
