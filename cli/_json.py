"""JSON on standard output."""

from __future__ import annotations

import json
import re
from typing import Any

import click
import orjson

__all__ = ["print_json"]

# orjson escapes no more of the characters that do not print than it must: those below the space.
_OTHERS = re.compile(r"[^\n -~]+")


def print_json(value: Any) -> None:
    """Prints plain data as JSON, indented; characters that do not print are escaped."""
    try:
        text = orjson.dumps(value, option=orjson.OPT_INDENT_2).decode()
    except TypeError:  # an integer of more than 64 bits, as a stranger's server may have one
        text = json.dumps(value, ensure_ascii=False, allow_nan=False, indent=2)
    click.echo(_OTHERS.sub(lambda run: _escaped(run[0]), text))


def _escaped(text: str) -> str:
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else json.dumps(c)[1:-1] for c in text)
