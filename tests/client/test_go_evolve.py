"""Evolving in Go: the example runs 100 worlds of a real host, and its digest follows from its seed alone."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from go_programs import GO, go
from nmes.genome import Genome
from processes import process, ready
from servers import PASSWORD

pytestmark = pytest.mark.skipif(GO is None, reason="Go is not installed: the Go client was not built and not run")

_SMALL = ("-population", "100", "-generations", "2", "-ticks", "30", "-seed", "7")


def test_a_hundred_worlds_score_alike_with_1_10_and_100_goroutines(tmp_path: Path) -> None:
    founder, best = tmp_path / "walker.json", tmp_path / "best.json"
    founder.write_text(json.dumps(Genome.load("walker").document))
    options = ("--worlds", "100", "--port-step", "0", "--no-record", "--password", PASSWORD)
    printed = []
    with process("serve", "--json", "--port", "0", *options) as server:
        address = f"127.0.0.1:{ready(server)['port']}"
        for goroutines in (100, 10, 1):
            given = ("-addr", address, "-goroutines", str(goroutines), "-o", str(best), *_SMALL, str(founder))
            ran = go("run", "./examples/evolve", *given, environment={"NMES_PASSWORD": PASSWORD})
            assert ran.returncode == 0, ran.stderr
            printed.append(ran.stdout.splitlines())
    assert printed[0] == printed[1] == printed[2]
    first, second, digest = printed[0]
    assert first.startswith("generation 0: ") and second.startswith("generation 1: ") and len(digest.split()[1]) == 64
    winner = Genome.parse(best.read_bytes())
    assert second.endswith(winner.hash[:16])
    worths = [float(line.split(" is worth ")[1].split(",")[0]) for line in (first, second)]
    assert 0.0 < worths[0] <= worths[1]
