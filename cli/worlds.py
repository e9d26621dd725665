"""`nmes worlds`: list the worlds of a host, and steer them."""

from __future__ import annotations

from typing import Any

import click

from nmes.cli._address import split_address
from nmes.cli._connection import connection_options, connector
from nmes.cli._json import print_json
from nmes.client import Client
from nmes.errors import CommandFailed, RejectedMessage, visible
from nmes.protocol import validate_reply


@click.command("worlds", short_help="List and steer the worlds of a host.")
@click.argument("address", metavar="HOST:PORT", callback=split_address)
@connection_options
@click.option("--world", "names", multiple=True, metavar="NAME", help="Only this world; may be repeated.")
@click.option("--pause", is_flag=True, help="Stop the clock of the world.")
@click.option("--resume", is_flag=True, help="Let the clock of a paused world go on.")
@click.option("--step", metavar="N", type=click.IntRange(1, 10_000), help="Tick so often, in lockstep or while paused.")
@click.option("--reset", is_flag=True, help="Empty the world, back to tick 0 and its seed.")
@click.option("--close", is_flag=True, help="Close the world for good; its recording ends whole.")
@click.option("--create", metavar="NAME", help="Create this world, and list it.")
@click.option(
    "--template", metavar="NAME", help="With --create: the template of the host that its config is taken from."
)
@click.option(
    "--seed", type=click.IntRange(0, 2**63 - 1), help="With --create: its seed.  [default: that of the template]"
)
@click.option("--json", "as_json", is_flag=True, help="Print it as JSON.")
def command(
    address: tuple[str, int],
    names: tuple[str, ...],
    pause: bool,
    resume: bool,
    step: int | None,
    reset: bool,
    close: bool,
    create: str | None,
    template: str | None,
    seed: int | None,
    as_json: bool,
    **connection: Any,
) -> None:
    """List the worlds of a host: name, port, engine, mode, frame, clients, and which of them fall behind the clock.

    Looking creates none of them: a world that nobody has used yet has no frame. With --pause, --resume, --step or
    --reset, one of them, the world is entered as by any client, which its recording tells, and is listed as it is then.
    With --close it ends for good, and those that are left are listed. Where there are several, --world says which. With
    --create there is a new one. For both the host's own password is needed, or that of a maker.

    For example:

    \b
        nmes worlds 127.0.0.1:14000 --password-file secret
        nmes worlds 127.0.0.1:14000 --world red --world green --pause
        nmes worlds 127.0.0.1:14000 --world red --step 60
        nmes worlds 127.0.0.1:14000 --world red --close
        nmes worlds 127.0.0.1:14000 --create blue --template ecosystem --seed 7
    """
    message = _message(pause, resume, step, reset)
    if create is None and (template is not None or seed is not None):
        raise click.UsageError("--template and --seed go with --create")
    if create is not None:
        if close or message is not None or names:
            raise click.UsageError("--create goes with none of --world, --close, --pause, --resume, --step and --reset")
        _print([_create(connector(address, **connection)(), create, template, seed)], as_json)
        return
    if close and message is not None:
        raise click.UsageError("--close goes with none of --pause, --resume, --step and --reset")
    worlds = _list(connector(address, **connection)(), address, names)
    if (message is not None or close) and len(worlds) > 1 and not names:
        raise click.UsageError(f"there are {len(worlds)} worlds: say with --world which is meant")
    if close:
        for world in worlds:
            _close(connector(address, **connection)(), world["world"])
        worlds = _list(connector(address, **connection)(), address, ())
    elif message is not None:
        for world in worlds:
            _steer(connector(address, **connection, world=world["world"])(), message)
        worlds = _list(connector(address, **connection)(), address, names)
    _print(worlds, as_json)


def _print(worlds: list[Any], as_json: bool) -> None:
    if as_json:
        print_json(worlds)
        return
    rows = [("WORLD", "PORT", "ENGINE", "MODE", "FRAME", "CLIENTS")]
    rows += [_row(world) for world in worlds]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        click.echo("  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)).rstrip())


def _message(pause: bool, resume: bool, step: int | None, reset: bool) -> dict[str, Any] | None:
    """Returns the command that is to be given to a world, if any."""
    messages: list[dict[str, Any]] = [
        {"type": kind} for kind, asked in (("pause", pause), ("resume", resume), ("reset", reset)) if asked
    ]
    if step is not None:
        messages.append({"type": "step", "ticks": step})
    if len(messages) > 1:
        raise click.UsageError("--pause, --resume, --step and --reset exclude each other")
    return messages[0] if messages else None


def _list(client: Client, address: tuple[str, int], names: tuple[str, ...]) -> list[Any]:
    """Returns the worlds of those names, all without any.

    Raises:
        ClickException: There is no such world, or no such server.
    """
    try:
        worlds: Any = client.worlds()
    except TimeoutError as error:
        raise click.ClickException(str(error)) from error
    try:
        validate_reply({"type": "world_list", "worlds": worlds})
    except RejectedMessage as error:
        host, port = address
        raise click.ClickException(f"{host}:{port} is no NMES server: its answer is none: {error.message}") from error
    known = [world["world"] for world in worlds]
    for name in names:
        if name not in known:
            raise click.ClickException(f"there is no world {name!r} that this password opens: {', '.join(known)}")
    return [world for world in worlds if not names or world["world"] in names]


def _steer(client: Client, message: dict[str, Any]) -> None:
    """Enters a world and gives it a command, however long that takes."""
    try:
        with client:
            client.timeout = None
            client.request(message)
    except TimeoutError as error:
        raise click.ClickException(str(error)) from error
    except CommandFailed as error:
        raise click.ClickException(f"world {client.world!r}: {error.message}") from error


def _close(client: Client, name: str) -> None:
    """Closes a world for good, however long that takes."""
    client.timeout = None
    try:
        client.close_world(name)
    except CommandFailed as error:
        hint = ", or not the host's own" if error.code == "auth_failed" else ""
        raise click.ClickException(f"world {name!r} was not closed: {error.message}{hint}") from error


def _create(client: Client, name: str, template: str | None, seed: int | None) -> Any:
    """Creates a world, however long that takes; returns what is told of it."""
    client.timeout = None
    try:
        return client.create_world(name, template=template, seed=seed)
    except CommandFailed as error:
        raise click.ClickException(f"world {name!r} was not created: {error.message}") from error


def _row(world: Any) -> tuple[str, str, str, str, str, str]:
    if world["frame"] is None:
        frame = "not used yet"
    else:
        frame = str(world["frame"]) + (f", {world['fault']}" if world["fault"] else "")
    mode, ratio = world["mode"], world.get("ratio")  # older servers do not tell, nor of sleep
    if world.get("asleep"):
        mode += ", asleep"
    if ratio is not None:
        mode += f", lags: {ratio:.2f} of its pace"
    cells = world["world"], str(world["port"]), world["backend"], mode, frame, str(world["clients"])
    name, port, backend, mode, frame, clients = map(visible, cells)  # of a server, which may be anybody's
    return name, port, backend, mode, frame, clients
