"""The option for the size of films and pictures."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import click

__all__ = ["size_option"]

_PIXELS = 4096


def _size(_: click.Context, parameter: click.Parameter, value: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,4})x(\d{1,4})", value)
    if match is None or not all(16 <= int(number) <= _PIXELS for number in match.groups()):
        raise click.BadParameter(f"expected WIDTHxHEIGHT, each from 16 to {_PIXELS}: 640x480", param=parameter)
    return int(match[1]), int(match[2])


def size_option(default: str) -> Callable[[Any], Any]:
    """Returns the option `--size`, which gives width and height in pixels."""
    what = "Of all of it, in pixels."
    return click.option("--size", callback=_size, default=default, show_default=True, metavar="WxH", help=what)
