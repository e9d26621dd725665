"""The lines that `nmes serve` prints: that it is ready, for people or as one JSON object, and that it has stopped."""

from __future__ import annotations

from typing import Any, NamedTuple

from nmes.cli._serve_settings import MADE_UP, Settings
from nmes.fleet.supervisor import Supervisor
from nmes.server import Host
from nmes.server.hosted_world import HostedWorld
from nmes.world import World

__all__ = ["Running", "ready_lines", "ready_object", "stopped_lines"]

FEW = 20  # worlds, each of which has a line


class Running(NamedTuple):
    """A host that clients may connect to.

    Attributes:
        sample: The world, or where there are many, one like each of them.
        start: The ticks that the world had when it was made.
        address: Where it listens.
        ports: The ports that were found.
        metrics_port: The port that was found for metrics; None: there are none.
        http_port: The port that was found for WebSockets; None: there are none.
        rosbridge_port: The port that was found for rosbridge; None: there is none.
    """

    settings: Settings
    host: Host | Supervisor
    sample: World
    start: int
    address: str
    ports: list[int]
    metrics_port: int | None
    http_port: int | None
    rosbridge_port: int | None

    @property
    def worlds(self) -> dict[str, int]:
        """The ports of the worlds by name; empty where there is just one world."""
        own = dict(zip(self.settings.names, self.ports, strict=False)) if len(self.ports) > 1 else {}
        return {name: own.get(name, self.ports[0]) for name in self.settings.names}


def ready_object(running: Running) -> dict[str, Any]:
    """Returns the JSON object that scripts read: addresses, worlds, recordings and a password that was made up."""
    settings = running.settings
    ready = {
        "host": running.address,
        "port": running.ports[0],
        "password_source": settings.password_source,
        **(_many_worlds(running) if settings.names else _one_world(running)),
    }
    if isinstance(running.host, Supervisor):
        workers = running.host.workers.running
        ready["workers"] = [{"worker": each.number, "pid": each.process.pid, "port": each.port} for each in workers]
    if running.sample.roles:
        ready["roles"] = list(running.sample.roles)
    if running.metrics_port is not None:
        ready["metrics_port"] = running.metrics_port
    if running.http_port is not None:
        ready["http_port"] = running.http_port
    if running.rosbridge_port is not None:
        ready["rosbridge_port"] = running.rosbridge_port
    if settings.password_source == MADE_UP:
        ready["password"] = settings.password
    return ready


def _many_worlds(running: Running) -> dict[str, Any]:
    directory = running.settings.record_to
    few = len(running.ports) > 1 or len(running.worlds) <= FEW  # on one port, names that count on say no more
    return {
        **({"worlds": [{"world": name, "port": port} for name, port in running.worlds.items()]} if few else {}),
        "world_count": len(running.worlds),
        **_engine(running.sample),
        "recordings": None if directory is None else str(directory),
        **({"resumed": len(running.settings.kept)} if running.settings.kept else {}),
    }


def _one_world(running: Running) -> dict[str, Any]:
    (hosted,) = _hosted(running)
    recording = None if hosted.recording is None else str(hosted.recording)
    world = {"world": hosted.name, **_engine(running.sample), "recording": recording}
    if running.settings.parent is not None:
        world["resumed"] = {"file": str(running.settings.parent[0].path), "frame": running.start}
    return world


def _hosted(running: Running) -> list[HostedWorld]:
    assert isinstance(running.host, Host)
    return list(running.host.worlds.values())


def _engine(world: World) -> dict[str, Any]:
    return {"backend": world.backend.name, "mode": world.mode, "rate": world.rate, "seed": world.seed}


def ready_lines(running: Running) -> list[str]:
    """Returns the lines that people read: addresses, worlds, recordings and a password that was made up."""
    settings, sample = running.settings, running.sample
    pace = f"{sample.mode} x {sample.rate:g}" if sample.mode == "realtime" else sample.mode
    engine = f"{sample.backend.name} {sample.backend.version()}, {pace}, seed {sample.seed}"
    lines = _world_lines(running, engine)
    if not lines:
        lines = [f"World {sample.config['name']!r}: {engine}", f"Listening on {running.address}:{running.ports[0]}"]
    if settings.password_source == MADE_UP:
        lines.append(f"Password: {settings.password}  (made up for this run)")
    else:
        lines.append(f"Password: given by {settings.password_source}")
    if isinstance(running.host, Supervisor):
        ports = ", ".join(str(worker.port) for worker in running.host.workers.running)
        lines.append(f"{settings.workers} worker processes, with ports of their own: {ports}")
    lines.append(_roles_line(running))
    if running.metrics_port is not None:
        lines.append(f"Metrics on http://{settings.metrics_host}:{running.metrics_port}/metrics")
    scheme = "ws" if settings.tls is None else "wss"
    if running.http_port is not None:
        lines.append(f"WebSockets on {scheme}://{running.address}:{running.http_port}/ws")
    if running.rosbridge_port is not None:
        free = ", without a password" if settings.password_source == MADE_UP else ""
        lines.append(f"rosbridge on {scheme}://{running.address}:{running.rosbridge_port}{free}")
    if settings.parent is not None:
        lines.append(f"Going on from frame {running.start:,} of {settings.parent[0].path}")
    if settings.kept:
        lines.append(f"Going on with {len(settings.kept):,} worlds from where their recordings end")
    return [*lines, _recording_line(running), "Ctrl-C stops"]


def _world_lines(running: Running, engine: str) -> list[str]:
    """Returns a line for each of several worlds; one for all, where they are many."""
    worlds = list(running.worlds.items())
    if len(worlds) <= FEW:
        return [f"World {name!r} on {running.address}:{port}: {engine}" for name, port in worlds]
    (first, port), (last, end) = worlds[0], worlds[-1]
    ports = f"{running.address}:{port}" if port == end else f"{running.address}:{port} to :{end}"
    return [f"{len(worlds):,} worlds, {first!r} to {last!r}, on {ports}: {engine}"]


def _roles_line(running: Running) -> str:
    """Returns who may do what, in short: which roles there are, and what opens each."""
    if not running.sample.roles:
        return "Everybody with the password may do everything: the world's config names no roles"
    own = running.settings.role_passwords
    by = {role: "its own password" if role in own else "the host's password" for role in running.sample.roles}
    return f"Roles: {', '.join(f'{role} (by {password})' for role, password in by.items())}"


def _recording_line(running: Running) -> str:
    settings = running.settings
    if settings.record_to is None:
        return "Not recording"
    if settings.names:
        return f"Recording to {settings.record_to}, a file for each world"
    (hosted,) = _hosted(running)
    return f"Recording to {hosted.recording}"


def stopped_lines(running: Running) -> list[str]:
    """Returns a line for each world of a closed host, with its last frame; one for all, where they are many."""
    lines: list[str] = []
    if isinstance(running.host, Supervisor):
        return ["Stopped"]
    hosts = _hosted(running)
    if len(hosts) > FEW:
        return [f"{len(hosts):,} worlds stopped"]
    for hosted in hosts:
        name = f"World {hosted.name!r} stopped" if running.settings.names else "Stopped"
        lines.append(f"{name} at frame {hosted.world.frame}")
    return lines
