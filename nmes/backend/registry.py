"""Installed physics engines, and how one is found by its name."""

from __future__ import annotations

import difflib
import logging
from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import ClassVar

from nmes.backend.simulation import Simulation
from nmes.backend.specs import SceneSpec
from nmes.errors import BackendNotFound

__all__ = ["ENTRY_POINT_GROUP", "Backend", "entry_points_by_name", "load_backend"]

logger = logging.getLogger(__name__)

ENTRY_POINT_GROUP = "nmes.backends"

# They happen to the program, not to an engine: they pass, also where a C extension has made an ImportError of them.
_PASSING = (KeyboardInterrupt, MemoryError)


class Backend(ABC):
    """An installed physics engine. The entry point in group `nmes.backends` names the class; it takes no arguments.

    Attributes:
        name: What users call it (`mujoco`).
        dims: 3, or 2 for an engine of the XY plane.
        capabilities: Of `CAPABILITIES`, what it can do. The World answers everything else with `unsupported`.
        lacking: Capabilities that the engine has elsewhere and not on this machine, each with why and what to install.
        known_defects: Versions of the engine that are known to compute wrongly, each with what is wrong and what to
            install instead.
        most_joined: How many bodies joints may connect with each other; None where the engine has no limit.
    """

    name: str
    dims: int = 3
    capabilities: frozenset[str] = frozenset()
    lacking: ClassVar[Mapping[str, str]] = {}
    known_defects: ClassVar[Mapping[str, str]] = {}
    most_joined: int | None = None

    @abstractmethod
    def version(self) -> str:
        """Returns the engine's version, such as `3.17.0`."""

    @abstractmethod
    def fingerprint(self) -> dict[str, str]:
        """Returns the facts that make two runs comparable: the engine's version, the SHA-256 of its binary."""

    @property
    def defect(self) -> str | None:
        """What is known to be wrong with this version of the engine, and what to install; None where nothing is."""
        return self.known_defects.get(self.version())

    def refusal(self, capability: str, what: str) -> str:
        """Returns the message for somebody who asks for `what`, which takes a capability that is not there."""
        message = f"the {self.name} backend has no {what}"
        return f"{message} here: {self.lacking[capability]}" if capability in self.lacking else message

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
    """Loads a backend by name; the log tells once of a version that is known to be wrong.

    Raises:
        BackendNotFound: None has that name (with the nearest names), or its engine cannot be imported.
    """
    point = _entry_point(name)
    try:
        backend = point.load()()
    except (Exception, SystemExit) as error:  # whatever a stranger's package does when it is imported
        _pass_on(error)
        why = f"{type(error).__name__}: {error}" if not isinstance(error, ImportError) else str(error)
        package = "its package" if point.dist is None else point.dist.name
        hint = f"; install what it needs with: pip install {package}" if isinstance(error, ImportError) else ""
        raise BackendNotFound(f"backend {name!r} ({point.value}) cannot be loaded: {why}{hint}") from error
    if not isinstance(backend, Backend):
        raise BackendNotFound(f"backend {name!r} ({point.value}) is not an nmes Backend")
    if backend.known_defects and backend.defect is not None:
        _warn(f"{name} {backend.version()} is known to compute wrongly: {backend.defect}")
    return backend


def _pass_on(error: BaseException | None) -> None:
    """Raises the interruption of the program that an error was made of, if there was one."""
    while error is not None:
        if isinstance(error, _PASSING):
            raise error
        error = error.__cause__ or error.__context__


@cache  # worlds are many
def _warn(message: str) -> None:
    logger.warning(message)
