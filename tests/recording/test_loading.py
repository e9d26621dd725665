"""Reading, verifying and signing a recording load neither a world nor an engine."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from recordings import busy, record

CORPUS = Path(__file__).parents[2] / "replays" / "pymunk-clients.mcap"

REPORT_MODULES = """
import sys
kinds = ("nmes.world", "nmes.backends", "nmes.playback", "mujoco", "pymunk")
loaded = [name for name in sys.modules for kind in kinds if name == kind or name.startswith(kind + ".")]
print("loaded:", *sorted(loaded))
"""
LIBRARY = """
import sys
from nmes.recording import Recorder, Recording
from nmes.recording.signing import check_signature, sign
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
recording = Recording(sys.argv[1])
assert recording.complete and recording.summary().ticks > 0 and recording.start().frame == 0
assert len(list(recording)) > 0 and recording.last_frame > 0
key = Ed25519PrivateKey.generate()
check_signature(recording, key.public_key(), sign(recording, key, sys.argv[2]))
"""
COMMAND_LINE = """
import sys
from nmes.cli import main
main(sys.argv[1:], standalone_mode=False)
"""


def modules_loaded_by(program: str, *arguments: str | Path) -> list[str]:
    """Runs a program in a process of its own and returns the modules of worlds and engines that it loaded."""
    guarded = f"try:\n{_indented(program)}\nexcept SystemExit as end:\n    assert not end.code, end.code\n"
    command = [sys.executable, "-c", guarded + REPORT_MODULES, *map(str, arguments)]
    process = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert process.returncode == 0, process.stderr
    *_, last = process.stdout.splitlines()
    label, *names = last.split()
    assert label == "loaded:"
    return names


def _indented(program: str) -> str:
    return "\n".join(f"    {line}" for line in program.strip().splitlines())


def test_the_library_reads_verifies_and_signs_without_worlds_or_engines(tmp_path: Path) -> None:
    assert modules_loaded_by(LIBRARY, CORPUS, tmp_path / "x.sig") == []


@pytest.mark.parametrize("command", ["verify", "info", "sign"])
def test_the_command_line_reads_verifies_and_signs_without_worlds_or_engines(command: str, tmp_path: Path) -> None:
    key = tmp_path / "key.pem"
    private = Ed25519PrivateKey.generate()
    key.write_bytes(private.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    options: list[str | Path] = ["--key", key, "-o", tmp_path / "x.sig"] if command == "sign" else []
    assert modules_loaded_by(COMMAND_LINE, command, CORPUS, *options) == []


def test_a_module_of_worlds_that_is_loaded_is_seen(tmp_path: Path) -> None:
    path = record(tmp_path / "busy.mcap", busy)
    assert "nmes.world.journal" in modules_loaded_by(LIBRARY + "import nmes.world.journal\n", path, tmp_path / "x.sig")
