"""`nmes conform-client`: judge a client by the protocol."""

from __future__ import annotations

import sys
from contextlib import nullcontext

import click
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from nmes.cli._json import print_json
from nmes.cli._options import FiniteRange
from nmes.conformance import NoCase, Verdict
from nmes.conformance.clauses import sentence
from nmes.conformance.clients import CLIENT_CASES, ClientCase, ClientResult, judge, select_client_cases
from nmes.conformance.report import readable
from nmes.errors import NmesError, visible

__all__ = ["command"]

_STYLES = {Verdict.OK: "green", Verdict.FAILED: "bold red", Verdict.SKIPPED: "dim", Verdict.FAULT: "bold magenta"}
_LINES = 12  # of the log of a case that failed: the last ones tell why
_WIDTH = 200  # characters of one of them


@click.command(
    "conform-client",
    short_help="Judge a client by the protocol.",
    context_settings={"allow_interspersed_args": False},  # what follows the driver's name is the driver's
)
@click.option(
    "--listen",
    "port",
    type=click.IntRange(0, 65535),
    default=0,
    metavar="PORT",
    help="Where the client is to connect to, on this machine; any free port if left out.",
)
@click.option(
    "--timeout",
    type=FiniteRange(0.1, 600),
    default=5.0,
    show_default=True,
    help="How long one wait for the client may take, in s.",
)
@click.option("--only", multiple=True, metavar="PATTERN", help="Only cases whose number fits, such as '4.*'.")
@click.option("--list", "as_list", is_flag=True, help="Print the cases, and run none.")
@click.option("--json", "as_json", is_flag=True, help="Print the report as JSON.")
@click.argument("driver", nargs=-1, type=click.Path())
def command(
    port: int, timeout: float, only: tuple[str, ...], as_list: bool, as_json: bool, driver: tuple[str, ...]
) -> None:
    """Judge a client by the protocol.

    DRIVER is a small program around the client, with its arguments. It reads one instruction a line (open, send,
    pipeline, batch, events, close), has the client do it, and writes one answer a line. This command plays the server:
    it splits replies at every byte, puts several into one packet, and events between them; it refuses, is late, reads
    slowly, hangs up. The documentation tells the instructions (client-conformance.md).

    Exit status: 0 conforming, 1 not, 2 where the driver or the port cannot be had, or the suite itself failed.

    For example:

    \b
        nmes conform-client ./my-driver
        nmes conform-client --listen 14999 --only '2.*' python driver.py
        nmes conform-client --list
    """
    try:
        cases = select_client_cases(only)
    except NoCase as error:
        raise click.UsageError(error.message) from error
    if as_list:
        _list(cases, as_json)
        return
    if not driver:
        raise click.UsageError("give the driver: a program and its arguments")
    try:
        results = _judge(driver, port, timeout, only, len(cases))
    except NmesError as error:
        click.echo(f"Error: {visible(error.message)}", err=True)
        sys.exit(2)
    status = _status(results)
    if as_json:
        print_json({"driver": list(driver), "exit_status": status, "results": [_row(result) for result in results]})
    else:
        _print(results, status)
    sys.exit(status)


def _list(cases: list[ClientCase], as_json: bool) -> None:
    if as_json:
        print_json([{"case": c.number, "group": c.group, "clause": c.clause, "title": c.title} for c in cases])
        return
    for case in cases:
        click.echo(f"{case.number:<6} {case.clause:<24} {case.title}")
    click.echo(f"{len(cases)} of {len(CLIENT_CASES)} cases")


def _judge(driver: tuple[str, ...], port: int, timeout: float, only: tuple[str, ...], count: int) -> list[ClientResult]:
    errors = Console(stderr=True)
    progress = Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), console=errors
    )
    task = progress.add_task("judging", total=count)
    with progress if errors.is_terminal else nullcontext():
        return judge(driver, port=port, timeout=timeout, only=only, on_result=lambda result: progress.advance(task))


def _status(results: list[ClientResult]) -> int:
    verdicts = {result.verdict for result in results}
    if Verdict.FAULT in verdicts or verdicts == {Verdict.SKIPPED}:
        return 2
    return 1 if Verdict.FAILED in verdicts else 0


def _row(result: ClientResult) -> dict[str, object]:
    case = result.case
    told = result.verdict in (Verdict.FAILED, Verdict.FAULT)
    return {
        "case": case.number,
        "group": case.group,
        "title": case.title,
        "clause": case.clause,
        "sentence": sentence(case.clause),
        "verdict": result.verdict,
        "expected": result.expected,
        "received": result.received,
        "reason": result.reason,
        "log": [
            {"at": round(entry.at, 6), "wire": entry.wire, "kind": entry.kind, "data": readable(entry)}
            for entry in result.log
        ]
        if told
        else [],
    }


def _print(results: list[ClientResult], status: int) -> None:
    console = Console(highlight=False, soft_wrap=True)
    for result in results:
        case = result.case
        console.print(f"[{_STYLES[result.verdict]}]{result.verdict:<8}[/] {case.number:<5} {escape(case.title)}")
        if result.reason is not None:
            console.print(f"  {escape(visible(result.reason))}")
        if result.verdict is Verdict.FAILED:
            console.print(f"  expected  {escape(visible(result.expected or ''))}")
            console.print(f"  received  {escape(visible(result.received or ''))}")
            console.print(f"  clause    {case.clause}: {escape(sentence(case.clause))}")
            for entry in result.log[-_LINES:]:
                arrow = {"sent": "->", "received": "<-"}.get(entry.kind, "--")
                shown = readable(entry)
                shown = shown if len(shown) <= _WIDTH else f"{shown[:_WIDTH]}..."
                console.print(f"  {entry.at:8.4f} {entry.wire} {arrow} {escape(shown)}", style="dim")
    counts = ", ".join(
        f"{count} {verdict}" for verdict in _STYLES if (count := sum(each.verdict is verdict for each in results))
    )
    words = {0: "[green]conforms[/]", 1: "[bold red]does not conform[/]", 2: "[bold red]could not be judged[/]"}
    console.print(f"the client {words[status]}: {counts}")
