"""How options of algorithms are judged: each number within its bounds, all that are not told at once; and together."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, get_type_hints

from nmes.errors import DocumentError
from nmes.schemas.documents import did_you_mean

__all__ = ["read_options", "within_bounds", "within_memory"]

_WORDS: Final[Mapping[type, str]] = {
    int: "a whole number, written without point or exponent",
    float: "a number",
    bool: "true or false",
}


def read_options(name: str, kind: type[Any], given: Mapping[str, Any]) -> Any:
    """Returns the options of an algorithm: some as given, the others at their defaults.

    Args:
        name: The algorithm's.
        kind: A dataclass, each of whose fields has a type and a default.
        given: Values by name; a whole number may stand for a float.

    Raises:
        DocumentError: There is no such option, or it is not what it must be; each problem has its place.
    """
    types, problems, values = get_type_hints(kind), [], dict(given)
    for option, value in given.items():
        if option not in types:
            hint = did_you_mean(option, types) or f": there are {', '.join(types)}"
            problems.append((f"options.{option}", f"{name!r} has no such option{hint}"))
        elif types[option] is float and type(value) is int:
            values[option] = float(value)
        elif type(value) is not types[option]:
            problems.append((f"options.{option}", f"must be {_WORDS[types[option]]}, not {value!r}"))
    if problems:
        raise DocumentError(problems)
    return kind(**values)


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


def within_memory(option: str, numbers: int, most: int) -> None:
    """Returns if what an algorithm would keep in memory is within bounds.

    Args:
        option: The option that is to be smaller where it is not.
        numbers: How many numbers it would keep, for this brain and these options together.
        most: How many it may.

    Raises:
        DocumentError: They are too many.
    """
    if numbers > most:
        words = f"makes {numbers:,} numbers to be kept in memory with this brain, and {most:,} is the most"
        raise DocumentError([(f"options.{option}", words)])
