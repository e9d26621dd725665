"""The common part of the example clients: the connection to the server, and the report of their measurements."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from math import inf
from pathlib import Path

import nmes
from nmes.errors import NmesError


@dataclass(frozen=True)
class Figure:
    """One measured number, and the range that it should be in."""

    name: str
    value: float
    unit: str = ""
    at_least: float = -inf
    at_most: float = inf

    @property
    def ok(self) -> bool:
        """Whether the aim was reached."""
        return self.at_least <= self.value <= self.at_most

    @property
    def aim(self) -> str:
        """The range in words."""
        low = f"at least {self.at_least:g}" if self.at_least > -inf else ""
        high = f"at most {self.at_most:g}" if self.at_most < inf else ""
        return " and ".join(filter(None, (low, high)))

    def __str__(self) -> str:
        verdict = f"{'ok' if self.ok else 'MISSED'} ({self.aim})" if self.aim else ""
        return f"{self.name:<28} {self.value:9.3f} {self.unit:<4} {verdict}".rstrip()


Connect = Callable[[], nmes.Client]
Measure = Callable[[Connect], list[Figure]]


def main(measure: Measure, description: str | None) -> None:
    """Runs an example from the command line: connects, measures, prints, exits 1 if an aim was missed."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=14000)
    parser.add_argument("--password", default=os.environ.get("NMES_PASSWORD"), help="or NMES_PASSWORD")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    options = parser.parse_args()
    if options.password is None:
        parser.error("a password is needed: --password, or NMES_PASSWORD")
    try:
        figures = measure(lambda: nmes.Client(options.host, options.port, password=options.password).connect())
    except NmesError as error:
        sys.exit(f"{error.code}: {error.message}")
    ok = all(figure.ok for figure in figures)
    if options.json:
        # JSON has no infinity: a bound that is not there is left out.
        rows = [{k: v for k, v in asdict(figure).items() if v not in (inf, -inf)} for figure in figures]
        print(json.dumps({"example": Path(sys.argv[0]).stem, "ok": ok, "figures": rows}))
    else:
        print(*figures, sep="\n")
    sys.exit(0 if ok else 1)
