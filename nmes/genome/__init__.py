"""Genomes: documents of a creature's body, sensors and brain."""

from __future__ import annotations

from nmes.genome.genome import Genome

__all__ = ["Genome"]
