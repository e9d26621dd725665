"""The space of all brains that differ from one by their parameters, in which numerical optimisers move."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nmes.backend import Array
from nmes.errors import DocumentError
from nmes.genome import Genome

__all__ = ["BrainSpace"]


class BrainSpace:
    """Genomes that are one genome with other parameters of its brain.

    The origin is the genome itself, and 1 along an axis is 1 of a parameter, in its own unit (rad, Hz, ...). A point
    that leaves the bounds of a parameter has the genome of the bound.

    Args:
        start: The genome, with a brain that has parameters.
    """

    def __init__(self, start: Genome) -> None:
        self._brain, self._origin = start.brain(), start.brain().to_vector()
        kept = {name: value for name, value in start.document.items() if name not in ("author", "description")}
        self._document = {**kept, "parents": [start.hash]}

    @property
    def dimension(self) -> int:
        """The number of parameters."""
        return self._origin.size

    def genome(self, point: Sequence[float] | Array) -> Genome:
        """Returns the genome at a point, shape (dimension,)."""
        brain = self._brain.with_vector(self._origin + np.asarray(point, np.float64))
        return Genome({**self._document, "brain": brain.document})

    def point(self, genome: Genome) -> list[float]:
        """Returns where a genome of the space is, the other way around.

        Raises:
            DocumentError: It has no brain, or one with another number of parameters.
        """
        vector = genome.brain().to_vector()
        if vector.shape != self._origin.shape:
            raise DocumentError([("brain", f"must have {self.dimension:,} parameters, not {vector.size:,}")])
        point: list[float] = (vector - self._origin).tolist()
        return point
