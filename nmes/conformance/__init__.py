"""The conformance suite: proves or refutes that a server speaks the protocol, from outside, over TCP.

`nmes conform HOST:PORT` runs it, `run` does the same in process:

```python
from nmes.conformance import Options, Target, run

report = run(Target("127.0.0.1", 14000, "password"), Options(only=["1.*", "12.3"]))
for result in report.results:
    print(result.case.number, result.verdict, result.expected, result.received)
assert report.exit_status == 0
```

To write a case, add a function to the file of its category in `nmes/conformance/cases`. Its docstring's first line says
what a conforming server does; the decorator gives its number (new in the category, never reused), the address of the
sentence of the protocol that says so (`clauses`), and, where that is not all servers' duty, what the server must claim:

```python
@case(12, "3.6.2", needs=("freeze_cube",))
def a_base_can_be_let_go(t: Trial) -> None:
    \"\"\"A base that is no longer frozen falls.\"\"\"
    wire = t.join()
    base = t.base(wire, position=t.at(y=5))
    t.ask(wire, {"type": "freeze_cube", "cube_name": base, "freeze": False}, "cube_frozen")
    t.equal(t.info(wire, base)["frozen"], False, "frozen")
```

`t` (a `Trial`) connects, makes names that nobody has and points on the case's own plot, waits, and judges; every
message that it returns has been found valid. A case that moves time on or looks at motion has `scope=Scope.TIME`; one
that changes what all clients share has `Scope.WORLD`; all others run side by side. After that,
`python -m nmes.conformance > docs/conformance-cases.md` writes the table of cases anew.

The suite knows the protocol and the schemas, and nothing of any server.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nmes.conformance.case import Case, Category, Finding, Level, Scope
    from nmes.conformance.cases import CASES, CATEGORIES
    from nmes.conformance.runner import (
        NoCase,
        Options,
        Report,
        Result,
        Unreachable,
        Verdict,
        replay,
        run,
        select,
        suite_hash,
    )
    from nmes.conformance.trial import Probe, Target, Trial

__all__ = [
    "CASES",
    "CATEGORIES",
    "Case",
    "Category",
    "Finding",
    "Level",
    "NoCase",
    "Options",
    "Probe",
    "Report",
    "Result",
    "Scope",
    "Target",
    "Trial",
    "Unreachable",
    "Verdict",
    "replay",
    "run",
    "select",
    "suite_hash",
]

_HOMES = {
    "CASES": "nmes.conformance.cases",
    "CATEGORIES": "nmes.conformance.cases",
    "Case": "nmes.conformance.case",
    "Category": "nmes.conformance.case",
    "Finding": "nmes.conformance.case",
    "Level": "nmes.conformance.case",
    "NoCase": "nmes.conformance.runner",
    "Options": "nmes.conformance.runner",
    "Probe": "nmes.conformance.trial",
    "Report": "nmes.conformance.runner",
    "Result": "nmes.conformance.runner",
    "Scope": "nmes.conformance.case",
    "Target": "nmes.conformance.trial",
    "Trial": "nmes.conformance.trial",
    "Unreachable": "nmes.conformance.runner",
    "Verdict": "nmes.conformance.runner",
    "replay": "nmes.conformance.runner",
    "run": "nmes.conformance.runner",
    "select": "nmes.conformance.runner",
    "suite_hash": "nmes.conformance.runner",
}


def __getattr__(name: str) -> Any:
    # Loaded when first used: pytest loads the plugin wherever NMES is installed, and need not wait for the suite.
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, *(name for name in globals() if name.startswith("__"))])
