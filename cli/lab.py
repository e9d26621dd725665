"""`nmes lab`: worlds, creatures, runs and recordings in a browser."""

from __future__ import annotations

import asyncio
import gc
import json
import secrets
import signal
import sys
import threading
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING

import click

from nmes.cli import _logs
from nmes.cli._password import choose_password
from nmes.errors import visible

if TYPE_CHECKING:
    from nmes.lab.folder import Folder

__all__ = ["command"]

SWITCH = 0.0005  # s: for how long a world's thread keeps Python's lock from the event loop; 0.005 would be usual
COLLECTIONS = (10_000, 20, 20)  # of garbage, less often than usual: a full one takes long where there are many cubes
JOBS = 4  # commands that may run at once


@click.command("lab")
@click.option(
    "--dir",
    "folder",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("lab"),
    show_default=True,
    help="Folder for what it keeps: recordings, runs, genomes, tasks, leaderboards.",
)
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on.")
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=8000,
    show_default=True,
    help="Port for the browser; 0 finds a free one.",
)
@click.option("--no-open", is_flag=True, help="Open no browser.")
@click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON object when ready, for scripts; opens no browser."
)
def command(folder: Path, host: str, port: int, no_open: bool, as_json: bool) -> None:
    """Work with worlds, creatures and runs in a browser.

    Prints an address with a token in it, which opens the lab to whoever has it, and opens it. Worlds are served over
    TCP too, on a port of their own, with the password in NMES_PASSWORD or one that is made up. What a page does, a
    command line or a message does as well; the page shows which. Runs that were begun in it are stopped with it, and
    can be gone on with. Ctrl-C ends it.

    For example:

    \b
        nmes lab
        nmes lab --dir school --port 8080 --no-open
    """
    from nmes.lab.folder import Folder

    sys.setswitchinterval(SWITCH)
    gc.set_threshold(*COLLECTIONS)
    _logs.set_up("text")
    try:
        kept = Folder(folder)
    except OSError as error:
        raise click.ClickException(f"cannot make the folder {folder}: {error.strerror}") from error
    asyncio.run(_run(kept, host, port, no_open or as_json, as_json))


async def _run(folder: Folder, address: str, port: int, quiet: bool, as_json: bool) -> None:
    """Serves a lab until a signal comes."""
    from nmes.lab.lab import open_lab
    from nmes.lab.server import PAGES, UNBUILT, application, new_token

    signals: asyncio.Queue[signal.Signals] = asyncio.Queue()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:  # as nohup leaves it
            asyncio.get_running_loop().add_signal_handler(number, signals.put_nowait, number)
    chosen = choose_password(None, None)
    password = secrets.token_urlsafe(16) if chosen is None else chosen[0]
    token = new_token()
    async with open_lab(folder, password, JOBS) as lab:
        lab.port = (await lab.host.listen(address, 0))[1]
        _, port = await lab.host.serve_http(address, port, application(lab, token, password, [address]))
        name = f"[{address}]" if ":" in address else address
        url = f"http://{name}:{port}/?token={token}"
        if as_json:
            click.echo(json.dumps({"url": url, "port": port, "host_port": lab.port, "token": token}))
        else:
            click.echo(f"The lab is at {url}")
            kept = f"It keeps what it has in {folder.path}; its worlds are on port {lab.port} too. Ctrl-C stops"
            click.echo(visible(kept))
        if not (PAGES / "index.html").is_file():
            click.echo(UNBUILT, err=True)
        if not quiet:
            # Text browsers keep who opens them waiting until they are left.
            threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()
        await signals.get()
