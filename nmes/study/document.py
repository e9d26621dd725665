"""A study as its `study.toml` has it: what is asked, what is compared, and which runs that takes.

Hides the file and what is judged of it beyond its schema: every name in it leads somewhere, every placeholder of every
command has a value, every condition can be read, so that a run of hours does not fail at its end for a slip of the pen.
"""

from __future__ import annotations

import math
import os
import re
import shlex
import tomllib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from itertools import product
from pathlib import Path
from typing import Any, Final

from nmes.errors import DocumentError, StudyError, WorldError
from nmes.objective import Condition
from nmes.schemas.documents import JsonObject, canonical_hash, check, compile_schema, complete, did_you_mean
from nmes.schemas.files import read_regular

__all__ = [
    "BUDGETS",
    "COMPARISONS",
    "PLACE",
    "Plan",
    "PlannedRun",
    "Setting",
    "Study",
    "condition",
    "fill",
    "settle",
    "tells",
]

BUDGETS: Final = ("small", "full")
COMPARISONS: Final = ("improvement", "difference", "equal")
"""The statistics of two arms."""
_SCHEMA: Final = compile_schema("study.json")
_LARGEST: Final = 1 << 20  # bytes of `study.toml`
_POINTS: Final = 200  # in a line of it: what a key of many parts costs grows with their square
_FILE: Final = 64 << 20  # bytes of another document of a study
_RUNS: Final = 100_000  # of a plan
_INTEGER: Final = 1 << 53  # beyond it doubles have gaps
_WRITTEN: Final = {*BUDGETS, "work", "study.toml"}  # what does not decide what a run comes to
_OWN: Final = ("run", "study", "seed")  # placeholders that every command has
_RESERVED: Final = ("arm", "seed", "measured")  # columns of all results
PLACE: Final = re.compile(r"\{([^{}]*)\}")
"""A placeholder in a command."""

Setting = str | float | int


@dataclass(frozen=True, slots=True)
class PlannedRun:
    """One arm in one cell with one seed.

    Attributes:
        number: Its place in the plan, from 0.
        arm: The arm's document.
        cell: The value of each factor.
        seed: The seed.
        values: What placeholders of its commands stand for, but for folders and what commands beside it say.
    """

    number: int
    arm: JsonObject
    cell: dict[str, Setting]
    seed: int
    values: dict[str, Setting | list[Setting]] = field(repr=False)

    def __str__(self) -> str:
        cell = "".join(f", {name} {value}" for name, value in self.cell.items())
        return f"run {self.number} (arm {self.arm['name']}{cell}, seed {self.seed})"


@dataclass(frozen=True, slots=True)
class Plan:
    """All runs of a study with a budget.

    Attributes:
        study: The study.
        budget: `small` or `full`.
        runs: The runs, in the order of the results.
        asked: The hash of what is asked: of `study.toml` without the other budget, how many minutes it may take and
            which criteria were changed, and of the documents beside it.
    """

    study: Study
    budget: str
    runs: tuple[PlannedRun, ...]
    asked: str

    @property
    def folder(self) -> Path:
        """Where its results and its report are."""
        return self.study.folder / self.budget


class Study:
    """A study.

    Attributes:
        folder: Its folder.
        name: The folder's name.
        document: What `study.toml` says, with its defaults.
        given: The same as it was given, which its hash is of.
    """

    def __init__(self, folder: Path, document: Any) -> None:
        """Judges what the file says.

        Raises:
            DocumentError: It is no study.
        """
        unusable = list(_unusable("", document))
        if unusable:
            raise DocumentError(unusable)
        check(_SCHEMA, document)
        self.folder, self.name, self.given = folder, folder.name, document
        self.document = complete(_SCHEMA.schema, document)
        for name in ("settings", "factors", "missing", "scales"):
            self.document.setdefault(name, {})
        for name in ("figures", "measured"):
            self.document.setdefault(name, [])
        problems = list(self._problems())
        if problems:
            raise DocumentError(problems)

    @classmethod
    def load(cls, name: str | os.PathLike[str]) -> Study:
        """Reads the study in a folder, or the one of that name in `studies`.

        Raises:
            StudyError: There is none, or it cannot be read (`no_study`).
        """
        folder = Path(name)
        if not (folder / "study.toml").is_file() and len(folder.parts) == 1:
            folder = Path("studies") / folder
        path = folder / "study.toml"
        try:
            text = read_regular(path, _LARGEST).decode()
            if any(line.count(".") > _POINTS for line in text.splitlines()):
                raise StudyError(
                    "no_study", f"{path}: a line has over {_POINTS} points: a key may be of that many parts"
                )
            document = tomllib.loads(text, parse_float=_finite)
            return cls(folder.resolve(), document)
        except OSError as error:
            raise StudyError("no_study", f"there is no study in {folder}: {path}: {error.strerror}") from error
        except DocumentError as error:
            raise StudyError("no_study", f"{path} is not as it must be:\n{error.message}") from error
        except (ValueError, RecursionError) as error:  # of TOML, of UTF-8 too
            raise StudyError("no_study", f"{path} is no TOML: {error}") from error

    def plan(self, budget: str) -> Plan:
        """Returns the runs of a budget.

        Raises:
            StudyError: The study has no such budget, or a document of it cannot be read (`no_study`).
        """
        budgets = self.document["budgets"]
        if budget not in budgets:
            raise StudyError("no_study", f"{self.name} has no budget {budget}: there is {', '.join(budgets)}")
        cells = ((arm, cell) for arm in self.document["arms"] for cell in self._cells(budget, arm))
        runs = [
            PlannedRun(number, arm, cell, seed, self._values(budget, arm, cell) | {"seed": seed})
            for number, ((arm, cell), seed) in enumerate(product(cells, budgets[budget]["seeds"]))
        ]
        kept = {name: value for name, value in self.given["budgets"][budget].items() if name != "minutes"}
        claims = [{name: each for name, each in claim.items() if name != "changed"} for claim in self.given["claims"]]
        judged = {**self.given, "claims": claims, "budgets": {budget: kept}}
        asked = canonical_hash({"study": judged, "files": self._files()})
        return Plan(self, budget, tuple(runs), asked)

    def arm_commands(self, arm: JsonObject) -> dict[str, str]:
        """Returns the commands of an arm by name, in their order."""
        every: dict[str, str] = self.document["commands"]
        return {name: command for name, command in every.items() if name in arm.get("commands", every)}

    def shared_columns(self, arms: Sequence[str]) -> list[str]:
        """Returns the columns of commands that all of some arms have, but for those that are measured."""
        commands = [self.arm_commands(arm) for arm in self.document["arms"] if arm["name"] in arms]
        columns = {
            name: each for name, each in self.document["columns"].items() if name not in self.document["measured"]
        }
        return [name for name, source in columns.items() if all(source.partition(" ")[0] in each for each in commands)]

    def factors(self, budget: str) -> dict[str, list[Setting]]:
        """Returns the values of each factor that a budget has."""
        fewer = self.document["budgets"][budget].get("factors", {})
        return {name: fewer.get(name, values) for name, values in self.document["factors"].items()}

    def scale(self, cell: Mapping[str, Setting]) -> float:
        """Returns the number by which values of a cell are divided before cells are put together."""
        scales: Mapping[str, Mapping[str, float]] = self.document["scales"]
        return math.prod(values[str(cell[factor])] for factor, values in scales.items())

    def _cells(self, budget: str, arm: JsonObject) -> Iterator[dict[str, Setting]]:
        """Yields the cells that an arm has: a value of each factor."""
        factors, own = self.factors(budget), arm.get("factors", {})
        for values in product(*factors.values()):
            cell = dict(zip(factors, values, strict=True))
            if all(cell[name] in chosen for name, chosen in own.items()):
                yield cell

    def _values(self, budget: str, arm: JsonObject, cell: Mapping[str, Setting]) -> dict[str, Setting | list[Setting]]:
        own = self.document["budgets"][budget].get("settings", {})
        return {**self.document["settings"], **own, **arm.get("settings", {}), **cell}

    def _files(self) -> dict[str, str]:
        """Returns the digest of each document beside `study.toml`, which commands may read; hidden files are none.

        Raises:
            StudyError: One cannot be read, or there is a folder, which is not looked into (`no_study`).
        """
        try:
            names = sorted(path.name for path in self.folder.iterdir() if path.name not in _WRITTEN)
            found = [self.folder / name for name in names if not name.startswith(".")]
            for path in found:
                path.name.encode()
                if path.is_dir():
                    advice = "documents of a study lie beside its study.toml, where a change of them is noticed"
                    raise StudyError("no_study", f"{path} is a folder: {advice}")
            return {path.name: sha256(read_regular(path, _FILE)).hexdigest() for path in found if path.is_file()}
        except OSError as error:
            raise StudyError("no_study", f"cannot read {error.filename}: {error.strerror}") from error
        except UnicodeEncodeError as error:
            raise StudyError("no_study", f"{self.folder}: the name {error.object!r} is not in UTF-8") from error

    def _named(self) -> Iterator[tuple[str, Collection[str]]]:
        """Yields each place of the document that gives values to placeholders, with their names."""
        document = self.document
        yield "factors", document["factors"]
        yield "settings", document["settings"]
        for place, arm in enumerate(document["arms"]):
            yield f"arms/{place}/settings", arm.get("settings", {})
        for budget, each in document["budgets"].items():
            yield f"budgets/{budget}/settings", each.get("settings", {})

    # -- what is judged beyond the schema ------------------------------------------------------------------------

    def _problems(self) -> Iterator[tuple[str, str]]:
        document = self.document
        for kind in ("claims", "arms", "figures"):
            names = [each["name"] for each in document[kind]]
            yield from (
                (f"{kind}/{place}/name", f"there are two of the name {name}")
                for place, name in enumerate(names)
                if name in names[:place]
            )
        for name, values in document["factors"].items():
            if len({isinstance(value, str) for value in values}) > 1:
                yield f"factors/{name}", "its values must be all numbers or all words"
        for path, named in self._named():
            for name in _OWN:
                if name in named:
                    yield f"{path}/{name}", f"{{{name}}} is a placeholder of every command: give it another name"
        yield from self._command_problems()
        yield from self._column_problems()
        yield from self._value_problems()
        for place, claim in enumerate(document["claims"]):
            for name in ("holds", "refuted", "partly"):
                try:
                    condition(claim.get(name, "true"), document["values"])
                except WorldError as error:
                    yield f"claims/{place}/{name}", error.message.partition(": ")[2]
        for name, each in document["budgets"].items():
            yield from self._budget_problems(name, each)

    def _command_problems(self) -> Iterator[tuple[str, str]]:
        """Yields what would keep a command from being begun."""
        document = self.document
        commands = {f"commands/{name}": command for name, command in document["commands"].items()}
        for place, arm in enumerate(document["arms"]):
            beside: Mapping[str, str] = arm.get("beside", {})
            commands |= {f"arms/{place}/beside/{name}": command for name, command in beside.items()}
            for name in arm.get("environment", {}):
                if not name or "=" in name:
                    yield f"arms/{place}/environment", f"{name!r} cannot be the name of a variable"
        for path, command in commands.items():
            try:
                shlex.split(command)
            except ValueError as error:
                yield path, f"it is no command line: {str(error).lower()}"

    def _column_problems(self) -> Iterator[tuple[str, str]]:
        document = self.document
        for name, source in document["columns"].items():
            if name in (*_RESERVED, *document["factors"]):
                yield f"columns/{name}", "results have another column of that name"
            yield from _unknown(f"columns/{name}", source.partition(" ")[0], document["commands"], "command")
        for place, arm in enumerate(document["arms"]):
            for name in arm.get("commands", ()):
                yield from _unknown(f"arms/{place}/commands", name, document["commands"], "command")
            yield from self._factor_problems(f"arms/{place}/factors", arm.get("factors", {}))
        for path in ("missing", "measured"):
            for name in document[path]:
                yield from _unknown(path, name, document["columns"], "column")
        for place, figure in enumerate(document["figures"]):
            yield from _unknown(f"figures/{place}/column", figure["column"], document["columns"], "column")
            yield from self._where_problems(f"figures/{place}/where", figure)
        for factor, scales in document["scales"].items():
            yield from _unknown("scales", factor, document["factors"], "factor")
            for value in document["factors"].get(factor, ()):
                yield from _unknown(f"scales/{factor}", str(value), scales, "scale of the value")

    def _value_problems(self) -> Iterator[tuple[str, str]]:
        document = self.document
        arms = {arm["name"]: arm for arm in document["arms"]}
        for name, value in document["values"].items():
            path = f"values/{name}"
            column = value.get("column")
            if column is not None:
                yield from _unknown(f"{path}/column", column, document["columns"], "column")
            elif value["statistic"] != "equal":
                yield f"{path}/column", f"{value['statistic']} is of a column"
            elif not self.shared_columns([value["arm"], value.get("over", "")]):
                yield f"{path}/column", "both arms have no column that is not measured: there is nothing to be equal"
            if (value["statistic"] in COMPARISONS) != ("over" in value):
                yield f"{path}/over", f"{value['statistic']} is of {'two arms' if 'over' not in value else 'one arm'}"
            source = document["columns"].get(column, "").partition(" ")[0]
            for role in ("arm", "over"):
                arm = value.get(role)
                if arm is not None:
                    yield from _unknown(f"{path}/{role}", arm, arms, "arm")
                    if arm in arms and source in document["commands"] and source not in self.arm_commands(arms[arm]):
                        yield f"{path}/{role}", f"arm {arm} does without the command of the column"
            yield from self._where_problems(f"{path}/where", value)

    def _where_problems(self, path: str, document: JsonObject) -> Iterator[tuple[str, str]]:
        """Yields what is wrong with the cells that a value or a figure is of."""
        yield from self._factor_problems(path, {factor: [value] for factor, value in document.get("where", {}).items()})

    def _factor_problems(self, path: str, fewer: Mapping[str, list[Setting]]) -> Iterator[tuple[str, str]]:
        """Yields what is wrong with some of the values of some factors."""
        for factor, values in fewer.items():
            yield from _unknown(path, factor, self.document["factors"], "factor")
            for value in values:
                if value not in self.document["factors"].get(factor, values):
                    yield f"{path}/{factor}", f"there is no value {value}"

    def _budget_problems(self, budget: str, document: JsonObject) -> Iterator[tuple[str, str]]:
        path = f"budgets/{budget}"
        yield from self._factor_problems(f"{path}/factors", document.get("factors", {}))
        cells = math.prod(map(len, self.factors(budget).values()))
        if cells * len(self.document["arms"]) * len(document["seeds"]) > _RUNS:
            yield path, f"it has over {_RUNS:,} runs"
            return
        yield from self._cell_problems(budget)
        for place, arm in enumerate(self.document["arms"]):
            yield from _place_problems(
                f"arms/{place}",
                self._values(budget, arm, self.document["factors"]),
                arm.get("beside", {}),
                self.arm_commands(arm),
            )

    def _cell_problems(self, budget: str) -> Iterator[tuple[str, str]]:
        """Yields the values that would be of no runs of a budget, or compare arms that have not the same cells."""
        cells = {arm["name"]: list(self._cells(budget, arm)) for arm in self.document["arms"]}
        yield from ((f"budgets/{budget}", f"arm {name} has no runs") for name, found in cells.items() if not found)
        for place, figure in enumerate(self.document["figures"]):
            source = self.document["columns"].get(figure["column"], "").partition(" ")[0]
            shown = [cells[arm["name"]] for arm in self.document["arms"] if source in self.arm_commands(arm)]
            if not any(figure.get("where", {}).items() <= cell.items() for each in shown for cell in each):
                yield f"figures/{place}", f"no arm has such runs with budget {budget}"
        for name, value in self.document["values"].items():
            where = value.get("where", {}).items()
            found = [
                [cell for cell in cells.get(value[role], ()) if where <= cell.items()]
                for role in ("arm", "over")
                if role in value
            ]
            if not found[0]:
                yield f"values/{name}", f"arm {value['arm']} has no such runs with budget {budget}"
            elif found[1:] not in ([], [found[0]]):
                what = f"arms {value['arm']} and {value['over']} have not the same cells with budget {budget}"
                yield f"values/{name}", f"{what}: say `where` both have"


def condition(text: str, values: Mapping[str, object]) -> Condition:
    """Reads a condition over the values of a study.

    Raises:
        WorldError: `bad_expression`.
    """
    names = {name: ("a value of the study", "") for name in values}
    return Condition(text, "condition", names=names, parts={"low": tuple(values), "high": tuple(values)})


def tells(command: str) -> bool:
    """Tells whether a command beside prints a line of JSON, in which there is what placeholders stand for."""
    return "--json" in command.split()


def settle(
    settings: Mapping[str, Setting | list[Setting]], folders: Mapping[str, str]
) -> dict[str, Setting | list[Setting]]:
    """Returns settings and folders, in the settings what their placeholders stand for.

    Folders are taken as they are: their names may have braces.
    """
    values = {**settings, **folders}
    settled: dict[str, Setting | list[Setting]] = {name: _settled(value, values) for name, value in settings.items()}
    return {**settled, **folders}


def fill(words: list[str], values: Mapping[str, Setting | list[Setting]]) -> list[str]:
    """Returns the words of a command with what its placeholders stand for; a list stands for several words.

    Raises:
        KeyError: Nothing stands for one.
    """
    filled: list[str] = []
    for word in words:
        whole = PLACE.fullmatch(word)
        value = values[whole[1]] if whole is not None else None
        if isinstance(value, list):
            filled += map(_text, value)
        else:
            filled.append(_filled(word, values))
    return filled


def _settled(value: Setting | list[Setting], values: Mapping[str, Setting | list[Setting]]) -> Setting | list[Setting]:
    """Returns a setting with what the placeholders in it stand for."""
    if isinstance(value, list):
        return [_filled(_text(each), values) for each in value]
    return _filled(value, values) if isinstance(value, str) else value


def _filled(text: str, values: Mapping[str, Setting | list[Setting]]) -> str:
    """Returns a text with what its placeholders stand for, as it is, braces and all."""
    return PLACE.sub(lambda place: _text(values[place[1]]), text)


def _text(value: Any) -> str:
    if isinstance(value, list):
        return " ".join(map(_text, value))
    if isinstance(value, bool):
        return "true" if value else "false"
    return str(int(value)) if isinstance(value, float) and value.is_integer() else str(value)


def _place_problems(
    path: str,
    settings: Mapping[str, Setting | list[Setting]],
    beside: Mapping[str, str],
    commands: Mapping[str, str],
) -> Iterator[tuple[str, str]]:
    """Yields the placeholders of an arm that nothing would stand for."""
    known = {*settings, *_OWN}
    for name, value in settings.items():
        for inner in PLACE.findall(_text(value)):
            if inner not in known:
                yield path, f"setting {name}: there is nothing that {{{inner}}} stands for"
            elif inner not in _OWN and (further := PLACE.search(_text(settings[inner]))) is not None:
                yield path, f"setting {name}: {{{inner}}} stands for {further[0]}, which has to stand there itself"
    printed = list[str]()  # what the names of that begin with which is printed before a command: `host.`, `record/`
    for end, each in ((".", beside), ("/", commands)):
        for command, text in each.items():
            for name in PLACE.findall(text):
                if name not in known and not name.startswith(tuple(printed)):
                    yield path, f"there is nothing that {{{name}}} stands for{did_you_mean(name, known)}"
            if end == "/" or tells(text):
                printed.append(command + end)


def _unknown(path: str, name: str, known: Mapping[str, object], what: str) -> Iterator[tuple[str, str]]:
    if name not in known:
        yield path, f"there is no {what} {name}{did_you_mean(name, known)}"


def _unusable(path: str, value: object) -> Iterator[tuple[str, str]]:
    """Yields what TOML can say and neither a table nor a command line can hold."""
    if isinstance(value, dict):
        for name, each in value.items():
            yield from _unusable(path, name)
            yield from _unusable(f"{path}/{name}".removeprefix("/"), each)
    elif isinstance(value, list):
        for place, each in enumerate(value):
            yield from _unusable(f"{path}/{place}", each)
    elif isinstance(value, str) and "\0" in value:
        yield path, "it has a character of the code 0"
    elif isinstance(value, int) and abs(value) > _INTEGER:
        yield path, f"whole numbers go to {_INTEGER:,} here: beyond it doubles have gaps"


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text} is no finite number")
    return value
