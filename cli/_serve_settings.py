"""The options of `nmes serve`, checked: worlds to host, where and how."""

from __future__ import annotations

import base64
import ipaddress
import os
import re
import secrets
import socket
import ssl
import string
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from nmes.cli._password import PASSWORD_VARIABLE, choose_password, read_password
from nmes.errors import DocumentError, RejectedMessage
from nmes.fleet.agones import PORT, VARIABLE
from nmes.protocol import complete_config, parse_json
from nmes.recording import Recording
from nmes.schemas.documents import ShippedDocuments
from nmes.schemas.files import read_regular
from nmes.server.catalog import DEFAULT
from nmes.server.kept_worlds import kept_worlds
from nmes.server.retention import Retention
from nmes.world.roles import OWNER

__all__ = ["DIALECTS", "MADE_UP", "MANY_WORLDS", "MOST_WORKERS", "MOST_WORLDS", "Settings", "read_settings"]

MOST_WORLDS = 100_000
MOST_WORKERS = 256
MANY_WORLDS = 10_000  # that there may be unless told otherwise
SHIPPED = ShippedDocuments("world config", "nmes.world", "shipped")
_LOCAL, _RECORDINGS = "127.0.0.1", Path("recordings")
_IMAGE = 64 << 20  # bytes of the image of a landscape
KEYFRAMES = 10.0  # s of a world's time
MADE_UP = "generated"  # the source of a password that was not given
DIALECTS: Mapping[str, Mapping[str, Any]] = {
    "original": {
        "backend": "mujoco",
        "mode": "realtime",
        "tick_rate": 60,
        "gravity": [0, -9.8, 0],
        "damping": {"linear": 0.1, "angular": 0.1},
        "friction": 1,
        "restitution": 0,
        "scene": {"type": "planets", "planets": {"layout": "corner", "count": 27, "spacing": 800, "radius": 100}},
    }
}
"""The configs of the worlds that programs of a dialect expect."""


@dataclass(frozen=True)
class Settings:
    """One world or many, their addresses, and what all of them share.

    Attributes:
        config: The world's config, or that of all worlds but for their names.
        parent: The recording and its frame (None: the last) that the world goes on from.
        kept: The recordings from whose ends some of the worlds go on, by their names.
        names: The worlds' names, none where there is just one world.
        address: The address to listen on.
        ports: One port for all worlds, or one for each.
        password: The password that clients must give.
        password_source: Where the password is from.
        world_passwords: What opens one world alone, by its name.
        role_passwords: What opens all worlds in one role alone, by the role's name.
        record_to: Directory for the recordings; None: nothing is recorded.
        flush_interval: How much (s) of a recording a crash may lose.
        tls_cert: The file of the host's certificate; None: no TLS.
        tls_key: The file of its key.
        tls: The certificate and its key.
        metrics_host: The address of probes and metrics.
        metrics_port: Their port; None: there are none.
        drain: How long (s) clients have to leave after SIGTERM.
        agones: The port of the sidecar of Agones; None: there is none.
        http_port: Port of the WebSockets; None: there are none.
        rosbridge_port: Port of rosbridge; None: there is none.
        http_origins: Whose pages may come to these.
        access_log: The file of who comes and goes; None: there is none.
        keep: Which recordings are removed; None: none.
        makers: The passwords of those who may create worlds, by their names.
        templates: The configs of worlds that are created over the wire, by name.
        max_worlds: How many worlds there may be.
        max_worlds_each: How many of them one maker may have.
        hibernate_after: How long (s) a world is idle before it hibernates; None: none ever does.
        workers: How many processes host the worlds, which have all names then; None: this one alone.
    """

    config: dict[str, Any]
    parent: tuple[Recording, int | None] | None
    kept: Mapping[str, Recording]
    names: list[str]
    address: str
    ports: list[int]
    password: str
    password_source: str
    world_passwords: Mapping[str, str]
    role_passwords: Mapping[str, str]
    record_to: Path | None
    flush_interval: float
    tls_cert: Path | None
    tls_key: Path | None
    tls: ssl.SSLContext | None
    metrics_host: str
    metrics_port: int | None
    drain: float
    agones: int | None
    http_port: int | None
    rosbridge_port: int | None
    http_origins: Sequence[str]
    access_log: Path | None
    keep: Retention | None
    makers: Mapping[str, str]
    templates: Mapping[str, Mapping[str, Any]]
    max_worlds: int
    max_worlds_each: int
    hibernate_after: float | None
    workers: int | None

    @property
    def tls_files(self) -> tuple[Path, Path] | None:
        """The files of the certificate and of its key; None: no TLS."""
        return None if self.tls_cert is None or self.tls_key is None else (self.tls_cert, self.tls_key)


def read_settings(options: Mapping[str, Any]) -> Settings:
    """Checks the options of `nmes serve`, by the names of its parameters.

    Raises:
        UsageError: Some do not go together, or a file that they name cannot be used.
    """
    config, parent = _world(options)
    password, source = _password(options)
    name = config.get("name", "main")
    names, ports = _layout(options, name)
    if options["workers"] is not None:
        _check_workers(options)
    kept = _kept(options["resume"]) if isinstance(options["resume"], Path) else {}
    if kept:
        names = [*names, *(other for other in kept if other not in names)]
    elif options["workers"] is not None:
        names = names or [name]
    worlds = _world_passwords(options["world_passwords"], names or [name])
    makers = _makers(options["makers"], [password, *worlds.values()])
    templates = _templates(options["templates"], config)
    record_to = _record_to(options)
    if len(names) > options["max_worlds"]:
        raise click.UsageError(f"{len(names):,} worlds are more than --max-worlds {options['max_worlds']:,} allows")
    return Settings(
        config=config,
        parent=parent,
        kept=kept,
        names=names,
        address=options["host"],
        ports=ports,
        password=password,
        password_source=source,
        world_passwords=worlds,
        role_passwords=_role_passwords(
            options["role"],
            [*templates.values(), *(recording.config for recording in kept.values())],
            [password, *worlds.values(), *makers.values()],
        ),
        record_to=record_to,
        flush_interval=options["flush_interval"],
        tls_cert=options["tls_cert"],
        tls_key=options["tls_key"],
        tls=_load_tls(options["tls_cert"], options["tls_key"]),
        metrics_host=_metrics_host(options),
        metrics_port=options["metrics_port"],
        drain=options["drain"],
        agones=_sidecar_port() if options["agones"] else None,
        http_port=options["http_port"],
        rosbridge_port=options["rosbridge_port"],
        http_origins=_origins(options),
        access_log=options["access_log"],
        keep=_retention(options, record_to),
        makers=makers,
        templates=templates,
        max_worlds=options["max_worlds"],
        max_worlds_each=options["max_worlds_each"],
        hibernate_after=options["hibernate_after"] or None,
        workers=options["workers"],
    )


def _world(options: Mapping[str, Any]) -> tuple[dict[str, Any], tuple[Recording, int | None] | None]:
    """Returns the config, and where its world goes on from."""
    fields = {key: options[key] for key in ("backend", "seed", "mode", "rate", "keyframes") if options[key] is not None}
    recording: Recording | Path | None = options["resume"]
    if isinstance(recording, Recording):
        others = [*fields, *(name for name in ("dialect", "config", "worlds") if options[name] is not None)]
        if others:
            raise click.UsageError(f"--{others[0]} does not go with --resume: the recording says what its world is")
        moment = options["frame"]
        return recording.config, (recording, None if moment is None else moment.frame(recording))
    if options["frame"] is not None:
        folder = "" if recording is None else f", not of the worlds in {recording}"
        raise click.UsageError(f"--at needs --resume FILE: it is a frame of that recording{folder}")
    expected = {} if options["dialect"] is None else DIALECTS[options["dialect"]]
    file = {} if options["config"] is None else _read_config(options["config"])
    return {"keyframes": KEYFRAMES, **expected, **file, **fields}, None


def _kept(folder: Path) -> dict[str, Recording]:
    try:
        return kept_worlds(folder)
    except OSError as error:
        raise click.UsageError(f"--resume: {folder} cannot be read: {error.strerror}") from error


def _read_config(name: str) -> dict[str, Any]:
    path = Path(name)
    try:
        config = parse_json(SHIPPED.read(path))
    except DocumentError as error:
        raise click.UsageError(error.problems[0][1]) from error
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
            landscape["image"] = base64.b64encode(read_regular(image, _IMAGE)).decode()
        except (OSError, ValueError) as error:
            raise click.UsageError(f"{path}: scene/heightfield/image_file: {error}") from error


def _password(options: Mapping[str, Any]) -> tuple[str, str]:
    """Returns the password, which may be made up for an address of this machine, and where it is from."""
    chosen = choose_password(options["password"], options["password_file"])
    if chosen is not None:
        return chosen
    host = options["host"]
    if not _is_local(host):
        raise click.UsageError(
            f"{host} can be reached from elsewhere: give a password, in {PASSWORD_VARIABLE} or with --password-file"
        )
    # Begins with a letter: a password that begins with a dash would be taken for an option.
    return secrets.choice(string.ascii_letters) + secrets.token_urlsafe(12), MADE_UP


def _world_passwords(folder: Path | None, names: Collection[str]) -> dict[str, str]:
    """Returns the passwords of single worlds, by name, each the first line of the file of that name."""
    passwords = {}
    for file in _files(folder):
        if file.name not in names:  # else whoever was given this password would learn at the door that it opens nothing
            raise click.UsageError(f"{file}: there is no world {file.name!r} here; a file is named after its world")
        passwords[file.name] = read_password(file)
    return passwords


def _files(folder: Path | None) -> list[Path]:
    """Returns the files of a folder of passwords, without hidden ones: a Secret of Kubernetes has `..data` in it."""
    return [] if folder is None else sorted(file for file in folder.iterdir() if not file.name.startswith("."))


def _makers(folder: Path | None, others: Collection[str]) -> dict[str, str]:
    """Returns the passwords of makers, by name, each the first line of its file; `others` open something already."""
    makers: dict[str, str] = {}
    for file in _files(folder):
        password = read_password(file)
        if password in (*others, *makers.values()):  # it could not be told who comes
            raise click.UsageError(f"{file} has a password that opens something else already")
        makers[file.name] = password
    return makers


def _templates(folder: Path | None, config: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Returns the configs that worlds may be created from, by name: those that ship, those of a folder, and our own."""
    templates = {name: _read_config(name) for name in SHIPPED.names()}
    for file in sorted(folder.glob("*.json")) if folder is not None else ():
        templates[file.stem] = _read_config(str(file))
        try:
            complete_config(templates[file.stem])
        except RejectedMessage as error:
            raise click.UsageError(f"{file}: {error.message}") from error
    if folder is not None and DEFAULT in templates:
        raise click.UsageError(f"{folder / DEFAULT}.json: that template is what --config and the other options say")
    return {**{name: {"keyframes": KEYFRAMES, **own} for name, own in templates.items()}, DEFAULT: config}


def _role_passwords(
    options: Sequence[tuple[str, Path]], configs: Sequence[Mapping[str, Any]], others: Sequence[str]
) -> dict[str, str]:
    """Returns the passwords of roles, by name, each the first line of its file; `others` open something already."""
    roles = [role for config in configs if isinstance(config.get("roles"), dict) for role in config["roles"]]
    known = tuple(dict.fromkeys((OWNER, *roles))) if roles else ()
    passwords: dict[str, str] = {}
    for role, file in options:
        if role not in known:
            has = f"its roles are {', '.join(known)}" if known else "it names no roles"
            raise click.UsageError(f"--role {role}: the world's config has no such role; {has}")
        password = read_password(file)
        if role in passwords:
            raise click.UsageError(f"--role {role} is given twice")
        if password in (*others, *passwords.values()):  # it could not be told who comes
            raise click.UsageError(f"--role {role}: {file} has a password that opens something else already")
        passwords[role] = password
    return passwords


def _is_local(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _layout(options: Mapping[str, Any], name: str) -> tuple[list[str], list[int]]:
    """Returns the names of the worlds, none where there is just one, and the ports."""
    worlds, port, step = options["worlds"], options["port"], options["port_step"]
    if not isinstance(worlds, int):
        if step is not None:
            raise click.UsageError("--port-step goes with a number of worlds")
        return worlds or [], [port]
    names = [f"{name}-{number}" for number in range(1, worlds + 1)]
    if step == 0:
        return names, [port]
    if port == 0:
        return names, [0] * worlds
    ports = [port + number * (step or 1) for number in range(worlds)]
    if ports[-1] > 65535:
        raise click.UsageError(
            f"{worlds} worlds from port {port} on reach beyond port 65535; --port-step 0 serves all on one"
        )
    return names, ports


def _origins(options: Mapping[str, Any]) -> Sequence[str]:
    """Returns whose pages may come, each as browsers write an origin."""
    origins: Sequence[str] = options["http_origins"]
    if origins and options["http_port"] is None and options["rosbridge_port"] is None:
        raise click.UsageError("--http-origin goes with --http or --rosbridge")
    for origin in origins:
        if not re.fullmatch(r"https?://[a-z0-9.-]+(:[0-9]{1,5})?|https?://\[[0-9a-f:]+\](:[0-9]{1,5})?", origin):
            raise click.UsageError(f"{origin}: an origin is a scheme and a name, such as https://lab.example.org")
    return origins


def _check_workers(options: Mapping[str, Any]) -> None:
    """Refuses what does not go with several processes."""
    if isinstance(options["resume"], Recording):
        raise click.UsageError("--workers goes with --resume FOLDER: one recording is of one world, so of one process")
    if options["no_record"]:
        raise click.UsageError("--workers does not go with --no-record: worlds come back from their recordings")
    for option in ("http", "rosbridge"):
        if options[f"{option}_port"] is not None:
            raise click.UsageError(f"--workers does not go with --{option}: only sockets of TCP are handed on")
    if not hasattr(socket, "send_fds"):
        raise click.UsageError("--workers needs a system whose processes can hand sockets to each other")


def _metrics_host(options: Mapping[str, Any]) -> str:
    """Returns the address of probes and metrics."""
    address: str | None = options["metrics_host"]
    if address is not None and options["metrics_port"] is None:
        raise click.UsageError("--metrics-host is the address of --metrics-port")
    return address or _LOCAL


def _record_to(options: Mapping[str, Any]) -> Path | None:
    """Returns the directory for the recordings, unless nothing is recorded."""
    directory: Path | None = options["record_to"]
    if not options["no_record"]:
        return directory or _RECORDINGS
    for option, value in (("keep", options["keep"]), ("record", directory)):
        if value:
            raise click.UsageError(f"--{option} does not go with --no-record")
    return None


def _retention(options: Mapping[str, Any], record_to: Path | None) -> Retention | None:
    """Returns the rules by which recordings of a directory are removed, if there are any."""
    limits: dict[str, float] = {}
    for amount, unit in options["keep"]:
        if unit in limits:
            raise click.UsageError(f"--keep says twice how many {unit}")
        limits[unit] = amount
    if not limits or record_to is None:
        return None
    size = limits.get("bytes")
    return Retention(record_to, limits.get("days"), None if size is None else int(size))


def _sidecar_port() -> int:
    """Returns the port of the sidecar of Agones on this machine."""
    value = os.environ.get(VARIABLE) or str(PORT)
    if not (value.isdecimal() and 0 < int(value) <= 65535):
        raise click.UsageError(f"{VARIABLE}: expected a port, got {value!r}")
    return int(value)


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
