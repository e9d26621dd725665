"""Evolution: how genomes are varied, so that bodies and brains change together.

    child = mutate(Genome.load("walker"), Draw(seed=1)).genome

A genome's body is changed part by part, and its sensors and brain go along by the names of parts. What comes out is a
good genome by construction. `docs/evolution.md` describes the operators.
"""

from nmes.evolution.crossover import cross
from nmes.evolution.difference import Difference, differences
from nmes.evolution.draw import Draw
from nmes.evolution.mutation import KINDS, Mutant, mutate

__all__ = ["KINDS", "Difference", "Draw", "Mutant", "cross", "differences", "mutate"]
