"""Shows that the conformance suite can fail: `make conform-selftest` has it judge every broken server of `defects`.

Prints a table, one line a server: whether it was caught, which cases had to catch it, their verdicts, which of the
control cases failed too, and what is wrong with it. Then the same cases judge the server without the defects,
over each engine and mode. The exit status is 1 if a defect survives, or anything is found wrong with the server itself.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor

import broken_creatures
import broken_names
import broken_physics
import broken_roles
import broken_times
import broken_wires
import broken_worlds
from defects import DEFECTS, Defect, Judgement, judge, unbroken

__all__ = ["BROKEN", "main"]

BROKEN: dict[str, Defect] = {defect.name: defect for defect in DEFECTS}
assert {defect.break_it.__module__ for defect in DEFECTS} == {
    module.__name__
    for module in (
        broken_creatures,
        broken_names,
        broken_physics,
        broken_roles,
        broken_times,
        broken_wires,
        broken_worlds,
    )
}


def _judge(name: str) -> Judgement:
    return judge(BROKEN[name])


def _judged() -> Iterator[tuple[Defect, Judgement]]:
    """Judges all broken servers, in processes of their own; most of the time these wait."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(2 * (os.cpu_count() or 1), context) as pool:
        yield from zip(BROKEN.values(), pool.map(_judge, BROKEN), strict=True)


def main() -> int:
    """Prints the table; returns the exit status."""
    bad = caught = 0
    width = max(map(len, BROKEN))
    print(f"{'':8} {'server':{width}} {'must be caught by':34} {'verdict':10} {'also failed':24} what is wrong")
    for defect, judgement in _judged():
        verdicts = ", ".join(dict.fromkeys(str(outcome.verdict) for outcome in judgement.named))
        others = ", ".join(judgement.others) or "-"
        state = "caught" if judgement.caught else "SURVIVES"
        print(f"{state:8} {defect.name:{width}} {', '.join(defect.cases):34} {verdicts:10} {others:24} {defect.does}")
        caught += judgement.caught
    for config, judgement in unbroken(list(BROKEN.values())):
        count = len(judgement.named) + len(judgement.controls)
        state = "clean" if judgement.clean else "NOT CLEAN"
        print(f"{state:9} the server without defects, {config}: {count} cases")
        for number, verdict, mistake in (*judgement.named, *judgement.controls):
            if verdict not in ("ok", "unimplemented"):
                print(f"          {number} {verdict}: {mistake}")
        bad += not judgement.clean
    print(f"{caught} of {len(BROKEN)} broken servers caught")
    return 1 if bad or caught < len(BROKEN) else 0


if __name__ == "__main__":
    sys.exit(main())
