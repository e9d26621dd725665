"""`nmes fleet`: how many hosts fare."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import click

from nmes.cli._connection import async_connector, connection_options
from nmes.cli._json import print_json
from nmes.cli._options import FiniteRange
from nmes.client.address import read_address
from nmes.errors import visible
from nmes.fleet.status import HostStatus, ask_hosts
from nmes.schemas.documents import excerpt

__all__ = ["command"]

PORT = 14000
MOST = 10_000  # hosts
FAULTS = 3  # names of worlds that a line has


@click.group("fleet")
def command() -> None:
    """See how many hosts fare."""


@command.command("status")
@click.argument("hosts", metavar="[HOST[:PORT]...]", nargs=-1)
@click.option(
    "--hosts",
    "file",
    metavar="FILE",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="Also those in this file, one a line.",
)
@connection_options
@click.option(
    "--timeout",
    metavar="SECONDS",
    type=FiniteRange(0.01, 3600.0),
    default=10.0,
    show_default=True,
    help="How long one host may take to answer.",
)
@click.option("--json", "as_json", is_flag=True, help="Print it as JSON.")
def status(hosts: tuple[str, ...], file: Path | None, timeout: float, as_json: bool, **connection: Any) -> None:
    """Table how hosts fare: worlds, which of them are awake or asleep, clients, speed, lag and faults.

    All are asked side by side; no world is created, entered or woken. SLOWEST is how fast the slowest world runs, as a
    part of the pace asked for, and BEHIND how many fall behind. A host that does not answer is a row with the reason,
    and the status is 1 then.

    For example:

    \b
        nmes fleet status 10.0.0.5 10.0.0.6:14001 --password-file secret
        nmes fleet status --hosts hosts.txt --json
    """
    addresses = [_address(text, "") for text in hosts]
    if file is not None:
        addresses += _read(file)
    addresses = list(dict.fromkeys(addresses))
    if not addresses:
        raise click.UsageError("say which hosts: HOST[:PORT], or --hosts FILE")
    if len(addresses) > MOST:
        raise click.UsageError(f"{len(addresses):,} hosts are more than {MOST:,}")
    connect = async_connector(timeout=timeout, **connection)
    found = asyncio.run(ask_hosts([connect(address) for address in addresses], timeout))
    if as_json:
        print_json([each._asdict() for each in found])
    else:
        _print(found)
    if any(each.error is not None for each in found):
        click.get_current_context().exit(1)


def _read(file: Path) -> list[tuple[str, int]]:
    """Returns the addresses in a file; empty lines and what stands behind # are none."""
    try:
        lines = [line.partition("#")[0].strip() for line in file.read_text("utf-8").splitlines()]
    except UnicodeDecodeError as error:
        raise click.UsageError(f"{file}: not a text in UTF-8") from error
    return [_address(line, f"{file}, line {number}: ") for number, line in enumerate(lines, 1) if line]


def _address(text: str, where: str) -> tuple[str, int]:
    """Returns host and port of HOST or HOST:PORT, where HOST may be an IPv6 address in brackets."""
    try:
        return read_address(text, PORT)
    except ValueError as error:
        what = f"expected HOST or HOST:PORT, such as 10.0.0.5 or [::1]:14000, got {excerpt(text)}: {error}"
        raise click.UsageError(f"{where}{what}") from error


def _print(found: list[HostStatus]) -> None:
    """Prints a table with a line for each host, and one with the sums of several."""
    head = ("HOST", "WORLDS", "AWAKE", "ASLEEP", "CLIENTS", "SLOWEST", "BEHIND", "FAULTS")
    rows = [head, *map(_row, found)]
    if len(found) > 1:
        known = [each for each in found if each.error is None]
        counts = [
            *(sum(each.worlds for each in known), sum(each.awake for each in known)),
            *(sum(each.asleep for each in known), sum(each.clients for each in known)),
        ]
        slowest = min((each.ratio for each in known), default=1.0)
        behind, faults = sum(each.lagging for each in known), sum(len(each.faulted) for each in known)
        rows.append((f"{len(known)} of {len(found)}", *map(str, counts), f"{slowest:.2f}", str(behind), str(faults)))
    widths = [max(map(len, column)) for column in zip(*(row for row in rows if len(row) == len(head)), strict=True)]
    widths[0] = max(len(row[0]) for row in rows)
    for row in rows:
        cells = [f"{cell:<{width}}" for cell, width in zip(row, widths, strict=False)]  # an error has two cells
        click.echo("  ".join(cells).rstrip())


def _row(each: HostStatus) -> tuple[str, ...]:
    address = f"[{each.host}]:{each.port}" if ":" in each.host else f"{each.host}:{each.port}"
    if each.error is not None:
        return (address, visible(each.error))
    names = ", ".join(map(visible, each.faulted[:FAULTS])) + (", ..." if len(each.faulted) > FAULTS else "")
    faults = f"{len(each.faulted)}: {names}" if each.faulted else "0"
    counts = map(str, (each.worlds, each.awake, each.asleep, each.clients))
    return (address, *counts, f"{each.ratio:.2f}", str(each.lagging), faults)
