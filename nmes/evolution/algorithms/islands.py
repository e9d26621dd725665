"""Populations on islands that race: `islands`, of which the better half goes on whenever all have had their share.

What a population comes to is often settled by its first few hundred candidates: then one or two founders have all the
offspring, and no budget makes up for poor ones. So several populations begin, and most of the budget goes to the best.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import fsum

from nmes.evolution.algorithm import Algorithm, Candidate, Problem, Score
from nmes.evolution.algorithms.bounds import within_bounds
from nmes.evolution.algorithms.genetic import AgeFitness

__all__ = ["Islands"]


@dataclass(frozen=True, slots=True)
class _Rung:
    """A stretch of a run in which the same number of islands take turns.

    Attributes:
        first: The index of its first candidate in the run.
        number: The number of that candidate on its island.
        islands: How many there are.
        end: The index of the first candidate of the next rung; None for the last rung, which has no end.
    """

    first: int
    number: int
    islands: int
    end: int | None


class Islands(Algorithm):
    """Populations of `afpo` that know nothing of each other, and are halved until one is left.

    The halving is that of Z. Karnin et al., "Almost Optimal Exploration in Multi-Armed Bandits" (2013), with the best
    score of an island for what an arm is worth: after `rung` candidates of each, the better half of the islands goes
    on, rounded up, of equals the first.

    Args:
        problem: What the run is about.
        options: See `Options`.

    Raises:
        DocumentError: There are objectives or measures.
    """

    @dataclass(frozen=True)
    class Options(AgeFitness.Options):
        """Those of `afpo`, which each island has, and two more.

        Attributes:
            islands: How many populations there are at the beginning.
            rung: How many candidates each of them has before the better half of the islands goes on.
        """

        islands: int = 8
        rung: int = 500

        def __post_init__(self) -> None:
            super().__post_init__()
            within_bounds(self, {"islands": (1, 1_000), "rung": (1, 100_000)})

    def __init__(self, problem: Problem, options: Options) -> None:
        self._islands = [AgeFitness(replace(problem, island=place), options) for place in range(options.islands)]
        self._rungs = list(_rungs(options.islands, options.rung))
        self._going = [list(range(options.islands))]  # of each rung that has begun, the islands in it
        self._scores: list[float | None] = []
        self._best: list[float | None] = [None] * options.islands

    def _rung(self, index: int) -> tuple[int, _Rung]:
        """Returns the rung in which a candidate is, and its place among the rungs."""
        return next((place, rung) for place, rung in enumerate(self._rungs) if rung.end is None or index < rung.end)

    def _local(self, index: int) -> tuple[int, int]:
        """Returns a candidate's island, and its number there."""
        place, rung = self._rung(index)
        turn, seat = divmod(index - rung.first, rung.islands)
        return self._going[place][seat], rung.number + turn

    def _index(self, island: int, number: int) -> int:
        """Returns the index in the run of a candidate of an island."""
        place = next(
            place
            for place, (_, after) in enumerate(zip(self._rungs, [*self._rungs[1:], None], strict=True))
            if after is None or number < after.number
        )
        rung = self._rungs[place]
        return rung.first + (number - rung.number) * rung.islands + self._going[place].index(island)

    def needs(self, index: int) -> int:
        """Returns how many candidates must be told before: the rungs before, and what the island needs of its own."""
        _, rung = self._rung(index)
        number = rung.number + (index - rung.first) // rung.islands
        return rung.first + max(0, self._islands[0].needs(number) - rung.number) * rung.islands

    def ask(self, index: int) -> Candidate:
        """Returns the candidate of this index; see `Algorithm`."""
        island, number = self._local(index)
        candidate = self._islands[island].ask(number)
        parents = tuple(self._index(island, parent) for parent in candidate.parents)
        return replace(candidate, parents=parents, group=f"island {island + 1}")

    def tell(self, index: int, candidate: Candidate, score: Score) -> None:
        """Takes a candidate's score in; see `Algorithm`. The last one of a rung ends islands."""
        island, number = self._local(index)
        parents = tuple(self._local(parent)[1] for parent in candidate.parents)
        self._islands[island].tell(number, replace(candidate, parents=parents), score)
        self._scores.append(score.score)
        if score.score is not None:
            best = self._best[island]
            self._best[island] = score.score if best is None else max(best, score.score)
        place, rung = self._rung(index)
        if index + 1 == rung.end:
            ranked = sorted(self._going[place], key=self._rank)
            self._going.append(sorted(ranked[: self._rungs[place + 1].islands]))

    def _rank(self, island: int) -> tuple[bool, float, int]:
        """Returns the key by which islands are sorted, the best first; one without a score is the last."""
        best = self._best[island]
        return best is None, -(best or 0.0), island

    def elites(self) -> Sequence[int]:
        """Returns the populations of the islands that go on, the best first."""
        indices = [
            self._index(island, number) for island in self._going[-1] for number in self._islands[island].elites()
        ]
        return sorted(indices, key=lambda index: (-(self._scores[index] or 0.0), index))

    def figures(self) -> Mapping[str, float]:
        """Returns how many islands go on, and how many bodies there are on them."""
        going = self._going[-1]
        return {"islands": len(going), "bodies": fsum(self._islands[island].figures()["bodies"] for island in going)}


def _rungs(islands: int, length: int) -> Iterator[_Rung]:
    """Yields the rungs of a race."""
    first = number = 0
    while islands > 1:
        yield _Rung(first, number, islands, first + islands * length)
        first, number, islands = first + islands * length, number + length, (islands + 1) // 2
    yield _Rung(first, number, 1, None)
