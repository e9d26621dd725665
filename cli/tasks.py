"""`nmes tasks`: list the tasks that come with the package, or show one."""

from __future__ import annotations

import click
from rich.console import Console
from rich.table import Table

from nmes.cli._json import print_json
from nmes.errors import DocumentError, visible
from nmes.evaluation import MatchTask, Task
from nmes.evaluation.match_task import load_task
from nmes.evaluation.setting import limit_words

__all__ = ["command"]


@click.command("tasks")
@click.argument("name", required=False)
@click.option("--json", "as_json", is_flag=True, help="Print the documents as JSON: a list, or one by itself.")
def command(name: str | None, as_json: bool) -> None:
    """List the tasks that creatures can be put to.

    With NAME (of one that comes with the package, or a file) it shows that one: what is asked, its objective, what ends
    it, its limits, what may happen to bodies, and what its seeds decide. As JSON it is a beginning for one of your own,
    with a name of its own.

    For example:

    \b
        nmes tasks
        nmes tasks walk --json > mine.json
    """
    if name is not None:
        try:
            task = load_task(name)
        except DocumentError as error:
            raise click.UsageError(f"{visible(name)}:\n{error.message}") from error
        if as_json:
            print_json(task.document)
        else:
            _show(task)
        return
    tasks: list[Task | MatchTask] = [Task.load(name) for name in Task.names()]
    tasks += [MatchTask.load(name) for name in MatchTask.names()]
    if as_json:
        print_json([task.document for task in tasks])
        return
    table = Table("task", "engine", "seconds", "seeds", "unit", "objective", box=None, pad_edge=False)
    for task in tasks:
        engine = task.world_config(task.seeds[0])["backend"]
        asked = task.objective.text if isinstance(task, Task) else f"of each role: {', '.join(task.roles)}"
        table.add_row(task.name, engine, f"{task.duration:g}", str(len(task.seeds)), task.unit, asked)
    Console(highlight=False, markup=False).print(table)


def _show(task: Task | MatchTask) -> None:
    document = task.document
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    table.add_row("task", task.name)
    table.add_row("asked", visible(task.description, keep="\n"))
    if isinstance(task, MatchTask):
        for role in task.roles.values():
            table.add_row(f"objective of {role.name}", visible(role.objective.text, keep="\n"))
        table.add_row("roles", "interchangeable" if task.interchangeable else "in the order of the creatures")
    else:
        table.add_row("objective", visible(task.objective.text, keep="\n"))
    table.add_row("unit of scores", visible(task.unit) or "none")
    for title, condition in task.ends:
        table.add_row(f"ends: {title}", visible(condition.text, keep="\n"))
    table.add_row("lasts", f"{task.duration:g} s, after {document['settle']:g} s to settle")
    table.add_row("limits", limit_words(document["limits"]))
    if "newborn" in document:
        at_birth = ", ".join(f"{limit} {value:,}" for limit, value in document["newborn"].items())
        table.add_row("at birth", at_birth)
    if "injury" in document:
        low, high = document["injury"]["time"]
        table.add_row("injury", f"a limb is cut off {low:g} to {high:g} s after the start")
    if document.get("development"):
        table.add_row("bodies", "may develop: later parts and rules of development are allowed")
    for field, words in (("senses", "sensors of use"), ("shapes", "shapes of use")):
        if field in document:
            table.add_row(words, ", ".join(document[field]))
    table.add_row("seeds", ", ".join(map(str, task.seeds)))
    drawn = {**document["vary"], **{f"target {k}": v for k, v in document.get("target", {}).items() if k != "height"}}
    ranges = (f"{what} {low:g} to {high:g}" for what, (low, high) in drawn.items() if low != high)
    table.add_row("seeds decide", ", ".join(["scenery", *ranges]))
    for prop in document["props"]:
        size = " x ".join(f"{edge:g}" for edge in prop["size"])
        table.add_row("prop", f"{prop['id']}: {size} m, {prop['mass']:g} kg{', the target' if prop['target'] else ''}")
    table.add_row("hash", task.hash)
    Console(highlight=False, markup=False).print(table)
