"""Runs cases against a server and collects verdicts.

It hides the order and the threads: cases that share nothing run side by side, those that wait longest first, the others
one by one. Invariants: a case starts as failed and only a run to its end makes it anything else; whatever a case raises
that is no `Finding` is the suite's own fault and is reported as that; the verdicts do not depend on how many cases run
at once; the server is left in the mode in which it was found.
"""

from __future__ import annotations

import hashlib
import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import StrEnum
from fnmatch import fnmatchcase
from functools import cache
from importlib.resources import files
from typing import Any

from nmes.conformance.case import Case, Finding, Level, NotTried, Scope, Unimplemented
from nmes.conformance.cases import CASES, CATEGORIES
from nmes.conformance.clauses import sentence
from nmes.conformance.model import Script, play_script
from nmes.conformance.trial import Halt, Halted, Probe, Target, Trial
from nmes.conformance.wire import Entry, Log, frame_of, read_json
from nmes.errors import NmesError
from nmes.protocol import DELIMITER
from nmes.schemas import schema_hash

__all__ = ["NoCase", "Options", "Report", "Result", "Unreachable", "Verdict", "replay", "run", "select", "suite_hash"]

PATIENT = 5.0  # s of waiting from which on a case goes on beside those that are alone with the world
SIDE_BY_SIDE = 24  # cases at once; nearly all of the time they wait


class Unreachable(NmesError):
    """There is no server to judge, or it does not let the suite in."""


class NoCase(NmesError):
    """The options choose a category that does not exist, or no case at all."""


class Verdict(StrEnum):
    """The outcome of a case. `fault` is a mistake of the suite, not of the server."""

    OK = "ok"
    NON_STRICT = "non-strict"
    UNIMPLEMENTED = "unimplemented"
    FAILED = "failed"
    SKIPPED = "skipped"
    FAULT = "fault"


TOLD = frozenset({Verdict.FAILED, Verdict.FAULT, Verdict.NON_STRICT})  # verdicts whose logs are kept and reported


@dataclass(frozen=True, slots=True)
class Options:
    """The choice of cases to run, and the seed.

    Attributes:
        only: Patterns of case numbers (`3.*`, `4.12:mass*`); all cases if empty.
        categories: Names of categories; all if empty.
        seed: Of all that cases draw.
        fail_fast: Whether the run ends at the first failure.
        time_limit: How long the run may take, s; None: as long as it takes.
    """

    only: Sequence[str] = ()
    categories: Sequence[str] = ()
    seed: int = 0
    fail_fast: bool = False
    time_limit: float | None = None


@dataclass(slots=True)
class Result:
    """The result of one case.

    Attributes:
        case: The case.
        verdict: What was found out.
        expected: What should have happened, where the verdict is failed or non-strict.
        received: What happened instead.
        cause: Where the verdict is failed or fault: what other cases may have failed of too.
        reason: Why it was skipped or is unimplemented; the traceback of a fault.
        endings: How each of its connections ended, by their names in the log.
        log: What went over its wires, where it is not as it should be.
        script: The shortest conversation that shows the failure, where a search has found one.
        seconds: How long it took.
    """

    case: Case
    verdict: Verdict = Verdict.FAILED
    expected: str | None = None
    received: str | None = None
    cause: str | None = None
    reason: str | None = None
    endings: dict[str, str] = field(default_factory=dict)
    log: list[Entry] = field(default_factory=list)
    script: list[dict[str, Any]] | None = None
    seconds: float = 0.0

    @property
    def clause(self) -> str:
        """The sentence of the protocol that this is about."""
        return sentence(self.case.clause)


@dataclass(slots=True)
class Report:
    """The results of a run against a server; `halted` says why it was ended early, if it was."""

    target: Target
    probe: Probe
    options: Options
    results: list[Result]
    started: str
    seconds: float
    halted: str | None = None

    @property
    def counts(self) -> Counter[Verdict]:
        """How many cases have each verdict."""
        return Counter(result.verdict for result in self.results)

    @property
    def causes(self) -> dict[str, list[Result]]:
        """The failures by cause, the most frequent one first."""
        groups: dict[str, list[Result]] = {}
        for result in self.results:
            if result.cause is not None:
                groups.setdefault(result.cause, []).append(result)
        return dict(sorted(groups.items(), key=lambda group: -len(group[1])))

    @property
    def exit_status(self) -> int:
        """0 conforming, 1 not, 2 where the suite has failed, was ended early, or found nothing that it could run."""
        counts = self.counts
        if counts[Verdict.FAULT] or len(self.results) == counts[Verdict.SKIPPED] + counts[Verdict.UNIMPLEMENTED]:
            return 2
        if counts[Verdict.FAILED]:
            return 1
        return 0 if self.halted is None else 2


@cache
def suite_hash() -> str:
    """Returns the SHA-256 of the suite's own files and of the schemas: equal hashes, equal judgement."""
    total = hashlib.sha256(schema_hash().encode())
    root = files("nmes.conformance")
    sources = [entry for folder in (root, root / "cases") for entry in folder.iterdir() if entry.name.endswith(".py")]
    for entry in sorted(sources, key=str):
        total.update(f"\0{entry.name}\0".encode() + entry.read_bytes())
    return total.hexdigest()


def select(options: Options) -> list[Case]:
    """Returns the cases that options ask for, in order.

    Raises:
        NoCase: There is no such category, or no case that fits.
    """
    unknown = set(options.categories) - {category.name for category in CATEGORIES}
    if unknown:
        names = ", ".join(category.name for category in CATEGORIES)
        raise NoCase("invalid", f"there is no category {', '.join(sorted(unknown))}; there are {names}")
    cases = [
        case
        for case in CASES
        if (not options.categories or case.category in options.categories)
        and (
            not options.only
            or any(case.number == pattern or fnmatchcase(case.number, pattern) for pattern in options.only)
        )
    ]
    if not cases:
        raise NoCase("invalid", "no case fits; `nmes conform --list` shows them all")
    return cases


def run(target: Target, options: Options | None = None, on_result: Callable[[Result], None] | None = None) -> Report:
    """Judges a server.

    Args:
        target: The server.
        options: What to run; everything if left out.
        on_result: Called with each result as it comes, in the calling thread.

    Raises:
        Unreachable: Nothing listens there, or the password is refused in both dialects.
        NoCase: The options fit no case.
    """
    options = options or Options()
    cases = select(options)
    started, began = datetime.now(UTC).isoformat(timespec="seconds"), time.monotonic()
    halt = Halt()
    with _time_limit(halt, options.time_limit, began):
        probe = examine(target, halt)
        results = _play_all(target, probe, cases, options, halt, on_result)
    ordered = [results[case.number] for case in cases]
    halted = halt.reason if any(result.reason == halt.reason for result in ordered if result.reason) else None
    return Report(target, probe, options, ordered, started, time.monotonic() - began, halted)


def _play_all(
    target: Target,
    probe: Probe,
    cases: Sequence[Case],
    options: Options,
    halt: Halt,
    on_result: Callable[[Result], None] | None,
) -> dict[str, Result]:
    """Plays cases, each when its turn has come; returns the results by number."""
    plots = {case.number: index for index, case in enumerate(CASES)}
    results: dict[str, Result] = {}

    def take(result: Result) -> None:
        results[result.case.number] = result
        if on_result is not None:
            on_result(result)
        if options.fail_fast and result.cause is not None:
            halt.now(f"ended at the first failure, {result.case.number}")

    def job(case: Case) -> Result:
        return play(target, probe, case, plots[case.number], options.seed, halt)

    playable: list[Case] = []
    for case in cases:
        if halt.reason is None and (reason := _lacking(probe, case)):
            take(Result(case, Verdict.SKIPPED, reason=reason))
        else:
            playable.append(case)
    by_scope = {scope: [case for case in playable if case.scope is scope] for scope in Scope}
    pool = ThreadPoolExecutor(SIDE_BY_SIDE, thread_name_prefix="case")
    with pool, _halting(halt):
        together = sorted(by_scope[Scope.CONNECTION], key=lambda case: -case.wait)
        pending = {pool.submit(job, case): case for case in together}
        # Those that only wait for a time-out, and touch nothing, go on beside the cases that follow.
        _collect(pending, take, lambda case: case.wait < PATIENT)
        try:
            for case in by_scope[Scope.TIME]:
                if halt.reason is None and case is by_scope[Scope.TIME][0]:
                    _stop_time(target, probe)
                take(job(case))
            for case in by_scope[Scope.WORLD]:
                if halt.reason is None:
                    _set_going(target, probe)
                take(job(case))
        finally:
            if by_scope[Scope.TIME] or by_scope[Scope.WORLD]:
                _release(target, probe)
        _collect(pending, take, lambda case: True)
        for case in by_scope[Scope.HOST]:
            take(job(case))
    return results


def _lacking(probe: Probe, case: Case) -> str:
    """Returns the words for everything that a case needs and the server lacks; empty where that is nothing."""
    reasons = [reason for need in case.needs if (reason := probe.lacks(need)) is not None]
    return "; ".join(dict.fromkeys(reasons))


@contextmanager
def _time_limit(halt: Halt, seconds: float | None, began: float) -> Iterator[None]:
    """Ends the run when its time is over."""
    timer = None
    if seconds is not None:
        left = max(0.0, began + seconds - time.monotonic())
        timer = threading.Timer(left, halt.now, [f"the time limit of {seconds:g} s was over"])
        timer.daemon = True
        timer.start()
    try:
        yield
    finally:
        if timer is not None:
            timer.cancel()


@contextmanager
def _halting(halt: Halt) -> Iterator[None]:
    """Ends the run where its block is left early, as on Ctrl-C, so that nobody waits for cases under way."""
    try:
        yield
    except BaseException:
        halt.now("the run was interrupted")
        raise


def replay(target: Target, script: Script) -> Result:
    """Plays one conversation that a search had found wrong, with time standing still as in the search.

    Raises:
        Unreachable: As `run`.
    """
    halt = Halt()
    probe = examine(target, halt)
    case = Case(
        "replay", "search", "Every answer is one that a world must give", "3.3.1", Level.MUST, (), Scope.TIME, 0.0,
        lambda trial: play_script(trial, script),
    )  # fmt: skip
    _stop_time(target, probe)
    try:
        return play(target, probe, case, 0, 0, halt)
    finally:
        _release(target, probe)


def _collect(
    pending: dict[Future[Result], Case], take: Callable[[Result], None], awaited: Callable[[Case], bool]
) -> None:
    """Takes results as they come, until no awaited case is pending."""
    while any(map(awaited, pending.values())):
        done, _ = wait(pending, return_when=FIRST_COMPLETED)
        for future in done:
            del pending[future]
            take(future.result())


def examine(target: Target, halt: Halt) -> Probe:
    """Probes a server: its banner, world and capabilities.

    Where the run is ended meanwhile, the probe holds what was learned before.

    Raises:
        Unreachable: Nothing listens there, or the password is refused in both dialects.
    """
    log = Log()
    try:
        wire = target.connect(log, "probe")
    except Finding as finding:
        raise Unreachable("unreachable", f"nothing answers at {target.address}: {finding.received}") from finding
    info: dict[str, Any] = {}
    used: set[str] = set()
    trouble: str | None = None
    with wire:
        try:
            halt.watch(wire)
            welcome = target.enter(wire)
        except Halted as halted:
            return Probe({}, {}, frozenset(), "r0", str(halted))
        except Finding as finding:
            if halt.reason is None and _refuses(target, log, halt):
                raise Unreachable("auth_failed", "the server refuses that password in both dialects") from finding
            return Probe({}, {}, frozenset(), "r0", str(finding))
        try:
            wire.say({"type": "get_world_info"})
            info = read_json(wire.frame(what="a reply to get_world_info"))
            wire.say({"type": "get_cube_list"})
            cubes = read_json(wire.frame(what="a reply to get_cube_list")).get("cubes")
            used = {name for name in cubes if isinstance(name, str)} if isinstance(cubes, list) else set()
        except Finding as finding:
            trouble = str(finding)
    info = {} if info.get("type") != "world_info" else info
    claims = info.get("capabilities")
    capabilities = frozenset(name for name in claims if isinstance(name, str)) if isinstance(claims, list) else ()
    tag = f"r{welcome['client']}"
    while any(name.startswith(f"{tag}-") for name in used):
        tag += "x"
    return Probe(welcome, info, frozenset(capabilities), tag, trouble)


def _refuses(target: Target, log: Log, halt: Halt) -> bool:
    """Whether a server answers `auth_failed` in both dialects."""
    frames = [frame_of({"type": "auth", "password": target.password}), target.password.encode() + DELIMITER]
    for first in frames:
        try:
            with target.connect(log, "probe") as wire:
                halt.watch(wire)
                wire.send(first)
                if b"auth_failed" not in wire.frame(what="an answer"):
                    return False
        except (Finding, Halted):
            return False
    return True


def _stop_time(target: Target, probe: Probe) -> None:
    """Makes the world stand still between steps, where the suite can; a case will tell if it does not."""
    if not probe.stepping:
        if probe.info.get("paused") is True:
            _set_going(target, probe)
    elif probe.mode != "lockstep":
        if {"pause", "resume"} <= probe.capabilities:
            _set_time(target, {"type": "pause"})
        else:
            _set_time(target, {"type": "set_mode", "mode": "lockstep"})


def _set_going(target: Target, probe: Probe) -> None:
    """Restores the world's mode and rate, and lets it run, though it was found paused: cases expect that."""
    if "set_mode" in probe.capabilities:
        rate = probe.info.get("rate", 1)
        _set_time(
            target, {"type": "set_mode", "mode": probe.mode, "rate": rate if isinstance(rate, (int, float)) else 1}
        )
    if "resume" in probe.capabilities:
        _set_time(target, {"type": "resume"})


def _release(target: Target, probe: Probe) -> None:
    """Restores the world's mode, rate and pause."""
    _set_going(target, probe)
    if "pause" in probe.capabilities and probe.info.get("paused") is True:
        _set_time(target, {"type": "pause"})


def _set_time(target: Target, command: dict[str, Any]) -> None:
    """Sends a command about the world's time; the cases judge whether it works."""
    log = Log()
    try:
        with target.connect(log, "clock") as wire:
            target.enter(wire)
            wire.say(command)
            wire.frame(what="a reply")
    except Finding as finding:
        log.add("clock", "note", str(finding).encode())


def play(target: Target, probe: Probe, case: Case, plot: int, seed: int, halt: Halt) -> Result:
    """Plays one case, unless the run was ended."""
    trial = Trial(target, probe, case, plot, seed, halt)
    began = time.monotonic()
    try:
        result = _judged(trial)
    finally:  # also where it is interrupted
        endings = trial.close_all()
        trial.clean_up()
    result.endings = endings
    result.seconds = time.monotonic() - began
    result.log = trial.log.entries if result.verdict in TOLD else []
    result.script = trial.script
    return result


def _judged(trial: Trial) -> Result:
    """Plays a case to its end, whatever that is, and returns the verdict, without what it left behind."""
    case = trial.case
    result = Result(case)
    try:
        trial.sleep(0)
        case.run(trial)
        result.verdict = Verdict.OK
        if trial.remarks:
            result.verdict = Verdict.NON_STRICT
            result.expected = "; ".join(remark.expected for remark in trial.remarks)
            result.received = "; ".join(remark.received for remark in trial.remarks)
    except NotTried as why:
        result.verdict, result.reason = Verdict.SKIPPED, str(why)
    except Unimplemented as lack:
        result.verdict, result.reason = Verdict.UNIMPLEMENTED, str(lack)
    except Finding as finding:
        result.verdict = Verdict.NON_STRICT if case.level is Level.SHOULD else Verdict.FAILED
        result.expected, result.received = finding.expected, finding.received
        result.cause = finding.cause if result.verdict is Verdict.FAILED else None
    except Exception as error:
        # Not the server's fault, whatever it sent: the report shows it, and the run ends with status 2.
        result.verdict, result.reason = Verdict.FAULT, traceback.format_exc()
        result.cause = f"a fault of the suite: {type(error).__name__}"
    reason = trial.halt.reason
    if reason is not None and result.verdict in (Verdict.FAILED, Verdict.NON_STRICT, Verdict.FAULT):
        result = Result(case, Verdict.SKIPPED, reason=reason)
    return result
