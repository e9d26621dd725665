"""The options of subcommands that connect to a server: its password, and whether to speak TLS."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from nmes.cli._password import PASSWORD_VARIABLE, choose_password, password_options

if TYPE_CHECKING:  # loaded by those that connect: `nmes replay` seldom does
    from nmes.client import AsyncClient, Client

__all__ = ["async_connector", "connection_options", "connector"]

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


def async_connector(
    password: str | None, password_file: Path | None, tls: bool, tls_ca: Path | None, timeout: float
) -> Callable[[tuple[str, int]], AsyncClient]:
    """Returns a function that makes a client of a server, not connected yet; the arguments are those of `connector`."""
    from nmes.client import AsyncClient

    choice = _choose(password, password_file)

    def make(address: tuple[str, int]) -> AsyncClient:
        return AsyncClient(*address, password=choice, tls=tls, tls_ca=tls_ca, timeout=timeout)

    _check(lambda: make(("127.0.0.1", 1)))
    return make


def _choose(password: str | None, password_file: Path | None) -> str:
    choice = choose_password(password, password_file)
    if choice is None:
        raise click.UsageError(f"give the host's password, in {PASSWORD_VARIABLE} or with --password-file")
    return choice[0]


def _check(make: Callable[[], object]) -> None:
    try:
        make()
    except (ValueError, OSError) as error:
        raise click.UsageError(str(error)) from error


def connector(
    address: tuple[str, int],
    password: str | None,
    password_file: Path | None,
    tls: bool,
    tls_ca: Path | None,
    timeout: float = 10.0,
    world: str | None = None,
) -> Callable[[], Client]:
    """Returns a function that makes a client, not connected yet, each time it is called.

    Args:
        address: The server's host and port.
        password: What --password says.
        password_file: What --password-file says.
        tls: Whether to speak TLS.
        tls_ca: A PEM file of certificates to trust; it implies `tls`.
        timeout: How long a reply may take, s.
        world: The name of one of the server's worlds; its first if None.

    Raises:
        UsageError: There is no password, or the certificates cannot be read.
    """
    from nmes.client import Client

    choice = _choose(password, password_file)
    make = partial(Client, *address, password=choice, world=world, tls=tls, tls_ca=tls_ca, timeout=timeout)
    _check(make)
    return make
