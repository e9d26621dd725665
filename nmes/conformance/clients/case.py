"""Cases that hold clients to the protocol: functions with a number and the sentence that they hold it to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from nmes.conformance.clauses import sentence
from nmes.conformance.clients.stage import Stage

__all__ = ["ClientCase", "Group"]


@dataclass(frozen=True, slots=True)
class ClientCase:
    """One thing to find out about a client.

    Attributes:
        number: `group.case`.
        group: Name of the group.
        title: What a conforming client does, one sentence.
        clause: Address of the sentence of the protocol that it follows from.
        run: Plays it; raises Finding or NotTried.
    """

    number: str
    group: str
    title: str
    clause: str
    run: Callable[[Stage], None] = field(repr=False, compare=False)


class Group:
    """The cases about one subject, in order."""

    def __init__(self, number: int, name: str) -> None:
        self.number, self.name = number, name
        self.cases: list[ClientCase] = []

    def case(self, clause: str) -> Callable[[Callable[[Stage], None]], Callable[[Stage], None]]:
        """Registers the function below it, under the next number; its docstring's first line is the case's title."""

        def register(function: Callable[[Stage], None]) -> Callable[[Stage], None]:
            sentence(clause)  # there is one
            assert function.__doc__, f"{function.__name__} has no docstring"
            title = function.__doc__.splitlines()[0].rstrip(".")
            number = f"{self.number}.{len(self.cases) + 1}"
            self.cases.append(ClientCase(number, self.name, title, clause, function))
            return function

        return register
