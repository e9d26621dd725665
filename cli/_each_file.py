"""Commands that take many files: each is opened and judged by itself, and the worst of their exit statuses counts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import click

from nmes.cli._json import print_json
from nmes.errors import NmesError, visible

__all__ = ["File", "Finding", "files_argument", "judge_each", "print_reports", "report_each", "worst"]

_WORST_FIRST = (1, 2, 3, 0)
"""Exit statuses: what has failed is worse than what cannot be read, and that than what cannot be judged here."""

Opened = TypeVar("Opened")


@dataclass(frozen=True, slots=True)
class File(Generic[Opened]):
    """A file that an argument names; `open` raises BadParameter where it is none that can be read."""

    name: str
    open: Callable[[], Opened]


@dataclass(frozen=True, slots=True)
class Finding:
    """What is found of one file.

    Attributes:
        report: Plain data, for JSON.
        lines: The same for people.
        status: The exit status.
    """

    report: dict[str, Any]
    lines: Sequence[str]
    status: int


def files_argument(open_file: Callable[[click.Context, click.Parameter, str], Opened]) -> Callable[[Any], Any]:
    """Returns the argument FILE..., which gives a list of `File`: each is opened when its turn comes."""

    def files(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> list[File[Opened]]:
        def opener(value: str) -> Callable[[], Opened]:
            return lambda: open_file(context, parameter, value)

        return [File(value, opener(value)) for value in values]

    return click.argument("files", metavar="FILE...", nargs=-1, required=True, callback=files)


def judge_each(files: Sequence[File[Opened]], judge: Callable[[Opened], Finding]) -> Iterator[Finding]:
    """Judges files, each when it is asked for; one of several that cannot be read or judged does not stop the others.

    Raises:
        BadParameter: The only one cannot be read.
        NmesError: The only one cannot be judged.
    """
    for file in files:
        try:
            finding = judge(file.open())
        except (click.ClickException, NmesError) as error:
            if len(files) == 1:
                raise
            finding = _failed(error)
        yield Finding({"file": file.name} | finding.report, finding.lines, finding.status)


def _failed(error: click.ClickException | NmesError) -> Finding:
    """Returns the finding of a file that cannot be read or judged."""
    report = {"error": error.message}
    if isinstance(error, click.ClickException):
        return Finding(report, [f"cannot be read: {error.message}"], error.exit_code)
    return Finding(report, [error.message], 3 if error.code == "not_comparable" else 1)


def report_each(files: Sequence[File[Opened]], judge: Callable[[Opened], Finding], as_json: bool) -> int:
    """Judges files and prints what is found: of one file its lines, of several a line each, as soon as it is known.

    As JSON it is an object, of several files a list of them.

    Returns:
        The exit status.
    """
    findings = []
    for finding in judge_each(files, judge):
        findings.append(finding)
        if not as_json and len(files) == 1:
            click.echo("".join(f"{visible(line)}\n" for line in finding.lines), nl=False)
        elif not as_json:
            told = "; ".join(line.strip() for line in finding.lines)
            click.echo(visible(f"{finding.report['file']}: {told}"))
    if as_json:
        print_reports(findings)
    return worst(finding.status for finding in findings)


def print_reports(findings: Sequence[Finding]) -> None:
    """Prints the reports of files as JSON: that of one file, or a list."""
    reports = [finding.report for finding in findings]
    print_json(reports[0] if len(reports) == 1 else reports)


def worst(statuses: Iterable[int]) -> int:
    """Returns the worst of some exit statuses."""
    return min(statuses, key=_WORST_FIRST.index)
