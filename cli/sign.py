"""`nmes sign`: vouch for a recording."""

from __future__ import annotations

from pathlib import Path

import click

from nmes.cli.info import open_recording
from nmes.errors import visible
from nmes.recording import Recording
from nmes.recording.signing import private_key, sign

__all__ = ["command"]


@click.command("sign")
@click.argument("recording", metavar="FILE", callback=open_recording)
@click.option(
    "--key",
    required=True,
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Ed25519 private key, PEM without a passphrase.",
)
@click.option(
    "-o", "--output", type=click.Path(dir_okay=False, path_type=Path), help="The signature's file.  [default: FILE.sig]"
)
def command(recording: Recording, key: Path, output: Path | None) -> None:
    """Vouch for a recording with an Ed25519 key.

    The signature is a file of its own, by default beside the recording. A recording is signed only if it is whole;
    `nmes verify --verify-key` checks it.

    For example:

    \b
        nmes sign run.mcap --key ada.pem
    """
    click.echo(visible(f"signed: {sign(recording, private_key(key), output)}"))
