"""Tables of plain text."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["columns"]


def columns(rows: Sequence[tuple[str, ...]], right: tuple[int, ...] = ()) -> list[str]:
    """Lays rows out as lines, each cell as wide as the widest of its column.

    Args:
        rows: One or more, all of the same length.
        right: The columns whose cells stand at the right.
    """
    # By hand: a table of rich takes seconds for what is here a moment, where there are thousands.
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            cell.rjust(width) if i in right else cell.ljust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
