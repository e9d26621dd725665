"""`nmes view` of a host in this process, run as a program of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from nmes.cli._password import PASSWORD_VARIABLE
from nmes.view.screen import has_display

__all__ = ["viewer"]

VIEWER_ENDS = 10.0  # s that it has


@contextmanager
def viewer(address: str, port: int, password: str, tls_cert: Path | None, quiet: bool) -> Iterator[None]:
    """Runs `nmes view` of a host here, as a program of its own so that it takes nothing from the worlds' threads.

    Args:
        address: The address that the host listens on.
        port: Its port.
        password: Its password.
        tls_cert: Its certificate, which is trusted; None: no TLS.
        quiet: Whether standard output is for others: the viewer then prints to standard error.
    """
    here = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(address, address)
    target = f"[{here}]:{port}" if ":" in here else f"{here}:{port}"
    options = [] if has_display() else ["--web"]
    if tls_cert is not None:
        options += ["--tls-ca", str(tls_cert)]
    # A session of its own: Ctrl-C is for the host, which then ends the viewer, once.
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", "from nmes.cli import main; main()", "view", target, *options],
        env={**os.environ, PASSWORD_VARIABLE: password},
        stdout=sys.stderr.fileno() if quiet else None,
        start_new_session=True,
    )
    try:
        yield
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(VIEWER_ENDS)
        except subprocess.TimeoutExpired:
            process.kill()
