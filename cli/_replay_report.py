"""The reports of `nmes replay` as lines of text: verdict, amount, fingerprint, the first divergence."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import orjson

from nmes.playback import Divergence, ReplayReport
from nmes.playback.log_replay import LogReport

__all__ = ["log_lines", "replay_lines"]

_LONGEST = 200  # characters of a value


def replay_lines(report: ReplayReport) -> list[str]:
    """Describes the replay of a recording."""
    amount = f"{report.ticks:,} ticks, {report.commands:,} commands"
    if report.part:
        amount += f", from frame {report.frames[0]:,} to frame {report.frames[1]:,}"
    speed = f"{report.speed:,.0f} times faster than real time" if report.ticks else "no simulation time"
    if report.verdict == "not_comparable":
        lines = ["not comparable: it was recorded with another", *_fingerprint_lines(report.differences)]
        if report.divergence is not None:
            lines.append(f"it agrees as far as {amount}")
    elif report.divergence is not None:
        lines = [f"diverged at frame {report.divergence.frame}, after {amount}"]
    else:
        elsewhere = ", on another machine" if report.differences else ""
        lines = [f"reproduced{elsewhere}: {amount}, {speed}", *_fingerprint_lines(report.differences)]
    if report.divergence is not None:
        lines += _divergence_lines(report.divergence, f" (record {report.divergence.record})")
    if report.damage is None:
        return lines
    whole = f"{'incomplete' if report.cut else 'DAMAGED'}: {report.damage}"
    if not report.ticks and not report.commands and report.divergence is None:
        return [whole, "nothing that can be run comes before that"]
    return [whole, f"before that: {lines[0]}", *lines[1:]]


def log_lines(report: LogReport) -> list[str]:
    """Describes the replay of a log."""
    amount = (
        f"{report.commands:,} commands, {report.replies:,} replies compared; "
        f"{report.ticks:,} ticks, {report.digests:,} digests compared"
    )
    verdict = report.verdict.replace("_", " ")
    elsewhere = ", on another machine" if verdict == "reproduced" and report.differences else ""
    lines = [f"{verdict}{elsewhere}: {amount}"]
    lines += _fingerprint_lines(report.differences)
    if not report.whole:
        lines.append("  the log does not say how its world began: it was run in a new one, in lockstep")
        if not report.digests:
            lines.append("  it holds no digests: that the world went through the same states is not known")
        if not report.replies:
            lines.append("  it holds no answers to its commands: nothing could be compared")
    lines += [f"  passed over: {count} {kind}" for kind, count in report.passed_over.items()]
    lines += [f"  refused, {line}" for line in report.refused]
    if report.divergence is not None:
        lines += _divergence_lines(report.divergence)
    return lines


def _fingerprint_lines(differences: Mapping[str, tuple[str, str]]) -> list[str]:
    return [
        f"  {name}: {recorded or 'none'} (here: {here or 'none'})" for name, (recorded, here) in differences.items()
    ]


def _divergence_lines(divergence: Divergence, where: str = "") -> list[str]:
    lines = [f"  {divergence.message}{where}"]
    value = divergence.value
    if value is None:
        lines.append("  no recorded reply or pose shows the difference")
        return lines
    place = f"cube {value.cube}: " if value.cube is not None else ""
    if divergence.seen != divergence.frame:
        place = f"at frame {divergence.seen}, {place}"
    amount = f" (differs by {value.amount:.6g})" if value.amount is not None else ""
    recorded, now = _short(value.expected), _short(value.actual)
    lines.append(f"  {place}{value.field or 'reply'}: recorded {recorded}, now {now}{amount}")
    return lines


def _short(value: Any) -> str:
    text = orjson.dumps(value).decode()
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."
