"""The evolutionary algorithms, by name; each is a module of its own, loaded when it is asked for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from importlib import import_module
from typing import Any, Final

from nmes.errors import DocumentError
from nmes.evolution.algorithm import Algorithm, Problem
from nmes.evolution.algorithms.bounds import read_options
from nmes.schemas.documents import did_you_mean

__all__ = ["ALGORITHMS", "algorithm_options", "load_algorithm", "options_class"]

_PLACES: Final[Mapping[str, str]] = {
    "random": "random_search.RandomSearch",
    "ga": "genetic.Genetic",
    "afpo": "genetic.AgeFitness",
    "islands": "islands.Islands",
    "neat": "neat.Neat",
    "es": "evolution_strategy.EvolutionStrategy",
    "cma": "cma_es.CmaEs",
    "nsga2": "nsga2.Nsga2",
    "map-elites": "map_elites.MapElites",
    "cma-me": "cma_me.CmaMe",
}
ALGORITHMS: Final = tuple(_PLACES)
"""The names of the algorithms."""
_OTHER_NAMES: Final = {"cma-es": "cma", "genetic": "ga", "nsga-ii": "nsga2"}
"""What some are called elsewhere; other algorithms have names that are more alike to these."""


def _load(name: str) -> Any:
    """Returns an algorithm's class, which has its options as a dataclass `Options`.

    Raises:
        DocumentError: There is no such algorithm.
        MissingPackage: The algorithm needs a package that is not installed.
    """
    if name not in _PLACES:
        meant = _OTHER_NAMES.get(name.lower(), name)
        hint = did_you_mean(meant, ALGORITHMS) or f": there are {', '.join(ALGORITHMS)}"
        raise DocumentError([("algorithm", f"there is no algorithm {name!r}{hint}")])
    module, attribute = _PLACES[name].split(".")
    return getattr(import_module(f"nmes.evolution.algorithms.{module}"), attribute)


def options_class(name: str) -> type[Any]:
    """Returns the dataclass of an algorithm's options.

    Raises:
        DocumentError: There is no such algorithm.
        MissingPackage: The algorithm needs a package that is not installed.
    """
    options: type[Any] = _load(name).Options
    return options


def algorithm_options(name: str) -> dict[str, int | float | bool]:
    """Returns the options of an algorithm with their defaults.

    Raises:
        DocumentError: There is no such algorithm.
        MissingPackage: The algorithm needs a package that is not installed.
    """
    return asdict(options_class(name)())


def load_algorithm(name: str, problem: Problem, options: Mapping[str, Any] | None = None) -> Algorithm:
    """Returns an algorithm at its beginning.

    Args:
        name: One of `ALGORITHMS`.
        problem: What the run is about.
        options: Those that differ from their defaults.

    Raises:
        DocumentError: There is no such algorithm or option, an option is not what it must be, or the problem is none
            for this algorithm.
        MissingPackage: The algorithm needs a package that is not installed.
    """
    kind = _load(name)
    algorithm: Algorithm = kind(problem, read_options(name, kind.Options, options or {}))
    return algorithm
