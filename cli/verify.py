"""`nmes verify`: check that a recording is as it was written."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import click
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from rich.filesize import decimal

from nmes import protocol
from nmes.cli._each_file import File, Finding, files_argument, report_each
from nmes.cli.info import open_recording
from nmes.errors import SigningError
from nmes.recording import Recording
from nmes.recording.signing import check_signature, public_key

__all__ = ["command"]


@click.command("verify")
@files_argument(open_recording)
@click.option(
    "--verify-key",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Ed25519 public key (PEM) of who must have signed it.",
)
@click.option(
    "--signature",
    type=click.Path(dir_okay=False, path_type=Path),
    help="With --verify-key: the signature's file.  [default: FILE.sig]",
)
@click.option("--json", "as_json", is_flag=True, help="Print the report as JSON.")
def command(files: list[File[Recording]], verify_key: Path | None, signature: Path | None, as_json: bool) -> None:
    """Check that a recording is as it was written.

    Checks its structure, checksums, the hash chain over everything in it, and its end, and names the first record
    that is not as it was written. This says nothing of whether the run comes out the same: that is `nmes replay`.
    Several files get a line each; as JSON one object, or a list of them.

    Exit status: 0 sound, 1 cut, damaged or not signed by that key, 2 wrong usage or no recording at all; of several
    files 1 if it is that of one, else 2.

    For example:

    \b
        nmes verify run.mcap
        nmes verify recordings/*.mcap
        nmes verify run.mcap --verify-key ada-public.pem
    """
    if signature is not None and verify_key is None:
        raise click.UsageError("--signature needs --verify-key")
    if signature is not None and len(files) > 1:
        raise click.UsageError("--signature is that of one file; those of several lie beside them, as FILE.sig")
    key = public_key(verify_key) if verify_key is not None else None
    sys.exit(report_each(files, lambda recording: _judge(recording, key, signature), as_json))


def _judge(recording: Recording, key: Ed25519PublicKey | None, signature: Path | None) -> Finding:
    report = _check(recording, key, signature)
    return Finding(report, _lines(report), 0 if report["verdict"] == "sound" and report["signed"] is not False else 1)


def _check(recording: Recording, key: Ed25519PublicKey | None, signature: Path | None) -> dict[str, Any]:
    began = time.perf_counter()
    damage = recording.damage
    wall_seconds = time.perf_counter() - began
    signed: bool | None = None
    reason: str | None = None
    if key is not None:
        try:
            check_signature(recording, key, signature)
            signed = True
        except SigningError as error:
            signed, reason = False, error.message
    return {
        "verdict": "sound" if damage is None else "cut" if damage.cut else "damaged",
        "damage": None if damage is None else damage.message,
        "offset": None if damage is None else damage.offset,
        "record": None if damage is None else damage.record,
        "head": recording.end.get("head"),
        "records": int(recording.end["records"]) if recording.end else None,
        "own_schemas": recording.metadata["nmes.recording"]["schemas"] == protocol.schema_hash(),
        "written_by": recording.metadata["nmes.recording"]["nmes"],
        "signed": signed,
        "not_signed": reason,
        "size": recording.size,
        "wall_seconds": wall_seconds,
    }


def _lines(report: dict[str, Any]) -> list[str]:
    if report["verdict"] == "sound":
        speed = decimal(int(report["size"] / max(report["wall_seconds"], 1e-9)))
        lines = [f"sound: {report['records']:,} records, {speed}/s", f"  head of the chain: {report['head']}"]
    else:
        lines = [f"{'incomplete' if report['verdict'] == 'cut' else 'DAMAGED'}: {report['damage']}"]
    if not report["own_schemas"]:
        lines.append(f"  its messages have the schemas of another nmes ({report['written_by']})")
    if report["signed"] is not None:
        not_signed = f"NOT SIGNED with that key: {report['not_signed']}"
        lines.append("signed with that key" if report["signed"] else not_signed)
    return lines
