"""`nmes info`: show what a recording holds."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click
from rich.filesize import decimal

from nmes.cli._columns import columns
from nmes.cli._each_file import File, Finding, files_argument, judge_each, print_reports, worst
from nmes.cli._output import check_output
from nmes.cli._progress import QUIET
from nmes.errors import RecordingError, visible
from nmes.recording import Recording

__all__ = ["command", "open_recording"]

_DIGITS = 19  # of a frame
_HEADINGS = ("file", "world", "engine", "ticks", "duration", "commands", "size", "complete")


def open_recording(context: click.Context, parameter: click.Parameter, value: str) -> Recording:
    """Opens the file that an argument names; one that cannot be read is wrong usage."""
    try:
        return Recording(value)
    except RecordingError as error:
        raise click.BadParameter(error.message, ctx=context, param=parameter) from error


@click.command("info")
@files_argument(open_recording)
@click.option(
    "--plot",
    "plot_to",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write score, height, energy and gait over time to an .svg or .png, too.",
)
@click.option("--json", "as_json", is_flag=True, help="Print it as JSON.")
@QUIET
def command(files: list[File[Recording]], plot_to: Path | None, as_json: bool) -> None:
    """Show what a recording holds.

    The world, its seed and engine, clients, commands by type, ticks and duration, and whether the file is whole. Of
    several files a table with a row each; as JSON one object, or a list of them.

    Exit status: 0 shown, 2 wrong usage or no recording.

    For example:

    \b
        nmes info run.mcap
        nmes info recordings/*.mcap
        nmes info run.mcap --plot run.svg
    """
    check_output(plot_to, *(file.name for file in files))
    findings = list(judge_each(files, _inspect))
    if plot_to is not None:
        from nmes.cli._recording_plot import plot_recordings  # its imports take long, and all commands import this

        plot_recordings([file.open() for file in files], plot_to)
    if as_json:
        print_reports(findings)
    elif len(files) == 1:
        click.echo("\n".join(findings[0].lines))
    else:
        click.echo("\n".join(columns([_HEADINGS, *(_row(finding.report) for finding in findings)], right=(3, 4, 5, 6))))
    sys.exit(worst(finding.status for finding in findings))


def _inspect(recording: Recording) -> Finding:
    about = _about(recording)
    return Finding(about, columns([(visible(name), visible(value)) for name, value in _rows(about)]), 0)


def _row(about: dict[str, Any]) -> tuple[str, ...]:
    """Returns the row of one file, whose report may be no more than why it has none."""
    file = visible(about["file"])
    if "error" in about:
        return (file, *[""] * (len(_HEADINGS) - 2), f"cannot be read: {visible(about['error'])}")
    damage = about["damage"]
    return (
        file,
        visible(f"{about['world']}, seed {about['seed']}"),
        visible(about["fingerprint"]["backend"]),
        f"{about['ticks']:,}",
        f"{about['sim_seconds']:,.2f} s",
        f"{sum(about['commands'].values()):,}",
        decimal(about["size"]),
        "yes" if damage is None else f"no: {visible(damage['message'])}",
    )


def _about(recording: Recording) -> dict[str, Any]:
    summary, damage, config = recording.summary(), recording.damage, recording.config
    return {
        "world": config["name"],
        "seed": config["seed"],
        "config": config,
        "fingerprint": recording.fingerprint,
        "created": recording.metadata["nmes.recording"]["created"],
        "format": recording.metadata["nmes.recording"]["format"],
        "clients": summary.clients,
        "commands": dict(summary.commands.most_common()),
        "refused": summary.refused,
        "errors": summary.errors,
        "ignored": dict(summary.ignored.most_common()),
        "without_effect": dict(summary.without_effect.most_common()),
        "first_frame": recording.start().frame,
        "parent": recording.metadata.get("nmes.parent"),
        "ticks": summary.ticks,
        "keyframes": summary.keyframes,
        "hibernations": summary.hibernations,
        "faults": summary.faults,
        "life": dict(summary.life.most_common()),
        "census": summary.census,
        "sim_seconds": summary.ticks / config["tick_rate"],
        "wall_seconds": (summary.ended - summary.began) / 1e9,
        "size": recording.size,
        "complete": damage is None,
        "damage": None if damage is None else {"message": damage.message, "offset": damage.offset, "cut": damage.cut},
    }


def _lived(counts: Mapping[str, int], census: Mapping[str, Any] | None) -> str:
    born, died, meals = (counts.get(name, 0) for name in ("creature_born", "creature_died", "food_eaten"))
    if census is None:
        return f"{born:,} came, {died:,} died, {meals:,} meals"
    generation = census["means"].get("generation", 0.0)
    last = f"at last {census['population']:,} of {census['species']:,} species, generation {generation:.1f} on the mean"
    return f"{born:,} came, {died:,} died, {meals:,} meals; {last}"


def _date(text: str) -> str:
    """Returns a date for people; one that is none, as a forger may write, as it stands."""
    try:
        return f"{datetime.fromisoformat(text).astimezone(UTC):%Y-%m-%d %H:%M:%S} UTC"
    except (ValueError, OverflowError):
        return text


def _rows(about: dict[str, Any]) -> list[tuple[str, str]]:
    fingerprint, damage = about["fingerprint"], about["damage"]
    engine = [fingerprint["backend"], fingerprint.get("engine.version", ""), f"nmes {fingerprint['nmes']}"]
    commands = sum(about["commands"].values())
    parent = about["parent"]
    begins = f", from frame {about['first_frame']:,} on" if about["first_frame"] else ""
    saved = f", {about['keyframes']:,} keyframes" if about["keyframes"] else ""
    saved += f", asleep {about['hibernations']:,} times" if about["hibernations"] else ""
    rows = [
        ("world", f"{about['world']}, seed {about['seed']}"),
        ("engine", ", ".join(part for part in engine if part)),
        ("machine", ", ".join(fingerprint[name] for name in ("cpu", "simd", "libc", "python"))),
        ("created", _date(about["created"])),
        ("duration", f"{about['sim_seconds']:,.2f} s of simulation in {about['wall_seconds']:,.2f} s"),
        ("ticks", f"{about['ticks']:,}{begins}{saved}"),
        ("clients", f"{about['clients']:,}"),
        ("commands", f"{commands:,}, and {about['refused']:,} refused frames; {about['errors']:,} errors"),
    ]
    rows += [(f"  {name}", f"{count:,}") for name, count in about["commands"].items()]
    for key, heading in (("ignored", "not understood"), ("without_effect", "without effect")):
        if about[key]:
            rows.append((heading, f"{sum(about[key].values()):,} fields"))
            rows += [(f"  {name}", f"{count:,}") for name, count in about[key].items()]
    if parent is not None:
        rows.append(("parent", f"{parent['file']}, frame {parent['frame'][:_DIGITS]} ({parent['recording'][:16]})"))
    if about["faults"]:
        rows.append(("faults", f"{about['faults']:,}"))
    if about["life"]:
        rows.append(("life", _lived(about["life"], about["census"])))
    rows.append(("size", decimal(about["size"])))
    rows.append(("complete", "yes" if damage is None else f"no: {damage['message']}"))
    return rows
