"""The option `--seeds`."""

from __future__ import annotations

from typing import Final

import click

__all__ = ["read_seeds"]

_MOST: Final = 100_000
_LAST: Final = 2**63 - 1  # as the schemas have it


def read_seeds(_: click.Context, parameter: click.Parameter, value: str | None) -> tuple[int, ...] | None:
    """Reads `1,2,3` and `0-9`."""
    if value is None:
        return None
    seeds: list[int] = []
    try:
        for part in value.split(","):
            first, _dash, last = part.strip().partition("-")
            begin, end = int(first), int(last or first) + 1
            if end - begin > _MOST - len(seeds):
                raise click.BadParameter(f"these are over {_MOST:,} seeds", param=parameter)
            if end - 1 > _LAST:
                raise click.BadParameter(f"a seed is at most {_LAST}", param=parameter)
            seeds += range(begin, end)
    except ValueError:
        raise click.BadParameter(
            f"{value!r} is no list of seeds; expected such as 1,2,3 or 0-9", param=parameter
        ) from None
    if not seeds or len(set(seeds)) < len(seeds):
        raise click.BadParameter("expected one seed or more, each once", param=parameter)
    return tuple(seeds)
