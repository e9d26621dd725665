"""`nmes conform`: judge any server by the protocol."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Mapping
from contextlib import ExitStack, nullcontext
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from nmes.cli._address import split_address
from nmes.cli._interruptions import interruptions
from nmes.cli._json import print_json
from nmes.cli._options import FiniteRange
from nmes.cli._output import whole_file
from nmes.cli._password import PASSWORD_VARIABLE, choose_password, password_options
from nmes.conformance import (
    CASES,
    CATEGORIES,
    NoCase,
    Options,
    Report,
    Result,
    Target,
    Verdict,
    replay,
    run,
    select,
    suite_hash,
)
from nmes.conformance.model import Script, load_script, write_script
from nmes.conformance.report import to_html, to_json, to_junit
from nmes.errors import DocumentError, NmesError, visible

__all__ = ["command"]

STYLES = {
    Verdict.OK: "green",
    Verdict.NON_STRICT: "yellow",
    Verdict.UNIMPLEMENTED: "blue",
    Verdict.FAILED: "bold red",
    Verdict.SKIPPED: "dim",
    Verdict.FAULT: "bold magenta",
}
SOME = 3  # cases that the summary names of those that failed of the same
_WITH_REPLAY = {"script", "address", "password", "password_file", "timeout"}
_FILE = click.Path(path_type=Path, dir_okay=False, writable=True)


class _NotWritten(click.ClickException):
    exit_code = 2  # 1 would say that the server does not conform


def _split(context: click.Context, parameter: click.Parameter, value: str | None) -> tuple[str, str, int] | None:
    """Returns scheme, host and port of HOST:PORT or ws://HOST:PORT; None for None."""
    scheme = "ws" if value is not None and value.startswith("ws://") else "tcp"
    address = split_address(context, parameter, value if value is None else value.removeprefix("ws://"))
    return None if address is None else (scheme, *address)


@click.command("conform", short_help="Judge a server by the protocol.")
@click.argument("address", metavar="[HOST:PORT|ws://HOST:PORT]", required=False, callback=_split)
@password_options(f"The server's password; better in the variable {PASSWORD_VARIABLE}.")
@click.option(
    "--timeout",
    type=FiniteRange(0.1, 600),
    default=5.0,
    show_default=True,
    help="How long one wait for the server may take, in s.",
)
@click.option("--fail-fast", is_flag=True, help="End at the first failure.")
@click.option(
    "--time-limit",
    type=FiniteRange(0, 86400, min_open=True),
    metavar="S",
    help="How long all of it may take, in s; what was not judged by then is skipped.",
)
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), default=0, show_default=True, help="Of all that is drawn.")
@click.option("--only", multiple=True, metavar="PATTERN", help="Only cases whose number fits, such as '4.*'.")
@click.option("--category", "categories", multiple=True, metavar="NAME", help="Only cases of this category.")
@click.option(
    "--replay",
    "script",
    metavar="CASE",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="Only play the conversation in this file, which a search had found wrong.",
)
@click.option("--list", "as_list", is_flag=True, help="Print the cases, and run none.")
@click.option("--json", "as_json", is_flag=True, help="Print the report as JSON.")
@click.option("--junit", type=_FILE, help="Write the report as JUnit XML.")
@click.option("--report", "page", type=_FILE, help="Write the report as one HTML page.")
@click.pass_context
def command(
    context: click.Context,
    address: tuple[str, str, int] | None,
    password: str | None,
    password_file: Path | None,
    timeout: float,
    fail_fast: bool,
    time_limit: float | None,
    seed: int,
    only: tuple[str, ...],
    categories: tuple[str, ...],
    script: Path | None,
    as_list: bool,
    as_json: bool,
    junit: Path | None,
    page: Path | None,
) -> None:
    """Judge any server by the protocol.

    Plays over nine hundred short conversations with the server and says of each whether it went as the protocol says.
    What a server may leave out and does not claim is skipped. Some cases search: two clients say anything; what goes
    wrong is shrunk to the shortest conversation and saved as a file in this directory, for --replay. The server's world
    should be one for tests: cubes come and go, time is stopped and moved on, and a world in lockstep is reset.

    Exit status: 0 conforming, 1 not, 2 unreachable, wrong usage, the suite's own fault, a report that cannot be
    written, an interruption (Ctrl-C, SIGTERM), or a time limit that was over before anything failed.

    For example:

    \b
        nmes conform 127.0.0.1:14000 --password-file secret --report out.html
        nmes conform --list --category physics
        nmes conform ws://127.0.0.1:14080 --password-file secret
        nmes conform 127.0.0.1:14000 --only '1.*' --only 4.3:null
        nmes conform 127.0.0.1:14000 --fail-fast --time-limit 60
        nmes conform 127.0.0.1:14000 --replay conform-17.1-0-0.json
    """
    used = {name for name in context.params if context.get_parameter_source(name) is ParameterSource.COMMANDLINE}
    if script is not None and used - _WITH_REPLAY:
        raise click.UsageError("--replay plays one conversation: only the password and --timeout go with it")
    options = Options(only, categories, seed, fail_fast, time_limit)
    try:
        cases = select(options)
    except NoCase as error:
        raise click.UsageError(error.message) from error
    if as_list:
        _list(cases, as_json)
        return
    target = _target(address, password, password_file, timeout)
    try:
        with interruptions(signal.SIGINT, signal.SIGTERM) as interrupted:
            if script is not None:
                sys.exit(_replay(target, _load(script)))
            files = {path: form for path, form in ((page, to_html), (junit, to_junit)) if path is not None}
            sys.exit(_judge(target, options, len(cases), files, as_json, interrupted))
    except NmesError as error:
        click.echo(f"Error: {visible(error.message)}", err=True)
        sys.exit(2)
    except KeyboardInterrupt:
        click.echo("Error: interrupted before all was judged", err=True)
        sys.exit(2)  # 1 would say that the server does not conform


def _target(
    address: tuple[str, str, int] | None, password: str | None, password_file: Path | None, timeout: float
) -> Target:
    """Returns the server to judge; raises UsageError where its address or password is missing."""
    if address is None:
        raise click.UsageError("give the server's HOST:PORT")
    choice = choose_password(password, password_file)
    if choice is None:
        raise click.UsageError(f"give the server's password, in {PASSWORD_VARIABLE} or with --password-file")
    scheme, host, port = address
    return Target(host, port, choice[0], timeout, scheme)


def _list(cases: Any, as_json: bool) -> None:
    if as_json:
        rows = [
            {
                "case": case.number,
                "category": case.category,
                "level": case.level,
                "clause": case.clause,
                "needs": case.needs,
                "title": case.title,
            }
            for case in cases
        ]
        print_json(rows)
        return
    for case in cases:
        click.echo(f"{case.number:<28} {case.level:<6} {case.clause:<20} {case.title}")
    click.echo(f"{len(cases)} of {len(CASES)} cases in {len(CATEGORIES)} categories")


def _judge(
    target: Target,
    options: Options,
    count: int,
    files: Mapping[Path, Callable[[Report], str]],
    as_json: bool,
    interrupted: Callable[[], bool],
) -> int:
    """Runs cases, prints the report, writes it to files, each in its form, and returns the exit status."""
    report = failure = None
    try:
        with ExitStack() as opened:
            unfinished = [(opened.enter_context(whole_file(path)), form) for path, form in files.items()]
            report = _run(target, options, count, interrupted)
            for path, form in unfinished:
                path.write_text(form(report), "utf-8")
    except click.ClickException as error:
        failure = _NotWritten(error.message)
        if report is None:
            raise failure from error
    scripts = _save(report)
    if as_json:
        print_json(to_json(report))
    else:
        _print(report, scripts)
    if failure is not None:
        raise failure
    return report.exit_status


def _run(target: Target, options: Options, count: int, interrupted: Callable[[], bool]) -> Report:
    errors = Console(stderr=True)
    progress = Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), console=errors
    )
    task = progress.add_task("judging", total=count)
    failures = 0

    def take(result: Result) -> None:
        nonlocal failures
        failures += result.verdict in (Verdict.FAILED, Verdict.FAULT)
        description = f"[red]{failures} failed[/]" if failures else "judging"
        progress.update(task, advance=1, description=description)
        if interrupted():  # and the exception was lost
            raise KeyboardInterrupt

    with progress if errors.is_terminal else nullcontext():
        return run(target, options, take)


def _save(report: Report) -> dict[str, Path]:
    """Writes the conversations that searches have found wrong, as far as it can; returns the files by case number."""
    paths = {}
    for result in report.results:
        if result.script is not None:
            path = Path(f"conform-{result.case.number.replace(':', '-')}-{report.options.seed}.json")
            about = {"suite": suite_hash(), "expected": result.expected, "received": result.received}
            text = write_script(result.script, case=result.case.number, seed=report.options.seed, **about)
            try:
                with whole_file(path) as unfinished:
                    unfinished.write_text(text, "utf-8")
                paths[result.case.number] = path
            except click.ClickException as error:  # the report, which comes next, says more
                error.show()
    return paths


def _load(path: Path) -> Script:
    try:
        return load_script(path.read_bytes())
    except OSError as error:
        raise click.UsageError(f"cannot read {path}: {error.strerror}") from error
    except DocumentError as error:
        raise click.UsageError(f"{path}: {error.message}") from error


def _replay(target: Target, script: Script) -> int:
    result = replay(target, script)
    console = Console(highlight=False, soft_wrap=True)
    if result.verdict is Verdict.OK:
        console.print("[green]fixed[/]: every answer is right")
        return 0
    console.print("[bold red]failing[/]")
    _print_result(console, result)
    return 2 if result.verdict is Verdict.FAULT else 1


def _print(report: Report, scripts: dict[str, Path]) -> None:
    console = Console(highlight=False, soft_wrap=True)
    for result in report.results:
        if result.verdict in (Verdict.FAILED, Verdict.FAULT, Verdict.NON_STRICT):
            _print_result(console, result)
            if result.case.number in scripts:
                where = report.target.address
                console.print(f"  again     nmes conform {where} --replay {scripts[result.case.number]}")
    table = Table("category", *(verdict.value for verdict in Verdict))
    for category in CATEGORIES:
        verdicts = [result.verdict for result in report.results if result.case.category == category.name]
        if verdicts:
            table.add_row(category.name, *(_count(verdicts.count(verdict), verdict) for verdict in Verdict))
    table.add_section()
    table.add_row("all", *(_count(report.counts[verdict], verdict) for verdict in Verdict))
    console.print(table)
    for cause, results in report.causes.items():
        numbers = ", ".join(result.case.number for result in results[:SOME])
        more = f" and {len(results) - SOME} more" if len(results) > SOME else ""
        console.print(f"{len(results):>5}  {escape(visible(cause))}: {numbers}{more}")
    if report.probe.trouble is not None and all(cause.startswith("a connection ") for cause in report.causes):
        console.print("It hangs up on whoever comes; if it speaks TLS, judge it without: the suite speaks none.")
    where = report.target.address
    words = {0: "[green]conforms[/]", 1: "[bold red]does not conform[/]", 2: "[bold red]could not be judged[/]"}
    console.print(
        f"{where} {words[report.exit_status]}: {len(report.results)} cases in {report.seconds:.1f} s, "
        f"seed {report.options.seed}" + (f"; {report.halted}" if report.halted else "")
    )


def _print_result(console: Console, result: Result) -> None:
    style = STYLES[result.verdict]
    console.print(f"[{style}]{result.verdict}[/] {escape(result.case.number)} {escape(result.case.title)}")
    if result.verdict is Verdict.FAULT:
        console.print(escape(visible(result.reason or "", keep="\n")))
        return
    console.print(f"  expected  {escape(visible(result.expected or ''))}")
    console.print(f"  received  {escape(visible(result.received or ''))}")
    console.print(f"  clause    {result.case.clause} ({result.case.level}): {escape(result.clause)}")
    ends = [f"{wire} {ending}" for wire, ending in result.endings.items() if ending != "open"]
    if ends:
        console.print(f"  ended     {', '.join(ends)}")


def _count(number: int, verdict: Verdict) -> str:
    return f"[{STYLES[verdict]}]{number}[/]" if number else ""
