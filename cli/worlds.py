"""`nmes worlds`: list the worlds of a host."""

from __future__ import annotations

import ssl
from pathlib import Path
from typing import Any

import click
import orjson

from nmes.cli._address import split_address
from nmes.cli._password import PASSWORD_VARIABLE, choose_password, password_options
from nmes.client import Client


@click.command("worlds", short_help="List the worlds of a host.")
@click.argument("address", metavar="HOST:PORT", callback=split_address)
@password_options(f"The host's password; better in the variable {PASSWORD_VARIABLE}.")
@click.option("--tls", is_flag=True, help="Speak TLS.")
@click.option(
    "--tls-ca",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="Speak TLS, and trust the certificates in this PEM file.",
)
@click.option("--json", "as_json", is_flag=True, help="Print it as JSON.")
def command(
    address: tuple[str, int],
    password: str | None,
    password_file: Path | None,
    tls: bool,
    tls_ca: Path | None,
    as_json: bool,
) -> None:
    """List the worlds of a host: name, port, engine, mode, frame, clients.

    Looking creates none of them: a world that nobody has used yet has no frame.
    """
    host, port = address
    chosen = choose_password(password, password_file)
    if chosen is None:
        raise click.UsageError(f"give the host's password, in {PASSWORD_VARIABLE} or with --password-file")
    try:
        trust = ssl.create_default_context(cafile=tls_ca) if tls_ca is not None else tls
    except OSError as error:
        raise click.UsageError(f"{tls_ca}: {error}") from error
    try:
        worlds = Client(host, port, password=chosen[0], tls=trust).worlds()
    except TimeoutError as error:
        raise click.ClickException(str(error)) from error
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
    return (world["world"], str(world["port"]), world["backend"], world["mode"], frame, str(world["clients"]))
