"""Short runs of evolution: small bodies, episodes of a third of a second."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import orjson

from nmes.evaluation.parallel import Here
from nmes.evolution.run import Run
from nmes.evolution.run_settings import RunSettings
from nmes.schemas.documents import canonical_hash

__all__ = ["SETTINGS", "TASK", "begin", "finish", "forge"]

TASK: dict[str, Any] = {
    "format": "nmes-task/1",
    "name": "moment",
    "description": "Get far in a moment.",
    "duration": 0.2,
    "settle": 0,
    "settle_limit": 0.25,
    "seeds": [1],
    "objective": "displacement.horizontal",
    "limits": {"cubes": 3},
}
SETTINGS: dict[str, Any] = {
    "format": "nmes-run/1",
    "task": TASK,
    "algorithm": "ga",
    "options": {"founders": 8, "population": 8, "window": 6},
    "budget": 24,
    "seed": 3,
}


def begin(folder: Path, **settings: Any) -> Run:
    """Makes a run that has not begun yet."""
    return Run.create(folder, RunSettings.read({**SETTINGS, **settings}))


def finish(run: Run) -> Run:
    """Goes on with a run to its end, in this process."""
    with Here() as here:
        for _ in run.advance(here):
            pass
    return run


def forge(folder: Path, change: Callable[[list[dict[str, Any]]], None]) -> None:
    """Changes the records of a log, and computes the chain of digests anew, as somebody would who wants to deceive."""
    from nmes.evolution.run_log import RunLog, RunWriter

    path = folder / "log.jsonl"
    records = [json.loads(line) for line in path.read_text().splitlines()]
    for record in records:
        del record["digest"]
    change(records)
    path.unlink()
    (folder / "index.sqlite").unlink(missing_ok=True)
    settings = orjson.loads((folder / "run.json").read_bytes())
    origin = canonical_hash({name: value for name, value in settings.items() if name not in ("budget", "fingerprint")})
    writer = RunWriter(RunLog(path, origin))
    writer.append(records)
    writer.close()
