"""What several commands share: moments, finite numbers, named values, and a group whose nameless command begins one."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING, Any

import click
import orjson
from click.shell_completion import CompletionItem

if TYPE_CHECKING:
    from nmes.recording import Recording

__all__ = ["MOMENT", "BeginningGroup", "FiniteRange", "Moment", "read_values"]


@dataclass(frozen=True, slots=True)
class Moment:
    """A moment of a recording, as somebody names it.

    Attributes:
        text: How it was written.
        number: Of the frame, counted on through resets; None where seconds were given.
        seconds: Since the recording began; None where a frame was given.
    """

    text: str
    number: int | None = None
    seconds: float | None = None

    def frame(self, recording: Recording) -> int:
        """Returns the frame of a recording that is meant."""
        if self.number is not None:
            return self.number
        assert self.seconds is not None
        return recording.start().frame + round(self.seconds * int(recording.config["tick_rate"]))

    def time(self, recording: Recording) -> float:
        """Returns how long after the beginning of a recording that is, s; below 0 where the recording begins later."""
        if self.seconds is not None:
            return self.seconds
        assert self.number is not None
        return float((self.number - recording.start().frame) / recording.config["tick_rate"])


class _MomentType(click.ParamType[Moment]):
    name = "frame|time"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Moment:
        """Reads `120`, a frame, and `2.0s`, a time."""
        if re.fullmatch(r"\d{1,18}", value, re.ASCII):
            return Moment(value, number=int(value))
        if re.fullmatch(r"\d{1,9}(\.\d{1,9})?s", value, re.ASCII):
            return Moment(value, seconds=float(value[:-1]))
        near = f"; did you mean {value}s?" if re.fullmatch(r"\d{1,9}\.\d{1,9}", value, re.ASCII) else ""
        self.fail(f"{value[:40]!r} is neither a frame nor a time, such as 120 or 2.0s{near}", param, ctx)


MOMENT = _MomentType()
"""The type of options that name a moment: a frame, or seconds with their unit."""


class FiniteRange(click.FloatRange):
    """A range of numbers in which `nan`, which is neither below nor above anything, is not, nor is infinity."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Reads a number in the range."""
        number = super().convert(value, param, ctx)
        if not isfinite(number):
            self.fail(f"{number} is no finite number", param, ctx)
        return number


class _Context(click.Context):
    """A context that is called as one types it, also where the last command has no name."""

    @property
    def command_path(self) -> str:
        return super().command_path.rstrip()


class _Command(click.Command):
    """A subcommand, or the nameless one."""

    context_class = _Context


class BeginningGroup(click.Group):
    """A group in which what is no subcommand begins a run."""

    command_class = _Command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Finds the subcommand, or the nameless one."""
        if args[0] in self.commands and args[0]:
            return super().resolve_command(ctx, args)
        return "", self.commands[""], args

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Completes subcommands, and what the nameless one begins with."""
        nameless = self.commands[""]
        first = nameless if incomplete.startswith("-") else nameless.params[0]
        return [*super().shell_complete(ctx, incomplete), *first.shell_complete(ctx, incomplete)]

    def format_help(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Shows the nameless command's help, and the subcommands."""
        self.commands[""].format_help(ctx, formatter)
        self.format_commands(ctx, formatter)


def read_values(texts: Iterable[str]) -> dict[str, Any]:
    """Reads `NAME=VALUE`, whose value is a number, true or false."""
    values: dict[str, Any] = {}
    for text in texts:
        name, _, value = text.partition("=")
        if name in values:
            raise click.BadParameter(f"{name} is set twice", param_hint="--set")
        try:
            values[name] = orjson.loads(value)
        except orjson.JSONDecodeError:
            message = f"{text!r} is not of the form NAME=VALUE, with a number, true or false"
            raise click.BadParameter(message, param_hint="--set") from None
    return values
