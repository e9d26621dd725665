"""How far evolution comes from random bodies, beside random creatures: some twenty minutes of two cores for each seed.

    python benchmarks/evolving.py walk stairs                # `islands`, seeds 1 to 5
    python benchmarks/evolving.py walk --random              # and as many random creatures, with the same seeds
    python benchmarks/evolving.py walk --seeds 1 2 --jobs 1 -o runs/bars

The runs are those of `nmes evolve`, with the commands that are printed: one on a single seed of the task, and a short
one on all of its seeds from the winner. For `stairs` the first is on `walk`, and one goes on from the best of its
islands with the score of `ascent.json`. They are kept in a folder: what is finished is not done again, and what was
interrupted goes on. CPU times are of this machine, and only of what was done now.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shlex
import statistics
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nmes.evolution.run import Run
from nmes.evolution.run_index import Record
from nmes.schemas.documents import write_json


@dataclass(frozen=True)
class Plan:
    """What twenty minutes of two cores are spent on.

    Attributes:
        candidates: How many the race from random bodies has, on one seed.
        ground: The task of the race, where it is another one: a task that pays nothing until much is achieved tells a
            search nothing about which random bodies are better.
        starts: With how many of each island's best the next run begins: who is the best on another task is seldom the
            best on this one.
        way: The task of that run: this one with a score that begins earlier.
        middle: How many candidates it has, on one seed.
        finish: How many follow on all seeds of the task itself, from the best so far.
        pace: Body lengths a second from which on who scores `enough` comes before all that are slower.
        enough: See there.
    """

    candidates: int = 24_000
    ground: str | None = None
    starts: int = 5
    way: str | None = None
    middle: int = 0
    finish: int = 500
    pace: float = 0.0
    enough: float = 0.0


ASCENT = str(Path(__file__).with_name("tasks") / "ascent.json")
PLANS = {
    "walk": Plan(pace=1.5, enough=15.8),
    "stairs": Plan(candidates=12_000, ground="walk", way=ASCENT, middle=1_500, finish=600),
}
"""Of tasks for which it is not the same as for all others."""
RACE = "--algorithm islands --seeds 1 --set rung=1500 --set founders=500 --set population=150 --set tournament=3"
LAST = "--algorithm afpo --set founders=100 --set population=50 --set tournament=3 --set newcomers=0"
MIDDLE = "--algorithm afpo --seeds 1 --set founders=200 --set population=100 --set tournament=3 --set newcomers=0"
RANDOM = "--algorithm random --seeds 1"


def nmes(*words: str) -> Any:
    """Runs a command of NMES, says which, and returns the object that it prints."""
    print(f"  nmes {shlex.join(words)}", file=sys.stderr, flush=True)
    command = [sys.executable, "-P", "-m", "nmes", *words, "--json"]
    return json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)


def evolved(what: str, folder: Path, options: str, budget: int, jobs: str) -> None:
    """Runs evolution until it has had a budget, or goes on where it was."""
    if not folder.exists():
        nmes("evolve", what, *options.split(), "--budget", str(budget), "--jobs", jobs, "--quiet", "-o", str(folder))
    elif len(Run.open(folder)) < budget:
        nmes("evolve", "resume", str(folder), "--budget", str(budget), "--jobs", jobs, "--quiet")


def best(folder: Path, budget: int, plan: Plan) -> tuple[Path, float]:
    """Writes the best of a run's first candidates; returns the file with its genome, and its score."""
    run = Run.open(folder)
    index, score = winner(run, budget, plan)
    written = folder / f"winner-of-{budget}"
    if not written.exists():
        nmes("evolve", "best", str(folder), "--index", str(index), "-o", str(written))
    return written / "genome.json", score


def winner(run: Run, budget: int, plan: Plan) -> tuple[int, float]:
    """Returns the place and the score of the best of a run's first candidates, in the sense of the plan."""
    told = [record for record in run.records[:budget] if record.score is not None]
    ranked = sorted(told, key=lambda record: (-(record.score or 0.0), record.index))
    fast = (each for each in ranked if (each.score or 0.0) >= plan.enough and pace(run, each.index) >= plan.pace)
    chosen = ranked[0] if plan.pace == 0.0 else next(fast, ranked[0])
    return chosen.index, chosen.score or 0.0


def best_of_islands(race: Path, budget: int, count: int, written: Path) -> Path:
    """Writes so many of the best of each island of a race's first candidates into a folder, which it returns."""
    run, islands = Run.open(race), dict[str, list[Record]]()
    for record in run.records[:budget]:
        if record.score is not None:
            islands.setdefault(record.group, []).append(record)
    written.mkdir(exist_ok=True)
    for records in islands.values():
        for record in sorted(records, key=lambda record: (-(record.score or 0.0), record.index))[:count]:
            (written / f"{record.index}.json").write_bytes(write_json(run.genome(record.index).document))
    return written


def champion(task: str, seed: int, folder: Path, jobs: str) -> tuple[float, float, float]:
    """Returns the best score on one seed, and that of the run from the winner on all seeds with its `pace`."""
    plan = PLANS.get(task, Plan())
    ground = plan.ground or task
    race = folder / f"{ground}-{seed}-race"
    middle, last = (folder / f"{task}-{seed}-{part}" for part in ("middle", "last"))
    evolved("random", race, f"--task {ground} --seed {seed} {RACE}", plan.candidates, jobs)
    if plan.way is None:
        genome, one = best(race, plan.candidates, plan)
    else:
        starts = best_of_islands(race, plan.candidates, plan.starts, folder / f"{task}-{seed}-starts")
        evolved(str(starts), middle, f"--task {plan.way} --seed {seed} {MIDDLE}", plan.middle, jobs)
        genome, one = best(middle, plan.middle, plan)
    evolved(str(genome), last, f"--task {task} --seed {seed} {LAST}", plan.finish, jobs)
    _, score = best(last, plan.finish, plan)
    run = Run.open(last)
    return one, score, pace(run, winner(run, plan.finish, plan)[0])


def pace(run: Run, index: int) -> float:
    """Returns how fast a candidate is over the ground, in body lengths (the longest edge at rest) a second."""
    (low, high), evaluation = run.genome(index).body.bounds, run.evaluation(index)
    assert evaluation.distance is not None
    ticks = statistics.mean(result.ticks for result in evaluation.results)
    seconds = ticks / run.settings.task.tick_rate
    return evaluation.distance / seconds / max(end - begin for begin, end in zip(low, high, strict=True))


def luck(task: str, seed: int, folder: Path, jobs: str) -> float:
    """Returns the best score, on one seed, of as many random creatures as a champion has candidates."""
    plan, folder = PLANS.get(task, Plan()), folder / f"{task}-{seed}-random"
    budget = plan.candidates + plan.middle + plan.finish
    evolved("random", folder, f"--task {task} --seed {seed} {RANDOM}", budget, jobs)
    return best(folder, budget, Plan())[1]


def spent() -> float:
    """Returns the CPU time of all that was run, in minutes."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return (used.ru_utime + used.ru_stime) / 60.0


def main() -> None:
    """Prints a line for each seed, and the medians."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tasks", nargs="+")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3, 4, 5])
    parser.add_argument("--random", action="store_true", help="as many random creatures, too")
    parser.add_argument("--jobs", default=str(os.cpu_count()))
    parser.add_argument("-o", "--output", type=Path, default=Path("runs/bars"))
    asked = parser.parse_args()
    asked.output.mkdir(parents=True, exist_ok=True)
    for task in asked.tasks:
        scores, paces = [], []
        for seed in asked.seeds:
            before = spent()
            one, all_of_them, lengths = champion(task, seed, asked.output, asked.jobs)
            scores.append(all_of_them)
            paces.append(lengths)
            line = f"{task} seed {seed}: {one:.4g} on one seed, {all_of_them:.4g} on all, {lengths:.2f} lengths/s"
            line += f", {spent() - before:.1f} min"
            if asked.random:
                before = spent()
                random = luck(task, seed, asked.output, asked.jobs)
                line += f"; random {random:.4g} on one seed, {spent() - before:.1f} min"
            print(line, flush=True)
        median, lengths = statistics.median(scores), statistics.median(paces)
        print(f"{task}: median {median:.4g}, {lengths:.2f} lengths/s, of {len(scores)} seeds", flush=True)


if __name__ == "__main__":
    main()
