"""Cases: plain functions with a number, a clause of the protocol, and the needs that a server must meet.

It hides how cases are kept: a `Category` registers those of its file, a table of rows becomes one case a row. It knows
nothing of sockets or of how cases are run. Invariants: numbers are unique and never reused for something else, so that
reports of different versions can be compared; a case says what is wrong by raising `Finding`, and nothing else that it
raises is ever the server's fault.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import Enum, StrEnum
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nmes.conformance.trial import Trial

__all__ = ["Case", "Category", "Finding", "Level", "NotTried", "Row", "Scope", "Unimplemented"]


class Level(StrEnum):
    """How binding a clause is.

    A server that breaks a SHOULD is `non-strict`. What a MAY speaks of can be left out, but not claimed and then done
    wrong.
    """

    MUST = "MUST"
    SHOULD = "SHOULD"
    MAY = "MAY"


class Scope(Enum):
    """The part of the server that a case has to itself.

    Cases of CONNECTION use their own connections and cubes only, and run side by side. Those of TIME move the world's
    time on or watch it pass; those of WORLD change what all its clients share (mode, pause, seed); those of HOST count
    all connections. They run one by one.
    """

    CONNECTION = "connection"
    TIME = "time"
    WORLD = "world"
    HOST = "host"


class Finding(AssertionError):
    """A difference between a server and the protocol: the answer expected, and the one received.

    Attributes:
        expected: What should have happened.
        received: What happened instead.
        cause: What many cases may have found at once, in words that do not depend on the case.
    """

    def __init__(self, expected: str, received: str, cause: str | None = None) -> None:
        super().__init__(f"expected {expected}, received {received}")
        self.expected = expected
        self.received = received
        self.cause = expected if cause is None else cause


class Unimplemented(Exception):
    """The server leaves out something optional, and says so."""


class NotTried(Exception):
    """The case would cost too much against this server, or this machine cannot do it."""


@dataclass(frozen=True, slots=True)
class Row:
    """One line of a table of cases.

    Attributes:
        name: What tells it from the others; a part of the case's number.
        value: What the case's function gets.
        needs: Capabilities, besides those of the table.
        clause: Its own clause, where that of the table is not to the point.
    """

    name: str
    value: Any
    needs: tuple[str, ...] = ()
    clause: str | None = None


@dataclass(frozen=True, slots=True)
class Case:
    """One thing to find out about a server.

    Attributes:
        number: `category.case`, or `category.case:row`.
        category: Name of the category.
        title: What a conforming server does, one sentence.
        clause: Address of the sentence of the protocol that says so; see `clauses`.
        level: How binding that is.
        needs: What the server must claim for the case to make sense; see `Probe.lacks`.
        scope: What it has to itself.
        wait: How long it takes because something has to take that long, s.
        run: Plays it; raises Finding, Unimplemented or NotTried.
    """

    number: str
    category: str
    title: str
    clause: str
    level: Level
    needs: tuple[str, ...]
    scope: Scope
    wait: float
    run: Callable[[Trial], None] = field(repr=False, compare=False)


class Category:
    """The cases about one subject, in order; those of a large one come from several files.

    Args:
        number: The first part of the cases' numbers.
        name: The subject.
        parts: Categories of the same number and name, whose cases come before those that are added to this one.
    """

    def __init__(self, number: int, name: str, parts: Iterable[Category] = ()) -> None:
        self.number = number
        self.name = name
        self._cases: dict[str, Case] = {}
        for case in (case for part in parts for case in part):
            self._keep(case)

    def __iter__(self) -> Iterator[Case]:
        return iter(self._cases.values())

    def case(
        self,
        number: int,
        clause: str,
        *,
        level: Level | None = None,
        needs: Sequence[str] = (),
        scope: Scope = Scope.CONNECTION,
        wait: float = 0.0,
    ) -> Callable[[Callable[[Trial], None]], Callable[[Trial], None]]:
        """Registers the function below it; the first line of its docstring is the case's title.

        Without a `level` it is MUST, or MAY where it needs what a server may leave out.
        """

        def register(function: Callable[[Trial], None]) -> Callable[[Trial], None]:
            self._add(str(number), _title(function), clause, level, tuple(needs), scope, wait, function)
            return function

        return register

    def table(
        self,
        number: int,
        clause: str,
        rows: Iterable[Row],
        *,
        level: Level | None = None,
        needs: Sequence[str] = (),
        scope: Scope = Scope.CONNECTION,
        wait: float = 0.0,
    ) -> Callable[[Callable[[Trial, Any], None]], Callable[[Trial, Any], None]]:
        """Registers the function below it once for each row; the function gets the row's value."""

        def register(function: Callable[[Trial, Any], None]) -> Callable[[Trial, Any], None]:
            for row in rows:

                def run(trial: Trial, value: Any = row.value) -> None:
                    function(trial, value)

                self._add(
                    f"{number}:{row.name}",
                    f"{_title(function)} ({row.name})",
                    row.clause or clause,
                    level,
                    (*needs, *row.needs),
                    scope,
                    wait,
                    run,
                )
            return function

        return register

    def _add(
        self,
        number: str,
        title: str,
        clause: str,
        level: Level | None,
        needs: tuple[str, ...],
        scope: Scope,
        wait: float,
        run: Callable[[Trial], None],
    ) -> None:
        level = level or (Level.MAY if needs else Level.MUST)
        self._keep(Case(f"{self.number}.{number}", self.name, title, clause, level, needs, scope, wait, run))

    def _keep(self, case: Case) -> None:
        if case.number in self._cases:
            raise ValueError(f"there are two cases {case.number}")
        self._cases[case.number] = case


def _title(function: Callable[..., None]) -> str:
    assert function.__doc__, f"{function.__name__} has no docstring"
    return function.__doc__.splitlines()[0].rstrip(".")
