"""How options of algorithms are judged: each number within its bounds, and all that are not told at once."""

from __future__ import annotations

from collections.abc import Mapping

from nmes.errors import DocumentError

__all__ = ["within_bounds"]


def within_bounds(options: object, bounds: Mapping[str, tuple[float, float]]) -> None:
    """Returns if every option that has bounds is within them.

    Args:
        options: A dataclass of options.
        bounds: The lowest and the highest value by name.

    Raises:
        DocumentError: Some are not; each problem has its place, `options.NAME`.
    """
    values = {name: getattr(options, name) for name in bounds}
    problems = [
        (f"options.{name}", f"must be from {low:,} to {high:,}, not {values[name]!r}")
        for name, (low, high) in bounds.items()
        if not low <= values[name] <= high
    ]
    if problems:
        raise DocumentError(problems)
