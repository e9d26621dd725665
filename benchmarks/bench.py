"""Runs the benchmarks, prints a table, and writes the figures with their details to a JSON file.

All figures are ratios within this run, or rates that stand beside such ratios: a slow machine is slow to both sides.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from dataclasses import asdict
from importlib.metadata import version
from math import inf
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

import bodies
import brains
import clients
import company
import developing
import engines
import evaluation
import evolution
import filming
import hostile
import hosting
import learning
import learning_remote
import population
import recorded
import roundtrip
import survival
import ticking
import viewing

SUITES = {
    "roundtrip": roundtrip.figures,
    "ticking": ticking.figures,
    "bodies": bodies.figures,
    "brains": brains.figures,
    "clients": clients.figures,
    "company": company.figures,
    "developing": developing.figures,
    "engines": engines.figures,
    "evaluation": evaluation.figures,
    "evolution": evolution.figures,
    "filming": filming.figures,
    "hosting": hosting.figures,
    "learning": learning.figures,
    "hostile": hostile.figures,
    "learning-remote": learning_remote.figures,
    "population": population.figures,
    "survival": survival.figures,
    "recorded": recorded.figures,
    "viewing": viewing.figures,
}


def machine() -> dict[str, Any]:
    """Says where this was measured."""
    cpu = platform.processor()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        cpu = next(line.split(":")[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    versions = {name: version(name) for name in ("nmes", "mujoco", "numpy", "pymunk")}
    return {
        "cpu": cpu,
        "cores": os.cpu_count(),
        "system": platform.platform(),
        "python": platform.python_version(),
    } | versions


def main() -> None:
    """Runs what was asked for. A missed aim is a finding, not a failure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("suite", nargs="*", choices=[*SUITES, []], help="which to run; all when left out")
    parser.add_argument("--output", type=Path, default=Path("build/bench.json"), help="where the JSON goes")
    options = parser.parse_args()
    console = Console()
    here = machine()
    table = Table("figure", "measured", "aim", "", caption=f"{here['cpu']}, {here['cores']} cores")
    for column in (1, 2):
        table.columns[column].justify = "right"
    results = []
    with console.status("measuring") as status:
        for name in options.suite or SUITES:
            status.update(f"measuring: {name}")
            for figure in SUITES[name]():
                value = f"{figure.value:,.0f}" if figure.value >= 1000 else f"{figure.value:.2f}"
                mark = "" if not figure.aim else "[green]ok[/]" if figure.ok else "[red]missed[/]"
                table.add_row(escape(figure.name), escape(f"{value} {figure.unit}"), figure.aim, mark)
                # JSON has no infinity: a bound that is not there is left out.
                row = {key: value for key, value in asdict(figure).items() if value not in (inf, -inf)}
                results.append({"suite": name, **row, "ok": figure.ok})
    console.print(table)
    options.output.parent.mkdir(parents=True, exist_ok=True)
    document = {"machine": here, "time": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()), "figures": results}
    options.output.write_text(json.dumps(document, indent=2) + "\n")
    console.print(f"details: {options.output}")


if __name__ == "__main__":
    main()
