"""The errors that NMES raises, the codes they carry, and how a stranger's text is shown in them.

Every error has a stable `code` (the string that goes over the wire where the error reaches a client; docs/errors.md
lists all of them), a message for a person, and, where one value is to blame, a `path`: the JSON Pointer of that value
without its leading slash (`mass`, `position/1`). This module imports nothing of ours, so that every other may import
it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import islice
from typing import Any, Final

__all__ = [
    "MACHINE_ERRORS",
    "BackendNotFound",
    "CommandFailed",
    "CorpusError",
    "Disconnected",
    "DocumentError",
    "FilmError",
    "LeaderboardError",
    "MachineError",
    "MissingPackage",
    "NmesError",
    "NotDeterministic",
    "ProofError",
    "RecordingError",
    "RejectedMessage",
    "RunError",
    "SigningError",
    "SimulationFault",
    "StudyError",
    "VariationError",
    "WorldError",
    "visible",
]


MACHINE_ERRORS: Final = (MemoryError, OSError)
"""What is raised where a machine lacks something: memory, room on a disk, files that may be open. It says nothing of
what was being computed, which comes out otherwise a moment later or on another machine."""


def visible(text: str, *, keep: str = "") -> str:
    r"""Returns a text with every character that does not print written as Python's escape, such as `\n` or `\x1b`.

    Names come from documents, recordings and servers of strangers. A line feed in one would forge a row of a table, an
    escape would command the terminal, and an override of the direction of writing would show other letters than there
    are. What does not print are controls, formats, separators but the space, surrogates, and what Unicode leaves free.

    Args:
        text: The text, of any origin.
        keep: Characters that are left as they are: a line feed in a text of several lines.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in keep else c.encode("unicode_escape").decode() for c in text)


class NmesError(Exception):
    """Base of all errors of NMES; what is raised is one of its subclasses."""

    def __init__(self, code: str, message: str, path: str | None = None) -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        self.path = path

    def __reduce__(self) -> tuple[Callable[..., NmesError], tuple[Any, ...]]:
        """Lets every error go from one process to another, whatever its class is made with."""
        return _made_again, (type(self), self.args, self.__dict__)


def _made_again(kind: type[NmesError], args: tuple[Any, ...], attributes: dict[str, Any]) -> NmesError:
    error = kind.__new__(kind, *args)
    error.args = args
    error.__dict__.update(attributes)
    return error


class RejectedMessage(NmesError):
    """A frame that is not a valid command; the peer's fault, answered with an `error` reply."""


class WorldError(NmesError):
    """A valid command that the world refuses (an unknown cube, a limit reached); answered with an `error` reply."""


class DocumentError(NmesError):
    """A document (a genome, a brain, a task) that is not as it must be.

    Args:
        problems: What is wrong: each a JSON Pointer without its leading slash, and words for a person. One more is
            taken than are listed; a document of a stranger may have any number.

    Attributes:
        problems: The first of them, at most `MOST`.
        found: These, and one more where there are others.
        lines: A line for each of these, and a last one, `and more`, where there are others.
    """

    MOST = 20

    def __init__(self, problems: Iterable[tuple[str, str]]) -> None:
        self.found = tuple(islice(problems, self.MOST + 1))
        self.problems = self.found[: self.MOST]
        more = ["and more"] if len(self.found) > self.MOST else []
        self.lines = [*(f"{visible(path)}: {words}" if path else words for path, words in self.problems), *more]
        super().__init__("invalid", "\n".join(self.lines), self.found[0][0])


class SimulationFault(NmesError):
    """A physics engine that cannot go on; `body` is the offending body's number where it is known."""

    def __init__(self, code: str, message: str, body: int | None = None) -> None:
        super().__init__(code, message)
        self.body = body


class RecordingError(NmesError):
    """A recording that cannot be written, or a file that cannot be read as one."""


class SigningError(NmesError):
    """A key or a signature that cannot be read or written, or a signature that does not hold."""


class ProofError(NmesError):
    """A recording that proves no score: no recorded episode, or one that does not come out as recorded."""


class LeaderboardError(NmesError):
    """A leaderboard that cannot be read or written, or proofs that it does not list."""


class VariationError(NmesError):
    """A genome that cannot be varied as asked: an unknown kind of mutation, or no good offspring found."""


class RunError(NmesError):
    """A run of evolution or of learning that cannot be begun, read, gone on with, or written."""


class CorpusError(NmesError):
    """A corpus of creatures that cannot be read or added to, or a creature that is not in it."""


class StudyError(NmesError):
    """A study that cannot be read, run or reported."""


class NotDeterministic(NmesError):
    """An environment that does not do the same from the same seed and actions; `problems` says where and in what."""

    def __init__(self, problems: Iterable[str]) -> None:
        self.problems = tuple(problems)
        super().__init__("not_deterministic", "\n".join(self.problems))


class FilmError(NmesError):
    """A film or picture that cannot be made: nothing to show, an unknown format, a file that cannot be written."""


class BackendNotFound(NmesError):
    """No installed physics engine has that name, or the one that has it cannot be loaded."""

    def __init__(self, message: str) -> None:
        super().__init__("backend_not_found", message)


class MissingPackage(NmesError):
    """An optional package that is not installed; the message names the extra that brings it.

    As `MACHINE_ERRORS` it says nothing of what was being computed.
    """

    def __init__(self, message: str) -> None:
        super().__init__("missing_package", message)


class MachineError(NmesError):
    """Something that this machine or its network does not give: a display, a viewer, a cluster, an address."""


class CommandFailed(NmesError):
    """A server's `error` reply to a client's command, raised in the client."""


class Disconnected(NmesError, ConnectionError):
    """The connection to a server is closed; `code` says why, where the server gave a reason."""
