"""Ratings of creatures that have played each other: a skill and how sure it is, from who came before whom.

The model is Plackett and Luce's, in the form of Weng and Lin (A Bayesian Approximation Method for Online Ranking,
Journal of Machine Learning Research 12, 2011), by the package openskill. The order of the matches matters a little, so
that it must be one that the matches alone determine.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from openskill.models import PlackettLuce

from nmes.evaluation.judge import Result

__all__ = ["Rating", "places", "rate"]


@dataclass(frozen=True, slots=True)
class Rating:
    """What matches say of a creature's skill.

    Attributes:
        skill: The mean of what is believed of it; 25 of one that never played.
        doubt: The standard deviation of that; a third of 25 of one that never played.
    """

    skill: float
    doubt: float

    @property
    def sure(self) -> float:
        """What its skill is beyond doubt: the mean less three standard deviations, by which creatures are ranked."""
        return self.skill - 3.0 * self.doubt

    def to_json(self) -> dict[str, float]:
        """Returns it as plain data."""
        return {"skill": self.skill, "doubt": self.doubt, "sure": self.sure}


def places(results: Mapping[str, Result], margin: float) -> dict[str, int] | None:
    """Returns the place of each role in a match, from 0, the best; None where it is void.

    The highest score is best, and whoever has none is last. Scores that differ from the best of a place by no more than
    the margin share it.
    """
    scores = {role: result.score for role, result in results.items() if result.score is not None}
    if not scores:
        return None
    found: dict[str, int] = {}
    place, best = -1, 0.0
    for role, score in sorted(scores.items(), key=lambda each: -each[1]):
        if place < 0 or best - score > margin:
            place, best = place + 1, score
        found[role] = place
    return {role: found.get(role, place + 1) for role in results}


def rate(count: int, matches: Iterable[tuple[Sequence[int], Sequence[int]]]) -> list[Rating]:
    """Returns the ratings of so many creatures.

    Args:
        count: How many.
        matches: In order, who played, by number, and the place of each, from 0, the best.
    """
    model = PlackettLuce()
    ratings = [model.rating() for _ in range(count)]
    for players, ranks in matches:
        rated = model.rate([[ratings[player]] for player in players], ranks=[float(rank) for rank in ranks])
        for player, (rating,) in zip(players, rated, strict=True):
            ratings[player] = rating
    return [Rating(rating.mu, rating.sigma) for rating in ratings]
