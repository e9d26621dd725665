"""Variation: how genomes are changed, bred and drawn at random, so that bodies and brains go together.

    child = mutate(Genome.load("walker"), Draw(1)).genome

A genome's body is changed part by part, and its sensors and brain go along by the names of parts. What comes out is a
good genome by construction. Whoever varies says what a body must be like (`Requirements`); this package knows neither
tasks nor worlds, so that both can breed. `docs/evolution.md` describes the operators.
"""

from nmes.variation.crossover import cross
from nmes.variation.draw import Draw
from nmes.variation.mutation import KINDS, Mutant, mutate
from nmes.variation.random_genomes import random_genome
from nmes.variation.requirements import ANY, Requirements

__all__ = ["ANY", "KINDS", "Draw", "Mutant", "Requirements", "cross", "mutate", "random_genome"]
