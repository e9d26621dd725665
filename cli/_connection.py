"""What subcommands that connect to a server are told: its address, its password, and whether to speak TLS."""

from __future__ import annotations

import ssl
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from nmes.cli._password import PASSWORD_VARIABLE, choose_password, password_options
from nmes.client import Client

__all__ = ["connection_options", "connector"]

F = TypeVar("F", bound=Callable[..., Any])


def connection_options(function: F) -> F:
    """Adds `--password`, `--password-file`, `--tls` and `--tls-ca`, for `connector` to take."""
    authority = click.option(
        "--tls-ca",
        type=click.Path(path_type=Path, exists=True, dir_okay=False),
        help="Speak TLS, and trust the certificates in this PEM file.",
    )
    plain = click.option("--tls", is_flag=True, help="Speak TLS.")
    password = password_options(f"The host's password; better in the variable {PASSWORD_VARIABLE}.")
    return password(plain(authority(function)))


def connector(
    address: tuple[str, int],
    password: str | None,
    password_file: Path | None,
    tls: bool,
    tls_ca: Path | None,
    timeout: float = 10.0,
    world: str | None = None,
) -> Callable[[], Client]:
    """Returns what makes a client for a server's world, its first if None, not connected yet, each time it is called.

    Raises:
        UsageError: There is no password, or the certificates cannot be read.
    """
    chosen = choose_password(password, password_file)
    if chosen is None:
        raise click.UsageError(f"give the host's password, in {PASSWORD_VARIABLE} or with --password-file")
    try:
        trust = ssl.create_default_context(cafile=tls_ca) if tls_ca is not None else tls
    except OSError as error:
        raise click.UsageError(f"{tls_ca}: {error}") from error
    return lambda: Client(*address, password=chosen[0], world=world, tls=trust, timeout=timeout)
