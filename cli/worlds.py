"""`nmes worlds`: list the worlds of a host."""

from __future__ import annotations

from typing import Any

import click
import orjson

from nmes.cli._address import split_address
from nmes.cli._connection import connection_options, connector
from nmes.errors import RejectedMessage
from nmes.protocol import validate_reply


@click.command("worlds", short_help="List the worlds of a host.")
@click.argument("address", metavar="HOST:PORT", callback=split_address)
@connection_options
@click.option("--json", "as_json", is_flag=True, help="Print it as JSON.")
def command(
    address: tuple[str, int],
    as_json: bool,
    **connection: Any,
) -> None:
    """List the worlds of a host: name, port, engine, mode, frame, clients, and which of them fall behind the clock.

    Looking creates none of them: a world that nobody has used yet has no frame.

    For example:

    \b
        nmes worlds 127.0.0.1:14000 --password-file secret
    """
    client = connector(address, **connection)()
    try:
        worlds = client.worlds()
    except TimeoutError as error:
        raise click.ClickException(str(error)) from error
    try:
        validate_reply({"type": "world_list", "worlds": worlds})
    except RejectedMessage as error:
        host, port = address
        raise click.ClickException(f"{host}:{port} is no NMES server: its answer is none: {error.message}") from error
    if as_json:
        click.echo(orjson.dumps(worlds, option=orjson.OPT_INDENT_2))
        return
    rows = [("WORLD", "PORT", "ENGINE", "MODE", "FRAME", "CLIENTS")]
    rows += [_row(world) for world in worlds]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        click.echo("  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)).rstrip())


def _row(world: Any) -> tuple[str, str, str, str, str, str]:
    if world["frame"] is None:
        frame = "not used yet"
    else:
        frame = str(world["frame"]) + (f", {world['fault']}" if world["fault"] else "")
    mode, ratio = world["mode"], world.get("ratio")  # older servers do not tell
    if ratio is not None:
        mode += f", lags: {ratio:.2f} of its pace"
    return (world["world"], str(world["port"]), world["backend"], mode, frame, str(world["clients"]))
