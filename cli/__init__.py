"""The `nmes` command: one file a subcommand, loaded only when it is used, and one place where errors become messages.

A subcommand's file exposes a click command named `command`. Exit codes: 0 good, 1 failed or diverged, 2 wrong usage,
3 not comparable: a recording that does not come out here as it did where the engine or the machine was another.
"""

from __future__ import annotations

import codecs
import errno
import gc
import importlib
import json
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from io import TextIOWrapper
from typing import Any, Final, cast

try:
    import click

    from nmes.cli._completion import complete_arguments, is_completing
    from nmes.cli._interruptions import keep_in_mind
    from nmes.errors import NmesError, visible
except KeyboardInterrupt:  # later ones are click's to tell, in the same words
    sys.exit("Aborted!")

__all__ = ["main"]

# Each subcommand with what `nmes --help` says of it (a test compares): importing them all takes seconds.
SUBCOMMANDS = {
    "backends": "List the physics engines that are installed.",
    "completion": "Print what makes a shell complete.",
    "conform": "Judge a server by the protocol.",
    "conform-client": "Judge a client by the protocol.",
    "corpus": "Keep evolved creatures with the proofs of their scores.",
    "diff": "Compare two recordings.",
    "doctor": "See whether everything is as it must be.",
    "eval": "Score creatures on a task.",
    "evolve": "Evolve creatures, in runs that anyone can repeat.",
    "export": "Write recordings as data for other programs.",
    "fleet": "See how many hosts fare.",
    "fork": "Take the world out of a recording as it was at a frame.",
    "genome": "List, check, show and vary genomes.",
    "info": "Show what a recording holds.",
    "lab": "Work with worlds, creatures and runs in a browser.",
    "leaderboard": "Keep a list of scores that are proved.",
    "learn": "Train a creature's brain, in runs that anyone can repeat.",
    "measure": "Measure what things cost on this machine.",
    "play": "Run a creature on a task and film it.",
    "render": "Make a film or a picture of recordings.",
    "replay": "Run a recording again and compare.",
    "serve": "Host worlds that clients drive over TCP.",
    "sign": "Vouch for a recording with an Ed25519 key.",
    "study": "Test claims in studies that anyone can repeat.",
    "survey": "Score creatures in thousands of worlds.",
    "tasks": "List the tasks that creatures can be put to.",
    "tournament": "Have creatures play each other, and rate them.",
    "verify": "Check that a recording is as it was written.",
    "view": "Look at live worlds and at recordings.",
    "worlds": "List and steer the worlds of a host.",
}

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # standard output leads to a disk that is full
_NO_DESCRIPTORS = (errno.EMFILE, errno.ENFILE)
_ESCAPED: Final = "nmes.escaped"


class _NotComparable(click.ClickException):
    exit_code = 3


_FAILURES: Final[dict[str, type[click.ClickException]]] = {
    "not_comparable": _NotComparable,
    # To name a folder that holds none is wrong usage: 1 would say of a run that it is broken, or was interrupted.
    "no_run": click.UsageError,
    "no_study": click.UsageError,
}
"""What errors of the library become, by their codes; else a plain failure."""


def _escape(error: UnicodeError) -> tuple[str, int]:
    """Returns letters that cannot be encoded as JSON has them, which people understand too, and where they end."""
    assert isinstance(error, UnicodeEncodeError)
    return json.dumps(error.object[error.start : error.end])[1:-1], error.end


def _take_every_letter() -> None:
    """Lets the output of this process hold every letter: those that its encoding lacks are escaped.

    ASCII becomes UTF-8, as click has it for what it writes itself: it is nearly always a locale that was forgotten.
    """
    codecs.register_error(_ESCAPED, _escape)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            ascii_only = codecs.lookup(stream.encoding).name == "ascii"
            stream.reconfigure(encoding="utf-8" if ascii_only else None, errors=_ESCAPED)


class _Group(click.Group):
    def main(self, args: Sequence[str] | None = None, *more: Any, **extra: Any) -> Any:
        if args is None:  # those of the process, which is this command's own
            try:
                keep_in_mind()
            except KeyboardInterrupt:  # one was held back
                sys.exit("Aborted!")
            _take_every_letter()
            # Most of what a command makes are modules, which stay: they are not to be looked through again and again.
            gc.set_threshold(10_000)
            # MuJoCo would load a library for windows, by a process of its own. Cameras ask for OpenGL in another way.
            os.environ.setdefault("MUJOCO_GL", "disable")
        return super().main(args, *more, **extra)

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted(SUBCOMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in SUBCOMMANDS:
            return None
        command = cast(click.Command, importlib.import_module(f"nmes.cli.{cmd_name.replace('-', '_')}").command)
        if is_completing():
            complete_arguments(command)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(sorted(SUBCOMMANDS.items()))

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except click.ClickException as error:  # the message may repeat what a stranger has named
            vars(error)["message"] = visible(error.message, keep="\n")  # to type checkers it is final
            raise
        except NmesError as error:
            failure = _FAILURES.get(error.code, click.ClickException)
            raise failure(visible(error.message, keep="\n")) from error
        except TimeoutError as error:  # of a server that does not answer
            raise click.ClickException(visible(str(error))) from error
        except OSError as error:
            if error.errno in _FULL:
                with suppress(OSError):
                    sys.stdout.close()  # what it still holds would be tried again at the end
                raise click.ClickException(f"cannot write: {error.strerror}") from error
            if error.errno in _NO_DESCRIPTORS:  # of whichever file that was
                raise click.ClickException("too many open files: allow more, as with `ulimit -n 1024`") from error
            if error.filename is None:  # about no file that somebody has named
                raise
            raise click.ClickException(visible(f"{error.filename}: {error.strerror}")) from error


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(None, "-V", "--version", package_name="nmes", message="%(prog)s %(version)s")
def main() -> None:
    """Deterministic worlds of cubes and joints, driven over TCP, recorded and reproduced."""
