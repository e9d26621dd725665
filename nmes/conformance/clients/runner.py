"""Plays the cases against a client, one after the other, and collects verdicts.

Invariants: a case begins with no connection; after one that failed, the driver is started anew, so that no case fails
of another; whatever a case raises that is no `Finding` is the suite's own fault, and is reported as that.
"""

from __future__ import annotations

import socket
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase

from nmes.conformance.case import Finding, NotTried
from nmes.conformance.clients.case import ClientCase
from nmes.conformance.clients.conversations import CONNECTIONS, MATCHING
from nmes.conformance.clients.driver import Driver
from nmes.conformance.clients.frames import COMING, GOING, LOGIN
from nmes.conformance.clients.stage import Stage
from nmes.conformance.runner import NoCase, Verdict
from nmes.conformance.wire import Entry
from nmes.errors import NmesError

__all__ = ["CLIENT_CASES", "ClientResult", "NoPort", "judge", "select_client_cases"]

CLIENT_CASES = [case for group in (LOGIN, COMING, GOING, MATCHING, CONNECTIONS) for case in group.cases]
"""All cases, in order."""

# Bytes that the system keeps of what a client sends, and of what it is sent: little, as of a busy server. Connections
# have it from their beginning, by the listener. Told later, it shrinks a window that the client was promised, whose
# system then sends a little every 200 ms, and waits longer each time where that is lost.
_KEPT = 16 << 10


class NoPort(NmesError):
    """The port cannot be listened on."""


@dataclass(slots=True)
class ClientResult:
    """The result of one case.

    Attributes:
        case: The case.
        verdict: What was found out: ok, failed, skipped or fault.
        expected: What should have happened, where it failed.
        received: What happened instead.
        reason: Why it was skipped; the traceback of a fault.
        log: What the driver was told and said, and what went over the connections.
    """

    case: ClientCase
    verdict: Verdict = Verdict.FAILED
    expected: str | None = None
    received: str | None = None
    reason: str | None = None
    log: list[Entry] = field(default_factory=list)


def select_client_cases(only: Sequence[str]) -> list[ClientCase]:
    """Returns the cases whose numbers fit a pattern, all if there is none.

    Raises:
        NoCase: None does.
    """
    cases = [case for case in CLIENT_CASES if not only or any(fnmatchcase(case.number, each) for each in only)]
    if not cases:
        raise NoCase("invalid", "no case fits; `nmes conform-client --list` shows them all")
    return cases


def judge(
    command: Sequence[str],
    *,
    port: int = 0,
    timeout: float = 5.0,
    only: Sequence[str] = (),
    on_result: Callable[[ClientResult], None] | None = None,
) -> list[ClientResult]:
    """Judges a client by a program that drives it.

    Args:
        command: The program and its arguments.
        port: Where the client is to connect to, on this machine; 0: any port that is free.
        timeout: How long one wait for the client may take, s.
        only: Patterns of case numbers (`2.*`); all if empty.
        on_result: Called with each result as it comes.

    Raises:
        NoDriver: The program cannot be started.
        NoPort: The port cannot be listened on.
        NoCase: No case fits.
    """
    cases = select_client_cases(only)
    try:
        listener = socket.create_server(("127.0.0.1", port))
    except OSError as error:
        raise NoPort("unreachable", f"cannot listen on port {port}: {error.strerror}") from error
    for buffer in (socket.SO_RCVBUF, socket.SO_SNDBUF):
        listener.setsockopt(socket.SOL_SOCKET, buffer, _KEPT)
    driver: Driver | None = None
    results: list[ClientResult] = []
    with listener:
        try:
            for case in cases:
                driver = driver or Driver(command)
                result = _play(case, Stage(listener, driver, timeout))
                if result.verdict is not Verdict.OK:
                    driver.kill()
                    driver.close()
                    driver = None
                results.append(result)
                if on_result is not None:
                    on_result(result)
        finally:
            if driver is not None:
                driver.close()
    return results


def _play(case: ClientCase, stage: Stage) -> ClientResult:
    """Plays one case; the client is closed afterwards, so that it can be opened again."""
    result = ClientResult(case, log=stage.log.entries)
    try:
        try:
            case.run(stage)
            stage.tell("close")
            stage.hear("close")
            result.verdict = Verdict.OK
        finally:
            stage.close()
    except NotTried as reason:
        result.verdict, result.reason = Verdict.SKIPPED, str(reason)
    except Finding as finding:
        result.expected, result.received = finding.expected, finding.received
    except Exception:
        result.verdict, result.reason = Verdict.FAULT, traceback.format_exc()
    return result
