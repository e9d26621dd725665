"""The option `--seed` of commands that prove something by doing a sample of it again."""

from __future__ import annotations

import click

__all__ = ["SEED", "drawn_by"]

SEED = click.option(
    "--seed", metavar="S", type=click.IntRange(0), help="Of the draw of these.  [default: another each time]"
)


def drawn_by(seed: int, again: int, of: int) -> str:
    """Returns the option that draws the same sample, to stand after a count; nothing where all or none were drawn."""
    return f", drawn by --seed {seed}" if 0 < again < of else ""
