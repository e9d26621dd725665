"""The argument HOST:PORT, by which subcommands find a server."""

from __future__ import annotations

import click

__all__ = ["split_address"]


def split_address(context: click.Context, parameter: click.Parameter, value: str | None) -> tuple[str, int] | None:
    """Returns host and port of HOST:PORT; None for None."""
    if value is None:
        return None
    from nmes.client.address import read_address

    try:
        return read_address(value)
    except ValueError as error:
        raise click.BadParameter(f"expected HOST:PORT, such as 127.0.0.1:14000: {error}", context, parameter) from error
