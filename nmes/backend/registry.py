"""Installed physics engines, and how one is found by its name."""

from __future__ import annotations

import difflib
from abc import ABC, abstractmethod
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from nmes.backend.simulation import Simulation
from nmes.backend.specs import SceneSpec
from nmes.errors import BackendNotFound

__all__ = ["ENTRY_POINT_GROUP", "Backend", "entry_points_by_name", "load_backend"]

ENTRY_POINT_GROUP = "nmes.backends"


class Backend(ABC):
    """An installed physics engine. The entry point in group `nmes.backends` names the class; it takes no arguments.

    Attributes:
        name: What users call it (`mujoco`).
        dims: 3, or 2 for an engine of the XY plane.
        capabilities: Of `CAPABILITIES`, what it can do. The World answers everything else with `unsupported`.
    """

    name: str
    dims: int = 3
    capabilities: frozenset[str] = frozenset()

    @abstractmethod
    def version(self) -> str:
        """Returns the engine's version, such as `4.0.0`."""

    @abstractmethod
    def fingerprint(self) -> dict[str, str]:
        """Returns the facts that make two runs comparable: the engine's version, the SHA-256 of its binary."""

    @abstractmethod
    def create(self, scene: SceneSpec) -> Simulation:
        """Creates an empty scene."""


def entry_points_by_name() -> dict[str, EntryPoint]:
    """Returns the installed backends' entry points, sorted by name; none of them is loaded."""
    return {point.name: point for point in sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda point: point.name)}


@cache  # looking through all that is installed takes as long as compiling a model
def _entry_point(name: str) -> EntryPoint:
    points = entry_points_by_name()
    point = points.get(name)
    if point is None:
        near = difflib.get_close_matches(name, points, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise BackendNotFound(f"no backend is called {name!r}{hint} (installed: {', '.join(points) or 'none'})")
    return point


def load_backend(name: str) -> Backend:
    """Loads a backend by name.

    Raises:
        BackendNotFound: None has that name (with the nearest names), or its engine cannot be imported.
    """
    point = _entry_point(name)
    try:
        backend = point.load()()
    except (Exception, SystemExit) as error:  # whatever a stranger's package does when it is imported
        why = f"{type(error).__name__}: {error}" if not isinstance(error, ImportError) else str(error)
        package = "its package" if point.dist is None else point.dist.name
        hint = f"; install what it needs with: pip install {package}" if isinstance(error, ImportError) else ""
        raise BackendNotFound(f"backend {name!r} ({point.value}) cannot be loaded: {why}{hint}") from error
    if not isinstance(backend, Backend):
        raise BackendNotFound(f"backend {name!r} ({point.value}) is not an nmes Backend")
    return backend
