"""Servers with one defect each, to show that the conformance suite finds it.

A defect is a function that patches our own server before a host is started in this process; its docstring says what the
server does wrong, its decorator which cases must find it. The defects stand in `broken_wires` (bytes, auth, dialects,
JSON, limits, connections), `broken_worlds` (commands), `broken_names` (fields, errors, names, clients, capabilities),
`broken_times` (time, subscriptions), `broken_physics` (physics, determinism), `broken_creatures` (rewards, creatures)
and `broken_roles` (roles). Invariants: a defect is undone when its server has stopped; the suite, which runs in the
same process, does not use what is patched; a server counts as caught only if each case that it names fails while some
of the others still pass, for a server that answers nothing at all would show nothing about a case.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from pytest import MonkeyPatch

from nmes.conformance import Options, Result, Target, Verdict, run
from nmes.protocol import Limits
from nmes.world import World
from nmes.world.clients import Client
from nmes.world.commands import COMMANDS
from servers import PASSWORD, served

__all__ = ["CONTROLS", "DEFECTS", "Defect", "Judgement", "Setup", "around", "defect", "judge", "unbroken"]

CONTROLS = ("1.1", "1.20", "2.1", "3.1", "4.3:object", "5.1", "5.3", "5.10", "7.5", "8.14")
"""Cases that a server with one defect mostly passes."""

IMPATIENT, PATIENT = 3.0, 10.0  # s that a broken server, and ours, may be silent

JsonObject = dict[str, Any]
Answer = Callable[[World, Client, JsonObject], JsonObject]


@dataclass(frozen=True, eq=False)
class Setup:
    """How a server is set up: its world's config, the protocol's limits, the delay of a refusal (s)."""

    config: Mapping[str, Any] = field(default_factory=dict)
    limits: Limits = field(default_factory=Limits)
    auth_delay: float = 1.0


@dataclass(frozen=True)
class Defect:
    """One broken server.

    Attributes:
        name: Of the function that breaks it.
        does: What it does wrong, for people.
        cases: Numbers of the cases that must find it.
        setup: How it is set up.
        only_strict: Whether it breaks no more than a SHOULD, so that the cases must say `non-strict`.
        break_it: Patches what is in this process.
    """

    name: str
    does: str
    cases: tuple[str, ...]
    setup: Setup
    only_strict: bool
    break_it: Callable[[MonkeyPatch], None]


DEFECTS: list[Defect] = []


def defect(
    *cases: str,
    backend: str = "ballistic",
    mode: str = "lockstep",
    limits: Limits | None = None,
    auth_delay: float = 1.0,
    only_strict: bool = False,
    config: Mapping[str, Any] | None = None,
) -> Callable[[Callable[[MonkeyPatch], None]], Callable[[MonkeyPatch], None]]:
    """Registers the function below it as a defect that these cases must find."""
    setup = Setup({"backend": backend, "mode": mode, **(config or {})}, limits or Limits(), auth_delay)

    def register(break_it: Callable[[MonkeyPatch], None]) -> Callable[[MonkeyPatch], None]:
        assert break_it.__doc__, break_it.__name__
        DEFECTS.append(Defect(break_it.__name__, break_it.__doc__.rstrip("."), cases, setup, only_strict, break_it))
        return break_it

    return register


def around(patch: MonkeyPatch, kind: str, change: Callable[[Answer, World, Client, JsonObject], JsonObject]) -> None:
    """Wraps a command's function: `change` gets the function and its arguments, and returns the reply."""
    answer: Answer = COMMANDS[kind]

    def changed(world: World, client: Client, command: JsonObject) -> JsonObject:
        return change(answer, world, client, command)

    patch.setitem(COMMANDS, kind, changed)


class Outcome(NamedTuple):
    """The outcome of one case: its number, its verdict, and the mistake that it reports, if any."""

    number: str
    verdict: Verdict
    mistake: str | None


@dataclass(frozen=True)
class Judgement:
    """The suite's judgement of one server.

    Attributes:
        named: Outcomes of the cases that must find the defect; for the unbroken server, of all that any defect names.
        controls: Outcomes of the control cases.
        expected: The verdict that the named cases must reach.
    """

    named: Sequence[Outcome]
    controls: Sequence[Outcome]
    expected: Verdict

    @property
    def caught(self) -> bool:
        """Whether all named cases found the defect, and only it."""
        alive = any(outcome.verdict is Verdict.OK for outcome in self.controls)
        return alive and bool(self.named) and all(outcome.verdict is self.expected for outcome in self.named)

    @property
    def clean(self) -> bool:
        """Whether every case was run and passed, or tests something that the server does not claim to have."""
        passed = (Verdict.OK, Verdict.UNIMPLEMENTED)
        return all(outcome.verdict in passed for outcome in (*self.named, *self.controls))

    @property
    def others(self) -> list[str]:
        """Numbers of the control cases that did not pass."""
        return [outcome.number for outcome in self.controls if outcome.verdict is not Verdict.OK]


@contextmanager
def _quietly() -> Iterator[None]:
    """Silences the server's log: that it fails is the point."""
    before = logging.root.manager.disable
    logging.disable()
    try:
        yield
    finally:
        logging.disable(before)


def _judge(setup: Setup, cases: Sequence[str], expected: Verdict, timeout: float) -> Judgement:
    with _quietly(), served(setup.config, limits=setup.limits, auth_delay=setup.auth_delay) as server:
        target = Target("127.0.0.1", server.port, PASSWORD, timeout)
        controls = run(target, Options(only=[number for number in CONTROLS if number not in cases]))
        named = run(target, Options(only=cases))
    return Judgement(list(map(_outcome, named.results)), list(map(_outcome, controls.results)), expected)


def _outcome(result: Result) -> Outcome:
    mistake = result.reason or (result.expected and f"expected {result.expected}, received {result.received}")
    return Outcome(result.case.number, result.verdict, mistake)


def judge(defect: Defect) -> Judgement:
    """Starts the broken server and has its cases judge it."""
    expected = Verdict.NON_STRICT if defect.only_strict else Verdict.FAILED
    with MonkeyPatch.context() as patch:
        defect.break_it(patch)
        return _judge(defect.setup, defect.cases, expected, IMPATIENT)


def unbroken(defects: Sequence[Defect]) -> Iterator[tuple[Mapping[str, Any], Judgement]]:
    """Judges the server without defects by all cases that they name; yields each config and its judgement."""
    cases: dict[str, tuple[Mapping[str, Any], dict[str, None]]] = {}
    for defect in defects:
        config = defect.setup.config
        cases.setdefault(json.dumps(config), (config, {}))[1].update(dict.fromkeys(defect.cases))
    for config, numbers in cases.values():
        yield config, _judge(Setup(config), list(numbers), Verdict.OK, PATIENT)
