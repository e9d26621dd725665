"""What commands that begin runs have in common: a group whose nameless command begins one, and options by name."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import click
import orjson
from click.shell_completion import CompletionItem

__all__ = ["BeginningGroup", "read_values"]


class BeginningGroup(click.Group):
    """A group in which what is no subcommand begins a run."""

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
