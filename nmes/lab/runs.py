"""Runs of evolution and learning, as a page shows them, and the command lines that begin them and go on with them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from nmes.evaluation.match_task import MatchTask
from nmes.evaluation.task import Task
from nmes.evolution.history import History, Origin
from nmes.evolution.run import Run
from nmes.evolution.run_folder import SETTINGS, read_settings, text_of
from nmes.evolution.run_settings import FORMAT, RunSettings
from nmes.genome import Genome
from nmes.lab.folder import Folder, LabError
from nmes.learning.run import LearningRun
from nmes.learning.settings import LearningSettings
from nmes.schemas.documents import JsonObject, parse_document, write_json
from nmes.view.learning_page import to_json as learning_json
from nmes.view.run_summary import RunSummary

__all__ = [
    "about_run",
    "begin_command",
    "candidate",
    "candidate_index",
    "genome_source",
    "is_learning",
    "resume_command",
    "table_command",
    "task_source",
]

_LEARNING: Final = "nmes-learning/1"
_INDEX: Final = re.compile(r"[0-9]{1,12}")
_LINEAGE: Final = 500  # ancestors that are told
_BUDGET: Final = 1_000_000_000  # candidates
_OF_TABLES: Final = {"episodes": (1, 100_000), "seed": (0, 1_000_000_000), "delay": (0, 12)}
_LESSONS: Final = 100  # recordings that are learned from
_ELITES: Final = 2500  # a grid of 50 x 50


def genome_source(folder: Folder, name: Any) -> str:
    """Returns a genome's argument for the command line: its file in the lab's folder, or a name that ships.

    Raises:
        LabError: There is none of that name.
    """
    return _source(folder, "genomes", name, Genome.names())


def task_source(folder: Folder, name: Any) -> str:
    """Returns a task's argument for the command line, as `genome_source`."""
    return _source(folder, "tasks", name, (*Task.names(), *MatchTask.names()))


def _source(folder: Folder, kind: Any, name: Any, shipped: Sequence[str]) -> str:
    if not isinstance(name, str):
        raise LabError("invalid", f"name one of the {kind}", kind)
    if name in folder.scan(kind):
        return str(folder.find(kind, name))
    if name not in shipped:
        raise LabError("unknown_name", f"there is nothing called {name!r} among the {kind}", kind)
    return name


def begin_command(folder: Folder, kind: Any, name: Any, settings: Any) -> list[str]:
    """Returns the command that begins a run, once its settings are judged.

    Args:
        folder: The lab's.
        kind: `evolve` or `learn`.
        name: The run's.
        settings: Of evolution a document as `schemas/run.json` has it, its task and genomes by name or whole; of
            learning `genome` and `task` (by name, or the document), or for `clone` the names of `recordings`, and
            `algorithm`, `options`, `steps`, `seed`, `reward` and `every`.

    Raises:
        LabError: There is such a run, or a name that means nothing.
        DocumentError: The settings are none, with all that is wrong.
    """
    if kind not in ("evolve", "learn") or not isinstance(settings, dict) or not isinstance(name, str):
        raise LabError("invalid", 'a run has a kind, "evolve" or "learn", a name, and settings', "kind")
    target = folder.place("runs", name)
    if target.exists():
        raise LabError("run_exists", f"there is a run called {name!r}: resume it, or choose another name", "name")
    if kind == "learn":
        return [*_learn(folder, name, settings), "-o", str(target), "--json"]
    document = {**settings, "format": settings.get("format", FORMAT)}
    if isinstance(document.get("task"), str):
        document["task"] = _document(task_source(folder, document["task"]))
    if isinstance(document.get("starts"), list):
        document["starts"] = _starts(folder, document["starts"])
    if isinstance(document.get("populations"), list):
        document["populations"] = [
            {**each, "starts": _starts(folder, each.get("starts", []))} if isinstance(each, dict) else each
            for each in document["populations"]
        ]
    RunSettings.read(document)
    file = folder.write("settings", name, text_of(document))
    return ["evolve", "--settings", str(file), "-o", str(target), "--json"]


def _starts(folder: Folder, starts: Any) -> Any:
    """Returns genomes to begin with, by what means them: a name that ships stays one, all else is a document."""
    if not isinstance(starts, list):
        return starts
    return [_document(genome_source(folder, one)) if isinstance(one, str) else one for one in starts]


def _document(source: str) -> Any:
    """Returns the document in a file; a name that ships as it is."""
    path = Path(source)
    return parse_document(path.read_bytes()) if path.suffix == ".json" else source


def _learn(folder: Folder, name: str, settings: Mapping[str, Any]) -> list[str]:
    """Returns the command that begins a run of learning."""
    cloning = settings.get("algorithm") == "clone"
    known = {"algorithm", "steps", "seed", "every", "reward"}
    if unknown := settings.keys() - known - {"options"} - ({"recordings"} if cloning else {"genome", "task"}):
        raise LabError("invalid", f"there is no setting {sorted(unknown)[0]!r}", "settings")
    options = settings.get("options", {})
    document = {"format": _LEARNING, "algorithm": "ppo", "steps": 1_000_000, "seed": 0, "every": 5, "options": options}
    document |= {name: settings[name] for name in known if name in settings}
    if (
        cloning
    ):  # creature and task are those of the recordings, which the command runs again: here others stand for them
        paths = _episodes(folder, settings.get("recordings"))
        stand_ins = {"genome": "walker", "task": "walk", "episodes": "0" * 32}
        LearningSettings.read(document | stand_ins | {"recordings": paths})
        command = ["learn", *paths]
    else:
        genome, task = genome_source(folder, settings.get("genome")), settings.get("task", "walk")
        if not isinstance(task, dict):
            task = task_source(folder, task)
        LearningSettings.read(document | {"genome": genome, "task": task})
        if isinstance(task, dict):
            task = str(folder.write("settings", name, text_of(task)))
        command = ["learn", genome, "--task", task]
    for setting in sorted(known & settings.keys()):
        command += [f"--{setting}", str(settings[setting])]
    for option, value in options.items():
        command += ["--set", f"{option}={write_json(value).decode()}"]
    return command


def _episodes(folder: Folder, names: Any) -> list[str]:
    """Returns the paths of recordings that are learned from."""
    if not isinstance(names, list) or not 1 <= len(names) <= _LESSONS or not all(isinstance(one, str) for one in names):
        raise LabError("invalid", f"name from 1 to {_LESSONS} recordings to learn from", "recordings")
    return [str(folder.find("recordings", name)) for name in names]


def table_command(folder: Folder, asked: JsonObject) -> list[str]:
    """Returns the command that teaches a cube by Q-learning and keeps its table.

    Args:
        folder: The lab's.
        asked: The `name` of the table, and perhaps `episodes`, `seed` and `delay` as numbers.

    Raises:
        LabError: There is such a table, or a setting that there is not.
    """
    name = asked.get("name")
    if not isinstance(name, str):
        raise LabError("invalid", "a table has a name", "name")
    target = folder.place("tables", name)
    if target.exists():
        raise LabError("name_taken", f"there is a table called {name!r}: choose another name", "name")
    command = ["learn", "cube", "-o", str(target), "--json"]
    for setting in sorted(asked.keys() - {"name"}):
        low, high = _OF_TABLES.get(setting, (0, -1))
        value = asked[setting]
        if type(value) is not int or not low <= value <= high:
            known = ", ".join(f"{each} ({least:,} to {most:,})" for each, (least, most) in _OF_TABLES.items())
            raise LabError("invalid", f"settings are whole numbers: {known}", setting)
        command += [f"--{setting}", str(value)]
    return command


def resume_command(folder: Folder, name: str, budget: Any = None) -> list[str]:
    """Returns the command that goes on with a run, of evolution perhaps with another budget.

    Raises:
        LabError: There is none, or no such budget.
    """
    path = folder.find("runs", name)
    learning = is_learning(path)
    if budget is None:
        return ["learn" if learning else "evolve", "resume", str(path), "--json"]
    if learning:
        reason = "a run of learning has the steps that it was begun with: begin another like it, with more"
        raise LabError("invalid", reason, "budget")
    if type(budget) is not int or not len(Run.open(path)) <= budget <= _BUDGET or budget < 1:
        raise LabError("invalid", f"a budget is a number from as many as were told to {_BUDGET:,}", "budget")
    return ["evolve", "resume", str(path), "--budget", str(budget), "--json"]


def is_learning(path: Path) -> bool:
    """Whether a run is one of learning.

    Raises:
        LabError: There is none.
    """
    try:
        settings = read_settings(path / SETTINGS)
    except OSError as error:
        raise LabError("not_found", f"there is no run in {path}", "name") from error
    return isinstance(settings, dict) and settings.get("format") == _LEARNING


def about_run(folder: Folder, name: str) -> JsonObject:
    """Returns the state and the results of a run.

    Raises:
        LabError: There is none of that name.
        RunError: It is damaged.
    """
    path = folder.find("runs", name)
    if is_learning(path):
        return {"kind": "learn", **learning_json(LearningRun.open(path))}
    run = Run.open(path)
    summary = RunSummary(run)
    best = summary.best
    records = run.records
    return {
        "kind": "evolve",
        **summary.to_json(),
        "finished": run.finished,
        "curve": _curve(summary.history) if records else [],
        "archive": [_row(records[index]) for index in run.elites()[:_ELITES]],
        "lineage": [] if best is None else [_row(row) for row in summary.history.lineage(best.index)[-_LINEAGE:]],
    }


def _curve(history: History) -> list[JsonObject]:
    """Returns the scores by window of candidates, and the best so far."""
    champions = history.champions()
    points, best, place = [], None, 0
    for window in history.windows():
        while place < len(champions) and champions[place].index < window.end:
            best, place = champions[place].score, place + 1
        points.append({"begin": window.begin, "end": window.end, "quartiles": window.quartiles, "best": best})
    return points


def _row(row: Origin) -> JsonObject:
    return {
        "index": row.index,
        "score": row.score,
        "operator": row.operator,
        "parents": list(row.parents),
        "generation": row.generation,
        "group": row.group,
        "objectives": list(row.objectives),
        "measures": list(row.measures),
    }


def candidate(folder: Folder, name: str, number: str) -> JsonObject:
    """Returns the genome of a candidate of a run, by its index or as the `best`; of learning there is the best alone.

    Raises:
        LabError: There is none.
        RunError: It is damaged.
    """
    index, path = candidate_index(folder, name, number), folder.find("runs", name)
    if is_learning(path):
        return dict(Genome.load(path / "genome.json").document)
    return dict(Run.open(path).genome(index).document)


def candidate_index(folder: Folder, name: str, number: str) -> int:
    """Returns the index of a candidate, as for `candidate`; of the best of a run of learning 0.

    Raises:
        LabError: There is none.
        RunError: The run is damaged.
    """
    path = folder.find("runs", name)
    if is_learning(path):
        if number != "best" or not (path / "genome.json").is_file():
            raise LabError("not_found", "a run of learning has its best alone, once there is one", "candidate")
        return 0
    run = Run.open(path)
    best = run.best
    index = best.index if number == "best" and best is not None else int(number) if _INDEX.fullmatch(number) else -1
    if not 0 <= index < len(run):
        raise LabError("not_found", f"the run has no candidate {number}", "candidate")
    return index
