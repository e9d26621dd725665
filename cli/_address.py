"""The argument HOST:PORT, by which subcommands find a server."""

from __future__ import annotations

import click

__all__ = ["split_address"]


def split_address(context: click.Context, parameter: click.Parameter, value: str | None) -> tuple[str, int] | None:
    """Returns host and port of HOST:PORT; None for None."""
    if value is None:
        return None
    host, _, port = value.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) <= 65535:
        raise click.BadParameter("expected HOST:PORT, such as 127.0.0.1:14000", context, parameter)
    return host.removeprefix("[").removesuffix("]"), int(port)
