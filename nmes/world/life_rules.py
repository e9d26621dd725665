"""The rules of an ecosystem, read from a world's config: what costs energy, who may be born, from whom all come."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from nmes.backend import Array, Backend
from nmes.errors import DocumentError, WorldError
from nmes.genome import Genome
from nmes.genome.limits import Limits
from nmes.genome.sensors import OF_FOOD
from nmes.objective import Objective
from nmes.schemas.documents import JsonObject
from nmes.variation import Requirements
from nmes.world.mind import require_mind

__all__ = ["Price", "founding_genomes", "requirements"]

_OWN: Final[Mapping[str, tuple[str, str]]] = {
    "mass": ("of all its cubes", "kg"),
    "size": ("the longest edge of the box around its body", "m"),
    "cubes": ("how many it has", ""),
    "motors": ("how many it has", ""),
    "sensors": ("how many numbers it senses", ""),
    "power": ("of its motors in this tick: the size of effort times velocity", "W"),
    "age": ("since it came", "s"),
    "energy": ("what it has", "J"),
}
_NAMES: Final[Mapping[str, Mapping[str, tuple[str, str]]]] = {
    "cost": _OWN,
    "catch": {**_OWN, **{f"prey_{name}": (f"of the other: {words}", unit) for name, (words, unit) in _OWN.items()}},
}


class Price:
    """An expression of the config that says how much energy goes where, in W.

    Args:
        rules: `life` of a complete config.
        field: Its name there.

    Raises:
        WorldError: `bad_expression`.
    """

    def __init__(self, rules: JsonObject, field: str) -> None:
        self._expression = Objective(rules[field], f"life/{field}", names=_NAMES[field])

    def watts(self, traits: Mapping[str, Array], count: int) -> Array:
        """Returns the value for each of so many creatures, array (count,), W.

        Args:
            traits: What the expression may name, each an array (count,).
            count: How many.

        Returns:
            What is not finite too, as after a division by zero: clients bring creatures that the rules did not expect.
        """
        columns = {quantity: traits[quantity.name] for quantity in self._expression.needs}
        return self._expression.values(columns, count)


def requirements(rules: JsonObject, backend: Backend) -> Requirements:
    """Returns the requirements of a body that is born into a world; `rules` are `life` of its complete config."""
    return Requirements(Limits(**rules["limits"]), backend.dims == 2, senses=OF_FOOD)


def founding_genomes(rules: JsonObject, needs: Requirements) -> tuple[Genome, ...]:
    """Returns the genomes with which life begins.

    Raises:
        WorldError: `invalid`: one of them is none, has no brain that a world can run, or is beyond the limits.
    """
    return tuple(_founder(document, f"life/genomes/{i}", needs) for i, document in enumerate(rules["genomes"]))


def _founder(document: JsonObject, path: str, needs: Requirements) -> Genome:
    try:
        genome = Genome(document)
        require_mind(genome)
    except (DocumentError, WorldError) as error:
        raise WorldError("invalid", f"{path}: {error.message}", path) from error
    reasons = needs.check(genome.body)
    if reasons:
        raise WorldError("invalid", f"{path}: {reasons[0]}", path)
    return genome
