"""The option `--seeds`."""

from __future__ import annotations

import click

__all__ = ["read_seeds"]


def read_seeds(_: click.Context, parameter: click.Parameter, value: str | None) -> tuple[int, ...] | None:
    """Reads `1,2,3` and `0-9`."""
    if value is None:
        return None
    seeds: list[int] = []
    try:
        for part in value.split(","):
            first, _dash, last = part.strip().partition("-")
            seeds += range(int(first), int(last or first) + 1)
    except ValueError:
        raise click.BadParameter(
            f"{value!r} is no list of seeds; expected such as 1,2,3 or 0-9", param=parameter
        ) from None
    if not seeds or len(set(seeds)) < len(seeds):
        raise click.BadParameter("expected one seed or more, each once", param=parameter)
    return tuple(seeds)
