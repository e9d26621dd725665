"""`nmes completion`: what makes a shell complete commands, options, files and names."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

from nmes.cli._completion import VARIABLE

__all__ = ["command"]


@click.command("completion")
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
@click.pass_context
def command(context: click.Context, shell: str) -> None:
    """Print what makes a shell complete.

    Commands, options and their values, files, and the names of the genomes and tasks that ship. What is printed is for
    the shell to read when it starts, as from ~/.bashrc, ~/.zshrc or ~/.config/fish/completions/nmes.fish:

    \b
        eval "$(nmes completion bash)"
        eval "$(nmes completion zsh)"
        nmes completion fish | source

    For example:

    \b
        nmes completion bash >> ~/.bash_completion
    """
    completion = get_completion_class(shell)
    assert completion is not None
    click.echo(completion(context.find_root().command, {}, "nmes", VARIABLE).source())
