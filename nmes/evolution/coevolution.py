"""Co-evolution: populations bred side by side, of which each is what the others are measured by, in matches.

After C. D. Rosin and R. K. Belew, "New Methods for Competitive Coevolution" (1997): a candidate meets some of the best
who were told of late, and some of a hall of fame, so that what beat those of long ago is not forgotten. Candidates of
the populations take turns: candidate `i` is number `i // P` of population `i % P`, and each population has an algorithm
of its own that knows of nothing else. Whom candidates meet changes from era to era, so that those of one era can be
compared. Invariant: whom the candidates of an era meet follows from the candidates that are told when its first may be
asked for, and from the seed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

from nmes.errors import DocumentError
from nmes.evaluation import MatchTask
from nmes.evolution.algorithm import Algorithm, Candidate, Opponent, Problem, Score
from nmes.evolution.algorithms import ALGORITHMS, algorithm_options, load_algorithm
from nmes.evolution.algorithms.bounds import read_options, within_bounds
from nmes.schemas.documents import did_you_mean

__all__ = [
    "Coevolution",
    "CoevolutionOptions",
    "coevolution_options",
    "complete_options",
    "default_roles",
    "role_problems",
]

_BREEDERS: Final = ("random", "ga", "es", "cma")
"""The algorithms that hold on to no score for long: one of another era is of other opponents."""


@dataclass(frozen=True)
class CoevolutionOptions:
    """What co-evolution is told, beside the options of its algorithm.

    Attributes:
        era: How many candidates of each population meet the same opponents.
        latest: How many of these are the best of the era's length of candidates that were told last.
        famous: How many are drawn from the champions of all eras before.
    """

    era: int = 50
    latest: int = 2
    famous: int = 2

    def __post_init__(self) -> None:
        within_bounds(self, {"era": (1, 100_000), "latest": (1, 100), "famous": (0, 100)})


def coevolution_options(algorithm: str) -> dict[str, int | float | bool]:
    """Returns the options of co-evolution by an algorithm, with their defaults: its own, and the algorithm's.

    `ga` has no elites by default: who was best among others' ancestors would be a parent for good.

    Raises:
        DocumentError: It cannot be co-evolved with, or there is no such algorithm.
        MissingPackage: The algorithm needs a package that is not installed.
    """
    if algorithm in ALGORITHMS and algorithm not in _BREEDERS:
        why = "holds on to scores of long ago, which are of other opponents"
        raise DocumentError([("algorithm", f"{algorithm!r} {why}: populations take {', '.join(_BREEDERS)}")])
    options = algorithm_options(algorithm)
    return {**options, **({"elites": 0} if "elites" in options else {}), **asdict(CoevolutionOptions())}


def complete_options(given: Mapping[str, int | float | bool]) -> dict[str, int | float | bool]:
    """Returns options of co-evolution and of its algorithm with those of `CoevolutionOptions` that are missing.

    Raises:
        DocumentError: One of these is not what it must be.
    """
    own = {name: given.get(name, default) for name, default in asdict(CoevolutionOptions()).items()}
    read_options("co-evolution", CoevolutionOptions, own)
    return {**given, **own}


def default_roles(task: MatchTask) -> tuple[str, ...]:
    """Returns the roles that have a population where nobody says which: all, or one for all that are alike."""
    roles = tuple(task.roles)
    return roles[:1] if task.interchangeable else roles


def role_problems(task: MatchTask, roles: Sequence[str]) -> list[tuple[int, str]]:
    """Returns the problems of some roles as those that have populations, each with its place among them."""
    if len(task.roles) == 1:
        return [(0, f"{task.name} has one role: there is nobody to meet")]
    problems = []
    for place, role in enumerate(roles):
        if role not in task.roles:
            hint = did_you_mean(role, task.roles) or f": there are {', '.join(task.roles)}"
            problems.append((place, f"{task.name} has no role {role!r}{hint}"))
        elif role in roles[:place]:
            problems.append((place, f"there is a population {role!r} already"))
    missing = [role for role in task.roles if role not in roles]
    if not problems and missing and not (task.interchangeable and len(roles) == 1):
        alone = ", or one role has one that plays all of them" if task.interchangeable else ""
        problems.append((0, f"each role of {task.name} has a population{alone}: {', '.join(missing)} has none"))
    return problems


@dataclass(frozen=True, slots=True)
class _Member:
    """A candidate that was told; greater is better."""

    opponent: Opponent
    score: float | None


class _Population:
    """One population: its algorithm, and who of it others may meet.

    Args:
        problem: What it is about.
        algorithm: The algorithm, at its beginning.
        options: The co-evolution's.

    Attributes:
        role: Its name.
        algorithm: The algorithm.
        champions: The best of each era that is over, those without a score left out.
    """

    def __init__(self, problem: Problem, algorithm: Algorithm, options: CoevolutionOptions) -> None:
        self.role, self.algorithm, self._problem, self._options = problem.role, algorithm, problem, options
        self.champions: list[Opponent] = []
        self._recent: deque[_Member] = deque(maxlen=options.era)
        self.told = 0

    def tell(self, candidate: Candidate, score: Score, opponent: Opponent) -> None:
        """Takes in a candidate; its parents are numbers of this population."""
        self.algorithm.tell(self.told, candidate, score)
        self._recent.append(_Member(opponent, score.score))
        self.told += 1
        if self.told % self._options.era == 0:
            self.champions += self.best()[:1]

    def best(self) -> list[Opponent]:
        """Returns the candidates told last that have a score, the best first; of equals, the first that was told."""
        scored = [(-member.score, member.opponent.index) for member in self._recent if member.score is not None]
        by_index = {member.opponent.index: member.opponent for member in self._recent}
        return [by_index[index] for _, index in sorted(scored)]

    def panel(self, era: int) -> tuple[Opponent, ...]:
        """Returns the opponents of others in an era; none where nobody has a score."""
        best, most = self.best(), self._options.latest + self._options.famous
        chosen = {opponent.index: opponent for opponent in best[: self._options.latest]}
        others = [champion for champion in self.champions if champion.index not in chosen]
        drawn = self._problem.draw("famous", era).order(len(others))[: self._options.famous].tolist()
        chosen |= {others[place].index: others[place] for place in drawn}
        for opponent in best:  # while the hall of fame is small
            if len(chosen) < most:
                chosen.setdefault(opponent.index, opponent)
        return tuple(chosen.values())


class Coevolution(Algorithm):
    """Populations that are measured by each other; see the module.

    Args:
        problems: What each population is about: one task with roles, and a role each.
        name: The algorithm that breeds each of them.
        options: Those that differ from their defaults, of the algorithm and of `CoevolutionOptions`.

    Raises:
        DocumentError: The algorithm is none for this, or an option is not what it must be.
        MissingPackage: The algorithm needs a package that is not installed.
    """

    def __init__(self, problems: Sequence[Problem], name: str, options: Mapping[str, Any]) -> None:
        known = coevolution_options(name)
        unknown = [option for option in options if option not in known]
        if unknown:
            hint = did_you_mean(unknown[0], known) or f": there are {', '.join(known)}"
            raise DocumentError([(f"options.{unknown[0]}", f"{name!r} has no such option in co-evolution{hint}")])
        mine = asdict(CoevolutionOptions())
        given = {**known, **options}
        self._options: CoevolutionOptions = read_options(
            "co-evolution", CoevolutionOptions, {option: given[option] for option in mine}
        )
        theirs = {option: value for option, value in given.items() if option not in mine}
        self._populations = [
            _Population(each, _load(name, each, place, theirs), self._options) for place, each in enumerate(problems)
        ]
        task = problems[0].task
        assert isinstance(task, MatchTask)
        self._roles = tuple(task.roles)
        self._told = 0
        self._panels: list[list[tuple[Opponent, ...]]] = []  # of each era, of each population

    def needs(self, index: int) -> int:
        """Returns how many candidates must be told before: what each algorithm needs, and all but the last era."""
        number, count = index // len(self._populations), len(self._populations)
        before = max(0, number // self._options.era - 1) * self._options.era
        return count * max(before, *(each.algorithm.needs(number) for each in self._populations))

    def ask(self, index: int) -> Candidate:
        """Returns the candidate of this index; see `Algorithm`."""
        self._open_eras()
        count = len(self._populations)
        number, place = divmod(index, count)
        candidate = self._populations[place].algorithm.ask(number)
        return replace(
            candidate,
            parents=tuple(parent * count + place for parent in candidate.parents),
            group=self._populations[place].role,
            lineups=self._lineups(place, number // self._options.era),
        )

    def tell(self, index: int, candidate: Candidate, score: Score) -> None:
        """Takes a candidate's score in; see `Algorithm`."""
        self._open_eras()
        count = len(self._populations)
        local = replace(candidate, parents=tuple(parent // count for parent in candidate.parents))
        self._populations[index % count].tell(local, score, Opponent(index, candidate.genome))
        self._told += 1
        self._open_eras()

    def _open_eras(self) -> None:
        """Says whom the candidates of an era meet as soon as its first may be asked for, and never again."""
        length = self._options.era * len(self._populations)
        while self._told >= self.needs(len(self._panels) * length):
            era = len(self._panels)
            panels = [each.panel(era) for each in self._populations]
            self._panels.append([panel or self._substitutes(place) for place, panel in enumerate(panels)])

    def _substitutes(self, place: int) -> tuple[Opponent, ...]:
        """Returns opponents where nobody of a population has a score: those of the era before, or founders.

        Founders may be asked for at any time before anybody is told; then they are the opponents of the first era.
        """
        if self._panels:
            return self._panels[-1][place]
        algorithm, count = self._populations[place].algorithm, len(self._populations)
        numbers = [n for n in range(self._options.latest + self._options.famous) if algorithm.needs(n) == 0]
        return tuple(Opponent(number * count + place, algorithm.ask(number).genome) for number in numbers)

    def _lineups(self, place: int, era: int) -> tuple[tuple[Opponent, ...], ...]:
        """Returns the opponents of a population's candidates in an era: in each match one for each other role."""
        names = [each.role for each in self._populations]
        others = [role for role in self._roles if role != names[place]]
        panels = [self._panels[era][names.index(role) if role in names else 0] for role in others]
        return tuple(
            tuple(panel[(number + seat) % len(panel)] for seat, panel in enumerate(panels))
            for number in range(max(map(len, panels)))
        )

    def elites(self) -> Sequence[int]:
        """Returns the champions of all eras, of the last first, and in each of the first population first.

        Before an era is over, they are the best so far.
        """
        halls = [each.champions or each.best()[:1] for each in self._populations]
        rows = [hall[::-1] for hall in halls]
        return [hall[place].index for place in range(max(map(len, rows))) for hall in rows if place < len(hall)]

    def probe(self) -> str:
        """Returns that of the algorithm; see `Algorithm`."""
        return self._populations[0].algorithm.probe()

    def figures(self) -> Mapping[str, float]:
        """Returns how many eras are over."""
        return {"eras": self._told // len(self._populations) // self._options.era}


def _load(name: str, problem: Problem, place: int, options: Mapping[str, Any]) -> Algorithm:
    """Returns the algorithm of a population, whose starts are blamed in their place."""
    try:
        return load_algorithm(name, problem, options)
    except DocumentError as error:
        raise DocumentError(
            (f"populations/{place}/{path}" if path.startswith("starts") else path, words)
            for path, words in error.problems
        ) from error
