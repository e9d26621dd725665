"""Species: networks that are alike share their fitness, so that a new structure has time to find its numbers.

After K. O. Stanley and R. Miikkulainen, "Evolving Neural Networks through Augmenting Topologies", Evolutionary
Computation 10 (2002). Hides who belongs to which species, which of them have offspring, and how many.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

from nmes.backend.rotation import total
from nmes.evolution.algorithms.neat_networks import Network, distance
from nmes.variation.draw import Draw

__all__ = ["Individual", "Species", "divided", "speciate"]


@dataclass(frozen=True, slots=True, eq=False)
class Individual:
    """A network that was told: its candidate's index and genome's hash, and its score."""

    index: int
    hash: str
    network: Network
    score: float


@dataclass(frozen=True, slots=True, eq=False)
class Species:
    """Networks that are alike.

    Attributes:
        name: The index of the candidate that it was founded by.
        members: They, the best first, of equals the first told.
        best: The best score that it ever had.
        since: The generation in which it had that for the first time.
    """

    name: int
    members: tuple[Individual, ...]
    best: float
    since: int


def speciate(
    individuals: Sequence[Individual],
    species: Sequence[Species],
    generation: int,
    threshold: float,
    weights: float,
    draw: Draw,
) -> list[Species]:
    """Returns the species of a generation: those of the one before that still have members, then new ones.

    Args:
        individuals: All who are told of the generation, and have a score.
        species: The species of the generation before.
        generation: The generation's number.
        threshold: The compatibility distance within which a network belongs to a species.
        weights: How much numbers count in that distance.
        draw: Who represents a species: one of its members in the generation before.
    """
    groups = [(each, draw.one_of(each.members).network, list[Individual]()) for each in species]
    for individual in sorted(individuals, key=lambda each: each.index):
        for _, model, members in groups:
            if distance(individual.network, model, weights) < threshold:
                members.append(individual)
                break
        else:
            founded = Species(individual.index, (), float("-inf"), generation)
            groups.append((founded, individual.network, [individual]))
    return [_renewed(each, members, generation) for each, _, members in groups if members]


def _renewed(species: Species, members: Sequence[Individual], generation: int) -> Species:
    ranked = tuple(sorted(members, key=lambda each: (-each.score, each.index)))
    better = ranked[0].score > species.best
    best, since = (ranked[0].score, generation) if better else (species.best, species.since)
    return Species(species.name, ranked, best, since)


def divided(species: Sequence[Species], count: int, generation: int, patience: int) -> list[tuple[Species, int]]:
    """Divides offspring among species, in proportion to the mean score of their members.

    Args:
        species: All, at least one.
        count: How many offspring there are, at least one.
        generation: The generation's number.
        patience: For how many generations a species may fail to become better, and still have offspring; the one
            with the best of all always has.

    Returns:
        The species that have offspring, and how many.
    """
    leader = max(species, key=lambda each: each.members[0].score)
    heirs = [each for each in species if each is leader or generation - each.since < patience]
    # Shares must not be negative; where all scores are positive they are as they are, as NEAT has it.
    lowest = min(0.0, min(each.members[-1].score for each in heirs))
    means = [total(member.score - lowest for member in each.members) / len(each.members) for each in heirs]
    whole = total(means)
    known = 0.0 < count * whole < inf  # the sum of huge scores is no number
    exact = [count * mean / whole if known else count / len(heirs) for mean in means]
    shares = [int(share) for share in exact]
    order = sorted(range(len(heirs)), key=lambda i: shares[i] - exact[i])  # the largest remainders first
    for i in order[: count - int(total(shares))]:
        shares[i] += 1
    best = heirs.index(leader)
    if not shares[best]:  # of few offspring the part of the best may be less than one: it would be lost
        shares[max(range(len(heirs)), key=shares.__getitem__)] -= 1
        shares[best] = 1
    return [(each, share) for each, share in zip(heirs, shares, strict=True) if share]
