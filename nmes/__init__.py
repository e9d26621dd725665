"""NMES, the Neural Morphogenetic Evolution System: deterministic worlds driven over TCP, recorded and reproduced.

```python
import nmes

evaluation = nmes.evaluate("walker", "walk", record=".")  # names, paths, documents or objects
recording = nmes.Recording(evaluation.recordings[0])
print(evaluation.score, nmes.replay(recording).verdict)
nmes.film([recording], "walker.mp4")
```

- Worlds: `World` is one in this process; `Client` and `AsyncClient` drive those of a server (`nmes serve`);
  `load_backend` gives the engine of a name.
- Creatures: `Genome` is one, as data; `Task` what it is asked to do; `evaluate` runs one on a task, and an
  `Evaluator` many on all cores; `Evaluation` is what comes out, and `Episode` one run of it.
- Recordings: a `Recorder` writes a world's history down; `Recording` reads it; `replay` runs it again and compares;
  `film` makes a film or a picture of it, of the part that a `Cut` says.

What is more special has a package of its own, such as `nmes.evolution`, `nmes.learning`, `nmes.playback`; all errors
are in `nmes.errors`, and are `NmesError`. The pages are in docs/, that of Python is docs/reference-python.md.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nmes.backend import load_backend
    from nmes.client import AsyncClient, Client
    from nmes.evaluation import Episode, Evaluation, Evaluator, Task, evaluate
    from nmes.genome import Genome
    from nmes.playback import replay
    from nmes.recording import Recorder, Recording
    from nmes.view.film import Cut, film
    from nmes.world import World

    __version__: str

__all__ = [
    "AsyncClient",
    "Client",
    "Cut",
    "Episode",
    "Evaluation",
    "Evaluator",
    "Genome",
    "Recorder",
    "Recording",
    "Task",
    "World",
    "evaluate",
    "film",
    "load_backend",
    "replay",
]

_HOMES = {
    "AsyncClient": "nmes.client",
    "Client": "nmes.client",
    "Cut": "nmes.view.film",
    "Episode": "nmes.evaluation",
    "Evaluation": "nmes.evaluation",
    "Evaluator": "nmes.evaluation",
    "Genome": "nmes.genome",
    "Recorder": "nmes.recording",
    "Recording": "nmes.recording",
    "Task": "nmes.evaluation",
    "World": "nmes.world",
    "evaluate": "nmes.evaluation",
    "film": "nmes.view.film",
    "load_backend": "nmes.backend",
    "replay": "nmes.playback",
}


def __getattr__(name: str) -> Any:
    # Loaded when first used, so that `import nmes`, and with it `nmes --help`, costs nothing.
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    if name == "__version__":
        return importlib.import_module("importlib.metadata").version("nmes")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__", *(name for name in globals() if name.startswith("__"))])
