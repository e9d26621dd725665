"""What a run of evolution costs beside its evaluations: its algorithm, its log, its index, and reading it again."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from measure import Figure
from nmes.evaluation import Evaluation, Result
from nmes.evaluation.parallel import Here
from nmes.evolution.algorithm import Candidate
from nmes.evolution.run import Run
from nmes.evolution.run_entry import told
from nmes.evolution.run_index import RunIndex, State
from nmes.evolution.run_log import RunLog, RunWriter
from nmes.evolution.run_settings import RunSettings
from nmes.genome import Genome

GENERATION = 1000
GENERATIONS = 10
SHOWN = 3  # times
SETTINGS = {"format": "nmes-run/1", "task": "walk", "algorithm": "ga", "budget": GENERATION * GENERATIONS}
SHORT = {**SETTINGS, "budget": 300, "options": {"founders": 50, "population": 50}}
"""A run most of whose candidates are bred."""


class Timed(Here):
    """This process, whose CPU time is counted."""

    def __init__(self) -> None:
        """Begins at no time at all."""
        super().__init__()
        self.seconds = 0.0

    def take(self) -> list[tuple[int, Any]]:
        """Evaluates, and counts the time."""
        began = time.process_time()
        try:
            return super().take()
        finally:
            self.seconds += time.process_time() - began


def figures() -> Iterator[Figure]:
    """Measures writing, reading, showing and the share of bookkeeping, in CPU time of one process."""
    with tempfile.TemporaryDirectory() as folder:
        yield from _files(Path(folder))
        yield _share(Path(folder, "run"))


def _files(folder: Path) -> Iterator[Figure]:
    """Writes generations of the shipped walker, as if each had been evaluated, and reads them again."""
    settings, genome = RunSettings.read(SETTINGS), Genome.load("walker")
    Run.create(folder / "written", settings)
    results = tuple(Result(seed, 1.0 / (seed + 2), 2.0 / 3.0, 4.0 / 3.0, 600) for seed in settings.seeds)
    task = settings.task
    evaluation = Evaluation(genome.name, genome.hash, task.name, task.hash, results)
    writer = RunWriter(RunLog(folder / "written" / "log.jsonl", settings.hash))
    index = RunIndex(folder / "written" / "index.sqlite").write(anew=True)
    seconds, wall = [], []
    for generation in range(GENERATIONS):
        candidate = Candidate(genome, "weights", (0, 1) if generation else (), generation)
        numbers = range(generation * GENERATION, (generation + 1) * GENERATION)
        cpu, clock = time.process_time(), time.perf_counter()
        entries = [told(number, candidate, evaluation, settings, ()) for number in numbers]
        lines = writer.append([entry.content for entry in entries])
        records = [entry.record(line) for entry, line in zip(entries, lines, strict=True)]
        index.put(records, State(numbers.stop, tuple(range(100)), {}))
        seconds.append(time.process_time() - cpu)
        wall.append(time.perf_counter() - clock)
    writer.close()
    index.close()
    details = {"wall ms": min(wall) * 1e3}
    name = f"{GENERATION:,} candidates into log and index"
    yield Figure(name, min(seconds) * 1e3, "ms", at_most=100.0, details=details)
    for what in ("with", "without"):
        began = time.process_time()
        log = RunLog(folder / "written" / "log.jsonl", settings.hash)
        read = RunIndex(folder / "written" / "index.sqlite").read()[0] if what == "with" else list(log.lines())
        assert len(read) == GENERATION * GENERATIONS
        took = time.process_time() - began
        yield Figure(f"{len(read):,} candidates read {what} the index", took * 1e3, "ms")
    yield _shown(folder / "written")


def _shown(folder: Path) -> Figure:
    """Shows a run as somebody does who types the command."""
    command = [str(Path(sys.executable).parent / "nmes"), "evolve", "show", str(folder)]
    wall, cpu = [], []
    for _ in range(SHOWN):
        began, before = time.perf_counter(), os.times()
        shown = subprocess.run(command, capture_output=True, text=True, check=True)
        after = os.times()
        wall.append(time.perf_counter() - began)
        cpu.append(after.children_user + after.children_system - before.children_user - before.children_system)
        assert f"{GENERATION * GENERATIONS:,}" in shown.stdout
    name = f"show of {GENERATION * GENERATIONS:,} candidates"
    return Figure(name, min(cpu), "s", at_most=2.0, details={"wall s": min(wall)})


def _share(folder: Path) -> Figure:
    """Runs the genetic algorithm from random creatures on `walk`."""
    run, pool = Run.create(folder, RunSettings.read(SHORT)), Timed()
    began = time.process_time()
    for _ in run.advance(pool):
        pass
    whole = time.process_time() - began
    bred = sum(record.operator != "random" for record in run.records)
    details = {"candidates": len(run), "bred": bred, "s a candidate": whole / len(run)}
    share = 100.0 * (1.0 - pool.seconds / whole)
    return Figure("bookkeeping of a run, of its CPU time", share, "%", at_most=5.0, details=details)
