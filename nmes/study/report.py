"""The report of a study: a page of Markdown and its figures, made of the study and the results and of nothing else.

Hides the layout. Invariants: the same study, discussion and results give the same bytes; no number is in a report that
did not come of the results, but for what `study.toml` has said before the run.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Final

from nmes.errors import StudyError, visible
from nmes.schemas.files import read_regular
from nmes.study.claims import Verdict, evaluate, judge
from nmes.study.document import COMPARISONS, Plan
from nmes.study.figures import draw_figures
from nmes.study.results import FILE, Results, write_file
from nmes.study.statistics import RESAMPLES, Estimate
from nmes.view.chart import number

__all__ = ["REPORT", "verdicts", "write_report", "written"]

REPORT: Final = "REPORT.md"
_LARGEST: Final = 1 << 20  # bytes of a discussion
_PLACE: Final = re.compile(r"\{\{ *([a-z0-9_.]+) *\}\}")
_CODE: Final = re.compile(r"`([^`]*)`")
_NUMBER: Final = re.compile(r"\d[\d.,]*\d|\d")
_SAID: Final = {
    "iqm": "interquartile mean of {column}, {arm}",
    "mean": "mean of {column}, {arm}",
    "median": "median of {column}, {arm}",
    "min": "least {column}, {arm}",
    "max": "greatest {column}, {arm}",
    "improvement": "probability that {column} is better in {arm} than in {over}",
    "difference": "interquartile mean of {column} in {arm}, less that in {over}",
    "equal": "part of the runs in which {column} is the same in {arm} as in {over}",
}


def write_report(plan: Plan) -> dict[str, Verdict]:
    """Makes the report of the results that are there; returns the verdict on each claim.

    Raises:
        StudyError: There are no results (`no_results`), they are not what they say (`bad_results`), the discussion
            cannot be used (`bad_discussion`), or something cannot be written (`cannot_write`).
        MissingPackage: pyarrow is not installed.
    """
    results = Results.read(plan)
    for name, content in written(plan, results).items():
        write_file(plan.folder / name, content)
    return verdicts(plan, evaluate(plan, results))


def written(plan: Plan, results: Results) -> dict[str, bytes]:
    """Returns all files of a report by name: the page and its figures.

    Raises:
        StudyError: The discussion cannot be used (`bad_discussion`), or rows lack numbers (`bad_results`).
    """
    values = evaluate(plan, results)
    pictures = draw_figures(plan, results)
    page = "\n".join(_page(plan, results, values, [(each.name, each.title, each.description) for each in pictures]))
    return {REPORT: (page + "\n").encode()} | {f"{each.name}.svg": each.file().encode() for each in pictures}


def verdicts(plan: Plan, values: Mapping[str, Estimate]) -> dict[str, Verdict]:
    """Returns the verdict on each claim, by its name."""
    return {claim["name"]: judge(claim, values) for claim in plan.study.document["claims"]}


def _page(
    plan: Plan, results: Results, values: Mapping[str, Estimate], figures: list[tuple[str, str, str]]
) -> Iterator[str]:
    document, found = plan.study.document, verdicts(plan, values)
    yield from (f"# {document['title']}", "", f"**{document['question']}**", "")
    for claim in document["claims"]:
        yield from (f"> {claim['says']}", ">", f"> ({claim['place']})", "", f"Verdict: **{found[claim['name']]}**", "")
    yield from _discussion(plan, values, found)
    yield from ("## Numbers", "", "| value | | 95 % interval | runs | seeds |", "|---|---|---|---|---|")
    for name, each in document["values"].items():
        yield _number_row(name, each, values[name])
    yield ""
    for name, title, description in figures:
        yield from (f"## {title}", "", f"![{description}]({name}.svg)", "", description, "")
    yield from _criteria(plan, found)
    yield from _method(plan, results)


def _number_row(name: str, document: Mapping[str, str], found: Estimate) -> str:
    shown = {key: str(document.get(key, "")).replace("_", " ") for key in ("arm", "over")}
    shown["column"] = f"`{document['column']}`" if "column" in document else "every column"
    said = _SAID[document["statistic"]].format_map(shown)
    where: Mapping[str, object] = document.get("where", {})  # type: ignore[assignment]
    said += "".join(f", {factor} {value}" for factor, value in where.items())
    exact = document["statistic"] in ("min", "max", "equal")
    interval = "exact" if exact else f"{number(found.low)} to {number(found.high)}"
    return f"| `{name}`: {said} | {number(found.value)} | {interval} | {found.runs} | {found.seeds} |"


def _discussion(plan: Plan, values: Mapping[str, Estimate], found: Mapping[str, Verdict]) -> Iterator[str]:
    """Yields the lines of the discussion with its values filled in.

    Raises:
        StudyError: It cannot be read, has a number of its own, or names a value that there is none of
            (`bad_discussion`).
    """
    path = plan.folder / "discussion.md"
    if not path.exists():
        return
    try:
        text = read_regular(path, _LARGEST).decode()
    except OSError as error:
        raise StudyError("bad_discussion", f"cannot read {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise StudyError("bad_discussion", f"cannot read {path}: {error}") from error
    known: dict[str, str] = {f"verdict.{name}": verdict for name, verdict in found.items()}
    for name, value in values.items():
        parts = {"": value.value, ".low": value.low, ".high": value.high, ".runs": value.runs, ".seeds": value.seeds}
        known |= {f"{name}{part}": number(each) for part, each in parts.items()}
        known[f"{name}.percent"] = f"{100.0 * value.value:.3g} %"
    for place, line in enumerate(text.splitlines(), 1):
        words = _CODE.sub(lambda code: "" if _asked(plan, code[1]) else code[1], _PLACE.sub("", line))
        for digit in re.findall(r"\d", words)[:1]:
            hint = "put {{value}} there, so that the results say it, or `code` around what study.toml says"
            raise StudyError("bad_discussion", f"{path}, line {place}: it has the digit {digit}: {hint}")
        for name in _PLACE.findall(line):
            if name not in known:
                raise StudyError("bad_discussion", f"{path}, line {place}: there is no value {name}")
    yield _PLACE.sub(lambda place: known[place[1]], text.strip())
    yield ""


def _asked(plan: Plan, code: str) -> bool:
    """Returns whether code has no number but those that a study names, or the names of its documents."""
    known = {number for text in _texts(plan.study.given) for number in _NUMBER.findall(text)}
    known |= {number for path in plan.study.folder.iterdir() for number in _NUMBER.findall(path.name)}
    return known.issuperset(_NUMBER.findall(code))


def _texts(value: object) -> Iterator[str]:
    """Yields all texts and numbers of a document, as text; whole numbers with and without commas."""
    if isinstance(value, dict):
        for name, each in value.items():
            yield name
            yield from _texts(each)
    elif isinstance(value, list):
        for each in value:
            yield from _texts(each)
    else:
        yield str(value)
        if isinstance(value, int):
            yield f"{value:,}"


def _criteria(plan: Plan, found: Mapping[str, Verdict]) -> Iterator[str]:
    yield from ("## What would count", "", "Written before the run, but for what is said to be changed.", "")
    for claim in plan.study.document["claims"]:
        yield from (f"- `{claim['name']}`: **{found[claim['name']]}**", f"  - for: {claim['for']} `{claim['holds']}`")
        yield f"  - against: {claim['against']} `{claim['refuted']}`"
        if "partly" in claim:
            yield f"  - in part: `{claim['partly']}`"
        if "changed" in claim:
            yield f"  - changed: {claim['changed']}"
    yield ""


def _method(plan: Plan, results: Results) -> Iterator[str]:
    study, document = plan.study, plan.study.document
    budget = document["budgets"][plan.budget]
    yield from ("## How it was run", "", "| arm | | settings |", "|---|---|---|")
    for arm in document["arms"]:
        words = [f"{name} = {_value(value)}" for name, value in arm.get("settings", {}).items()]
        words += [f"{name}={value}" for name, value in arm.get("environment", {}).items()]
        words += [f"beside: {command}" for command in arm.get("beside", {}).values()]
        about = arm["about"] + (" *Measured: clocks have a part in it.*" if arm["measured"] else "")
        yield f"| {arm['name'].replace('_', ' ')} | {about} | {' '.join(f'`{word}`' for word in words)} |"
    yield from ("", "```", *document["commands"].values(), "```", "")
    settings = {**document["settings"], **budget.get("settings", {})}
    if document["measured"]:
        names = ", ".join(f"`{name}`" for name in document["measured"])
        yield f"Measured, so that another run comes to other numbers: {names}."
    if settings:
        yield f"Settings: {', '.join(f'`{name} = {_value(value)}`' for name, value in settings.items())}."
    for name, chosen in study.factors(plan.budget).items():
        scales = document["scales"].get(name)
        scaled = "" if scales is None else f"; scales {', '.join(f'{scales[str(value)]:g}' for value in chosen)}"
        yield f"Factor `{name}`: {', '.join(map(str, chosen))}{scaled}."
    seeds = ", ".join(map(str, budget["seeds"]))
    yield from (f"Budget `{plan.budget}`: {len(plan.runs)} runs, seeds {seeds}.", "")
    comparing = any(value["statistic"] in COMPARISONS for value in document["values"].values())
    sampled = any(value["statistic"] not in ("equal", "min", "max") for value in document["values"].values())
    if comparing or sampled:
        yield f"Intervals: stratified bootstrap over seeds within cells, {RESAMPLES:,} resamples."
        yield ""
    yield from ("```console", f"$ nmes study verify {study.name} --budget {plan.budget}", "```", "")
    yield f"`{FILE}` has the digest `{results.digest}`; it answers the study of the hash `{results.asked[:32]}`."
    named = [results.fingerprint.get(name, "?") for name in ("nmes", "backend", "engine.version", "probe")]
    shown = visible(f"nmes {named[0]}, {named[1]} {named[2]}, probe {named[3][:16]}")
    yield f"It was computed by: {shown}."


def _value(value: object) -> str:
    """Returns a setting as it stands in a command; nothing for no words."""
    return (" ".join(map(str, value)) if isinstance(value, list) else str(value)) or "nothing"
