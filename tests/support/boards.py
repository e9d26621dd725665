"""Leaderboards for tests: a short task, recordings that prove something on it, and the program that keeps them."""

from __future__ import annotations

import json
import sqlite3
from pathlib import Path
from typing import Any

from click.testing import CliRunner, Result
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from nmes.cli import main
from nmes.evaluation import Task, evaluate, leaderboard_entry
from nmes.evaluation.leaderboard import Leaderboard
from nmes.genome import Genome

DASH: dict[str, Any] = {
    "format": "nmes-task/1",
    "name": "dash",
    "description": "Get away from the start.",
    "duration": 0.5,
    "seeds": [3, 4],
    "vary": {"yaw": [-1, 1], "drop": [0.01, 0.1]},
    "objective": "displacement.horizontal",
}


def run(*arguments: str | Path) -> Result:
    """Runs `nmes leaderboard`; a traceback is a failure, and so is a character that does not print."""
    result = CliRunner().invoke(main, ["leaderboard", *map(str, arguments)])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    assert all(line.isprintable() for line in result.output.split("\n")), ascii(result.output)
    return result


def verdicts(board: Path, *options: str) -> tuple[int, dict[str, tuple[str, str]]]:
    """Verifies a board; returns the exit status, and by the name of each entry its verdict and the reason."""
    result = run("verify", board, "--jobs", "1", "--json", *options)
    assert result.stdout, result.output
    return result.exit_code, {row["name"]: (row["verdict"], row["reason"] or "") for row in json.loads(result.stdout)}


def proofs_of(folder: Path, genome: dict[str, Any], task: dict[str, Any] = DASH) -> list[str]:
    folder.mkdir(exist_ok=True)
    evaluation = evaluate(Genome(genome), Task(task), record=folder)
    assert evaluation.error is None and evaluation.faults == 0
    return list(evaluation.recordings)


def edit(board: Path, *statements: str) -> None:
    with sqlite3.connect(board) as database:
        for statement in statements:
            database.execute(statement)
    database.close()


def entries_of(board: Path, *, broken: bool = False) -> list[leaderboard_entry.Entry]:
    with Leaderboard(board) as opened:
        return opened.entries(broken=broken)


def entry(board: Path, name: str = "wave") -> leaderboard_entry.Entry:
    (found,) = (each for each in entries_of(board, broken=True) if each.name == name)
    return found


def recording_of(board: Path, name: str) -> Path:
    with Leaderboard(board) as opened:
        return opened.recording(name)


def key_in(path: Path, seed: int) -> Path:
    key = Ed25519PrivateKey.from_private_bytes(bytes([seed]) * 32)
    path.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    return path


def signed(recordings: list[str], key: Path) -> list[str]:
    for recording in recordings:
        done = CliRunner().invoke(main, ["sign", recording, "--key", str(key)])
        assert done.exit_code == 0, done.output
    return recordings
