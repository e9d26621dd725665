"""The report of a run: a page for people, JSON and JUnit XML for programs.

It hides the three forms. All hold the same: the suite's version and hash, the server's banner, seed, duration, every
verdict with its clause, and why a case was skipped. The page is one file that needs nothing else.
"""

from __future__ import annotations

import html
import json
from collections.abc import Iterable, Iterator
from importlib.metadata import version
from typing import Any
from xml.etree import ElementTree

from nmes.conformance.runner import TOLD, Report, Result, Verdict, suite_hash
from nmes.conformance.wire import Entry
from nmes.errors import visible
from nmes.protocol import PROTOCOL_VERSION

__all__ = ["describe", "readable", "to_html", "to_json", "to_junit"]

BAD = frozenset({Verdict.FAILED, Verdict.FAULT})


def to_json(report: Report) -> dict[str, Any]:
    """Returns a report as JSON data."""
    return {
        **_head(report),
        "results": [
            {
                "case": result.case.number,
                "category": result.case.category,
                "title": result.case.title,
                "level": result.case.level,
                "clause": result.case.clause,
                "sentence": result.clause,
                "verdict": result.verdict,
                "expected": result.expected,
                "received": result.received,
                "cause": result.cause,
                "reason": result.reason,
                "endings": result.endings,
                "script": result.script,
                "seconds": round(result.seconds, 4),
                "log": [_entry(entry) for entry in result.log],
            }
            for result in report.results
        ],
    }


def _head(report: Report) -> dict[str, Any]:
    return {
        "suite": {"nmes": version("nmes"), "hash": suite_hash(), "protocol": PROTOCOL_VERSION},
        "target": report.target.address,
        "banner": dict(report.probe.banner),
        "capabilities": sorted(report.probe.capabilities),
        "trouble": report.probe.trouble,
        "seed": report.options.seed,
        "timeout": report.target.timeout,
        "started": report.started,
        "seconds": round(report.seconds, 3),
        "halted": report.halted,
        "counts": {verdict.value: report.counts[verdict] for verdict in Verdict},
        "causes": {cause: [each.case.number for each in results] for cause, results in report.causes.items()},
        "exit_status": report.exit_status,
    }


def _entry(entry: Entry) -> dict[str, Any]:
    return {"at": round(entry.at, 6), "wire": entry.wire, "kind": entry.kind, "data": readable(entry)}


def readable(entry: Entry) -> str:
    """Returns an entry's bytes as text that shows every byte, those that cannot be printed as escapes."""
    if entry.left_out:
        half = len(entry.data) // 2
        return f"{_text(entry.data[:half])} ...[{entry.left_out:,} bytes left out]... {_text(entry.data[half:])}"
    return _text(entry.data)


def _text(data: bytes) -> str:
    return visible(data.decode("utf-8", "backslashreplace"))


def describe(result: Result) -> str:
    """Returns a case's failure as text: expected, received, clause, and the log of its connections."""
    lines = [f"{result.verdict}: {result.case.number} {result.case.title}"]
    if result.verdict is Verdict.FAULT:
        return "\n".join([*lines, visible(result.reason or "", keep="\n")])
    lines += [f"expected: {visible(result.expected or '')}", f"received: {visible(result.received or '')}"]
    lines.append(f"clause: {result.case.clause} ({result.case.level}): {result.clause}")
    return "\n".join([*lines, *_lines(result.log)])


def to_junit(report: Report) -> str:
    """Returns a report as JUnit XML: a suite a category."""
    root = ElementTree.Element("testsuites", name="nmes conform", time=f"{report.seconds:.3f}")
    for category, results in _by_category(report.results):
        counts = [result.verdict for result in results]
        suite = ElementTree.SubElement(
            root,
            "testsuite",
            name=category,
            tests=str(len(results)),
            failures=str(counts.count(Verdict.FAILED)),
            errors=str(counts.count(Verdict.FAULT)),
            skipped=str(counts.count(Verdict.SKIPPED) + counts.count(Verdict.UNIMPLEMENTED)),
            timestamp=report.started,
        )
        properties = ElementTree.SubElement(suite, "properties")
        for name, value in _head(report).items():
            ElementTree.SubElement(properties, "property", name=name, value=_xml(json.dumps(value)))
        for result in results:
            attributes = {"classname": category, "name": f"{result.case.number} {result.case.title}"}
            element = ElementTree.SubElement(suite, "testcase", attributes, time=f"{result.seconds:.3f}")
            if result.verdict is Verdict.FAILED:
                child = ElementTree.SubElement(
                    element, "failure", type=_xml(result.cause or ""), message=_xml(f"expected {result.expected}")
                )
                child.text = _xml(describe(result))
            elif result.verdict is Verdict.FAULT:
                ElementTree.SubElement(element, "error", message="the suite failed").text = _xml(describe(result))
            elif result.verdict in (Verdict.SKIPPED, Verdict.UNIMPLEMENTED):
                message = _xml(f"{result.verdict}: {result.reason}")
                ElementTree.SubElement(element, "skipped", message=message)
            elif result.verdict is Verdict.NON_STRICT:
                ElementTree.SubElement(element, "system-out").text = _xml(describe(result))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True)


def _xml(text: str) -> str:
    """Replaces characters that XML cannot hold."""
    return "".join(char if char in "\t\n" or char.isprintable() else "\ufffd" for char in text)


def _lines(log: Iterable[Entry]) -> Iterator[str]:
    arrows = {"sent": "->", "received": "<-", "note": "--"}
    for entry in log:
        yield f"{entry.at:9.4f} {entry.wire} {arrows[entry.kind]} {readable(entry)}"


def _by_category(results: Iterable[Result]) -> list[tuple[str, list[Result]]]:
    groups: dict[str, list[Result]] = {}
    for result in results:
        groups.setdefault(result.case.category, []).append(result)
    return list(groups.items())


_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 2em auto; max-width: 75em; padding: 0 1em; color: #1a1a1a }
table { border-collapse: collapse; margin: 1em 0 } th, td { padding: .25em .7em; text-align: left; vertical-align: top }
th { border-bottom: 1px solid #999 } tr:nth-child(even) td { background: #f6f6f6 } td.n { text-align: right }
.cells a, .cells span { display: inline-block; width: 1em; height: 1em; margin: 1px; border-radius: 2px }
.ok { background: #2a8a3e } .non-strict { background: #d9a400 } .unimplemented { background: #8aa0b8 }
.skipped { background: #d5d5d5 } .failed { background: #c62828 } .fault { background: #7b1fa2 }
b.tag { color: #fff; padding: .1em .5em; border-radius: 3px } b.skipped { color: #333 }
section.case { border-left: 4px solid #c62828; padding-left: 1em; margin: 2em 0 }
pre { background: #f3f3f3; padding: .7em; white-space: pre-wrap; overflow-wrap: anywhere; font-size: 13px }
.sent { color: #0b4f9e } .received { color: #1b6b2f } .note { color: #777 }
blockquote { margin: .5em 0; padding-left: .8em; border-left: 3px solid #bbb; color: #444 }
"""


def to_html(report: Report) -> str:
    """Returns a report as one page that needs nothing else."""
    head = _head(report)
    failed = [result for result in report.results if result.verdict in BAD]
    loose = [result for result in report.results if result.verdict is Verdict.NON_STRICT]
    left_out = [result for result in report.results if result.verdict in (Verdict.SKIPPED, Verdict.UNIMPLEMENTED)]
    words = {0: "conforms", 1: "does not conform", 2: "could not be judged"}[report.exit_status]
    facts = {
        "Server": head["target"],
        "Banner": json.dumps(head["banner"]),
        "Claims": ", ".join(head["capabilities"]) or "nothing beyond what is required",
        "Suite": f"nmes {head['suite']['nmes']}, protocol {PROTOCOL_VERSION}, hash {head['suite']['hash']}",
        "Run": f"{head['started']}, {report.seconds:.1f} s, seed {head['seed']}, time-out {head['timeout']:g} s",
    }
    if report.probe.trouble:
        facts["Trouble"] = report.probe.trouble
    if report.halted:
        facts["Ended early"] = report.halted
    parts = [
        "<!doctype html><html lang='en'><meta charset='utf-8'>",
        f"<title>{_e(head['target'])} {words}</title><style>{_STYLE}</style>",
        f"<h1>{_e(head['target'])} {words}</h1><table>",
        *(f"<tr><th>{_e(name)}<td>{_e(value)}" for name, value in facts.items()),
        "</table><h2>Verdicts</h2>",
        _matrix(report),
    ]
    if report.causes:
        parts.append("<h2>Failures by cause</h2><table><tr><th>cases<th>cause<th>which")
        parts += [
            f"<tr><td class='n'>{len(results)}<td>{_e(cause)}<td>{' '.join(map(_link, results))}"
            for cause, results in report.causes.items()
        ]
        parts.append("</table>")
    for title, results in (("Failures", failed), ("Not strict", loose)):
        if results:
            parts += [f"<h2>{title}</h2>", *(_case_section(result) for result in results)]
    if left_out:
        parts.append("<h2>Skipped and unimplemented</h2><table><tr><th>case<th>verdict<th>what<th>why")
        parts += [
            f"<tr><td>{_e(r.case.number)}<td>{r.verdict}<td>{_e(r.case.title)}<td>{_e(r.reason or '')}"
            for r in left_out
        ]
        parts.append("</table>")
    parts.append("<h2>All cases</h2><table><tr><th>case<th>verdict<th>level<th>what<th>clause<th>connections<th>s")
    for r in report.results:
        endings = ", ".join(f"{wire}: {ending}" for wire, ending in r.endings.items())
        parts.append(
            f"<tr><td>{_e(r.case.number)}<td>{_tag(r.verdict)}<td>{r.case.level}<td>{_e(r.case.title)}"
            f"<td title='{_e(r.clause)}'>{_e(r.case.clause)}<td>{_e(endings)}<td class='n'>{r.seconds:.2f}"
        )
    return "\n".join([*parts, "</table></html>"])


def _matrix(report: Report) -> str:
    rows = [f"<tr><th>category{''.join(f'<th>{verdict}' for verdict in Verdict)}<th>cases"]
    for category, results in _by_category(report.results):
        numbers = "".join(
            f"<td class='n'>{sum(result.verdict is verdict for result in results) or ''}" for verdict in Verdict
        )
        cells = "".join(
            f"<{'a href=' + repr('#c' + _e(r.case.number)) if r.verdict in TOLD else 'span'} class='{r.verdict}' "
            f"title='{_e(r.case.number)} {_e(r.case.title)}: {r.verdict}'></{'a' if r.verdict in TOLD else 'span'}>"
            for r in results
        )
        rows.append(f"<tr><td>{_e(category)}{numbers}<td class='cells'>{cells}")
    return "<table>" + "\n".join(rows) + "</table>"


def _case_section(result: Result) -> str:
    case = result.case
    endings = ", ".join(f"{wire}: {ending}" for wire, ending in result.endings.items()) or "none"
    log = "\n".join(
        f"<span class='{entry.kind}'>{_e(line)}</span>"
        for entry, line in zip(result.log, _lines(result.log), strict=True)
    )
    outcome = (
        f"<pre>{_e(result.reason or '')}</pre>"
        if result.verdict is Verdict.FAULT
        else f"<p><b>Expected</b> {_e(result.expected or '')}<p><b>Received</b> {_e(result.received or '')}"
    )
    return (
        f"<section class='case' id='c{_e(case.number)}'><h3>{_e(case.number)} {_e(case.title)}</h3>"
        f"<p>{_tag(result.verdict)} {case.level}, clause {_e(case.clause)}<blockquote>{_e(result.clause)}</blockquote>"
        f"{outcome}<p><b>Connections</b> {_e(endings)}<pre>{log}</pre></section>"
    )


def _link(result: Result) -> str:
    number = _e(result.case.number)
    return f"<a href='#c{number}'>{number}</a>"


def _tag(verdict: Verdict) -> str:
    return f"<b class='tag {verdict}'>{verdict}</b>"


def _e(text: str) -> str:
    return html.escape(text)
