"""Evolution: runs of algorithms that vary genomes, by what `nmes.variation` can do to one.

What varies one is here too, since most who come for a run come for that; `docs/evolution.md` describes the operators.
"""

from nmes.evolution.difference import Difference, differences
from nmes.variation.crossover import cross
from nmes.variation.draw import Draw
from nmes.variation.mutation import KINDS, Mutant, mutate

__all__ = ["KINDS", "Difference", "Draw", "Mutant", "cross", "differences", "mutate"]
