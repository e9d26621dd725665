"""Ratings of the creatures of a leaderboard, from the matches that its entries prove.

Invariants:

- They follow from the entries alone, in whichever order those were listed.
- A creature has the name under which it was listed first: whoever lists it again renames nobody's.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from nmes.evaluation.leaderboard_entry import Entry
from nmes.evaluation.ratings import Rating, rate

__all__ = ["Rated", "rated"]


@dataclass(frozen=True, slots=True)
class Rated:
    """What the listed matches on a task say of one creature.

    Attributes:
        task: The task's name.
        task_hash: Its hash.
        name: The genome's name, in the first of its entries.
        creature_hash: SHA-256 of what of it acts, by which it is known.
        rating: Its rating.
        matches: How many matches it has played.
        wins: In how many it was better than all others.
        draws: In how many it shared the first place.
    """

    task: str
    task_hash: str
    name: str
    creature_hash: str
    rating: Rating
    matches: int
    wins: int
    draws: int

    @property
    def losses(self) -> int:
        """In how many it was not first."""
        return self.matches - self.wins - self.draws

    def to_json(self) -> dict[str, Any]:
        """Returns the fields as plain data."""
        names = ("task", "task_hash", "name", "creature_hash", "matches", "wins", "draws", "losses")
        return {**{name: getattr(self, name) for name in names}, "rating": self.rating.to_json()}


def rated(entries: Iterable[Entry]) -> list[Rated]:
    """Rates the creatures that have met, task by task, the best first.

    Args:
        entries: Of any tasks; those for one creature are left out, and those where all had the first place in every
            match, as on a task whose roles have one objective.
    """
    met = sorted(
        (entry for entry in entries if len(entry.players) > 1), key=lambda entry: (entry.task, entry.task_hash)
    )
    found: list[Rated] = []
    for _, group in groupby(met, key=lambda entry: (entry.task, entry.task_hash)):
        of_task = sorted(group, key=lambda entry: entry.creature_hash)
        if any(place for entry in of_task for player in entry.players for place in player.places):
            found += _rated(of_task)
    return found


def _rated(entries: Sequence[Entry]) -> list[Rated]:
    """Rates the creatures of one task."""
    names: dict[str, str] = {}
    for entry in sorted(entries, key=lambda entry: entry.id):
        for player in entry.players:
            names.setdefault(player.creature_hash, player.name)
    creatures = dict.fromkeys(player.creature_hash for entry in entries for player in entry.players)
    numbers = {creature: number for number, creature in enumerate(creatures)}
    matches: list[tuple[list[int], tuple[int, ...]]] = []
    for entry in entries:
        who = [numbers[player.creature_hash] for player in entry.players]
        if len({*who}) == len(who):  # of a creature against itself nothing follows
            matches += [(who, places) for places in zip(*(player.places for player in entry.players), strict=True)]
    ratings = rate(len(names), matches)
    found = []
    for creature, number in numbers.items():
        own = [(places[who.index(number)], places.count(0)) for who, places in matches if number in who]
        wins, draws = own.count((0, 1)), len([1 for place, first in own if place == 0 and first > 1])
        about = entries[0].task, entries[0].task_hash, names[creature], creature
        found.append(Rated(*about, ratings[number], len(own), wins, draws))
    return sorted(found, key=lambda each: (-each.rating.sure, each.name, each.creature_hash))
