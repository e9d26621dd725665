"""One case being played against one server: its connections, its names, its place in the world, and how it judges.

It hides what must not matter to a case: which cubes the world holds already, who else plays beside it, and whether
time is moved on by `step` or passes by the clock. Invariants: every name is new in the world, every case has a plot of
its own (12 m along x), what was spawned is despawned afterwards, and every wire is closed.
"""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from nmes.conformance.case import Case, Finding
from nmes.conformance.wire import NO_ID, Log, Message, Wire, clip, read_json
from nmes.protocol import COMMANDS, DELIMITER

__all__ = ["ABSENT", "Halt", "Halted", "Probe", "Target", "Trial"]

PLOT = 12.0  # m along x for each case
FIRST_PLOT = 10  # the first ones, round the origin, are left to what is in the world already
GLANCE = 1 / 30  # s between two looks where time passes by the clock
CLOCK_SLACK = 3.0  # how much longer than it should something may take where time passes by the clock
ABSENT = frozenset({"unsupported", "unknown_type"})
# Engines must have these unless they list their joints and leave some out.
_REQUIRED_JOINTS = frozenset({"joint.fixed", "joint.hinge", "joint.slide"})


@dataclass(frozen=True, slots=True)
class Target:
    """The server under test.

    Attributes:
        host: Its name or address.
        port: Its port.
        password: Its password.
        timeout: How long one wait for it may take, s.
        scheme: `tcp`, or `ws` for WebSockets.
    """

    host: str
    port: int
    password: str
    timeout: float = 5.0
    scheme: str = "tcp"

    @property
    def address(self) -> str:
        """Where it is, as the command line has it."""
        return f"{'' if self.scheme == 'tcp' else f'{self.scheme}://'}{self.host}:{self.port}"

    def connect(self, log: Log, name: str) -> Wire:
        """Connects, without authenticating."""
        return Wire(self.host, self.port, self.timeout, log, name, self.scheme)

    def enter(self, wire: Wire) -> Message:
        """Authenticates in the json dialect; returns the server's `auth_success`."""
        wire.say({"type": "auth", "password": self.password})
        welcome = wire.hear(what="auth_success")
        if welcome["type"] != "auth_success":
            raise Finding("auth_success", clip(welcome))
        return welcome


@dataclass(frozen=True, slots=True)
class Probe:
    """The server's own account of itself, before any case is run.

    Attributes:
        banner: Its `auth_success`, as far as it could be read.
        info: Its `world_info`, as far as it could be read; empty if it has none.
        capabilities: What it claims there.
        tag: What all names of this run begin with.
        trouble: Why there is no banner, if there is none.
    """

    banner: Mapping[str, Any]
    info: Mapping[str, Any]
    capabilities: frozenset[str]
    tag: str
    trouble: str | None = None

    @property
    def planar(self) -> bool:
        """Whether the world is a plane."""
        return self.banner.get("dims") == 2

    @property
    def mode(self) -> str:
        """The world's mode before the run."""
        return str(self.info.get("mode", self.banner.get("mode", "realtime")))

    @property
    def tick_rate(self) -> float:
        """Ticks in a second."""
        rate = self.banner.get("tick_rate")
        return float(rate) if isinstance(rate, (int, float)) and rate > 0 else 60.0

    @property
    def stepping(self) -> bool:
        """Whether the suite can move the time on itself."""
        return "step" in self.capabilities and (
            self.mode == "lockstep" or {"pause", "resume"} <= self.capabilities or "set_mode" in self.capabilities
        )

    def claims(self, capability: str) -> bool:
        """Whether the server must have a capability: because all must, or because it claims it."""
        if capability in COMMANDS and COMMANDS[capability].required:
            return True
        if capability in _REQUIRED_JOINTS and not any(name.startswith("joint.") for name in self.capabilities):
            return True
        return capability in self.capabilities

    def lacks(self, need: str) -> str | None:
        """Returns why a case with that need cannot be run; None if it can.

        A need is a command, a capability of an engine, or one of: `3d`, `planar`; `stepping` (the suite can move the
        time on), `time` (that, or time passes by the clock), `lockstep` (the world was found in that mode, so that it
        is a test world which may be reset); or `config.` and a field that the world's config must have.
        """
        if need.startswith("config."):
            name, config = need.removeprefix("config."), self.info.get("config")
            has = isinstance(config, Mapping) and config.get(name)
            return None if has else f"the world's config has no {name}"
        if need in ("3d", "planar"):
            return None if self.planar == (need == "planar") else f"the world is {'planar' if self.planar else '3d'}"
        if need == "stepping":
            return None if self.stepping else "the suite cannot move the time on: step with lockstep, pause or set_mode"
        if need == "time":
            still = self.mode == "lockstep" and not self.stepping
            return "the world's time stands still, and there is no step" if still else None
        if need == "lockstep":
            return None if self.mode == "lockstep" else f"the world is not in lockstep but in {self.mode}: it is spared"
        return None if self.claims(need) else f"not claimed: {need}"


class Halted(Exception):
    """The run was ended while the case was under way, or before it."""


class Halt:
    """Ends a run before its time: connections of cases that are under way are cut, none are made any more.

    What a case meets then says nothing about the server. Those that clean up after a case still connect.

    Attributes:
        reason: Why the run was ended; None while it goes on.
    """

    def __init__(self) -> None:
        self.reason: str | None = None
        self._wires: set[Wire] = set()
        self._lock = threading.Lock()
        self._over = threading.Event()

    def now(self, reason: str) -> None:
        """Ends the run, once; may be called in any thread."""
        with self._lock:
            if self.reason is not None:
                return
            self.reason = reason
            wires = list(self._wires)
        self._over.set()
        for wire in wires:
            wire.cut()

    def watch(self, wire: Wire) -> None:
        """Has a wire cut when the run is ended.

        Raises:
            Halted: It was ended.
        """
        with self._lock:
            self._wires.add(wire)
            reason = self.reason
        if reason is not None:
            raise Halted(reason)

    def forget(self, wire: Wire) -> None:
        """Leaves a wire alone, which is about to be closed."""
        with self._lock:
            self._wires.discard(wire)

    def sleep(self, seconds: float) -> None:
        """Waits.

        Raises:
            Halted: The run was ended meanwhile.
        """
        if self._over.wait(seconds):
            raise Halted(self.reason)


class Trial:
    """The context of one case: ways to connect, to name, to wait and to judge."""

    def __init__(self, target: Target, probe: Probe, case: Case, plot: int, seed: int, halt: Halt) -> None:
        self.target = target
        self.probe = probe
        self.case = case
        self.log = Log()
        self.seed = seed
        self.halt = halt
        self.script: list[dict[str, Any]] | None = None  # the shortest conversation that a search has found wrong
        self.random = random.Random(f"{seed}:{case.number}")
        self.remarks: list[Finding] = []
        self.wires: list[Wire] = []
        self.plot = plot
        self._x = PLOT * ((FIRST_PLOT + plot // 2) * (-1 if plot % 2 else 1))
        self._names = 0
        self._spawned: list[str] = []

    # -- connections -----------------------------------------------------------------------------------------------

    def connect(self) -> Wire:
        """Returns a connection on which nothing has been sent yet."""
        number = len(self.wires)
        wire = self.target.connect(self.log, chr(ord("a") + number) if number < 26 else f"w{number}")
        self.wires.append(wire)
        self.halt.watch(wire)
        return wire

    def join(self) -> Wire:
        """Returns a connection in the json dialect."""
        wire = self.connect()
        self.target.enter(wire)
        return wire

    def raw(self) -> Wire:
        """Returns a connection in the raw dialect."""
        wire = self.connect()
        wire.send(self.target.password.encode() + DELIMITER)
        self.equal(wire.frame(what="auth_success"), b"auth_success", "the answer to the bare password")
        return wire

    @property
    def wrong_password(self) -> str:
        """A password that is not the server's, whatever that is."""
        return "not-" + self.target.password

    def fence(self, wire: Wire) -> None:
        """Makes sure that the server has answered all that it had to, and not more, and still serves."""
        mark = f"fence-{self._count()}"
        wire.say({"type": "ping", "id": mark})
        reply = wire.reply("pong")
        if reply["type"] != "pong" or reply.get("id") != mark:
            cause = f"{reply['type']} in reply to ping" if "id" in reply else NO_ID
            raise Finding(f"nothing before the pong to ping {mark}", clip(reply), cause)

    # -- names, places, cubes --------------------------------------------------------------------------------------

    def name(self, hint: str = "cube") -> str:
        """Returns a name that nobody has, and remembers to despawn a cube of that name."""
        name = f"{self.probe.tag}-{self.plot}-{hint}-{self._count()}"
        self._spawned.append(name)
        return name

    def at(self, x: float = 0.0, y: float = 3.0, z: float = 0.0) -> list[float]:
        """Returns a point, x from -5 to 5, of the case's own plot."""
        return [self._x + x, y, 0.0 if self.probe.planar else z]

    def spawn(self, wire: Wire, hint: str = "cube", **fields: Any) -> str:
        """Spawns a cube (on the plot, if no position is given) and returns its name."""
        command = {"type": "spawn_cube", "cube_name": self.name(hint), "position": self.at(), "list": False, **fields}
        reply = self.ask(wire, command, "cube_list")
        name = reply["spawned"]
        self.adopt(name)
        return str(name)

    def base(self, wire: Wire, hint: str = "base", **fields: Any) -> str:
        """Spawns a frozen cube."""
        return self.spawn(wire, hint, is_base=True, **fields)

    def adopt(self, name: str) -> None:
        """Remembers to despawn a cube that the server named."""
        self._spawned.append(name)

    def info(self, wire: Wire, name: str) -> Message:
        """Returns a cube's `cube_info`."""
        return self.ask(wire, {"type": "get_cube_info", "cube_name": name}, "cube_info")

    def cubes(self, wire: Wire) -> list[str]:
        """Returns the names of all cubes."""
        return list(self.ask(wire, {"type": "get_cube_list"}, "cube_list")["cubes"])

    def join_cubes(self, wire: Wire, one: str, two: str, kind: str = "fixed", **fields: Any) -> str:
        """Makes a joint and returns its name."""
        command = {"type": "create_joint", "cube1": one, "cube2": two, "joint_type": kind, **fields}
        return str(self.ask(wire, command, "joint_created")["joint_name"])

    def ask(self, wire: Wire, command: Mapping[str, Any], expected: str) -> Message:
        """Sends a command and returns its reply, which must be of the expected type."""
        reply = wire.ask(command)
        if reply["type"] == expected:
            return reply
        answer = f"error {reply['code']}" if reply["type"] == "error" else reply["type"]
        raise Finding(f"{expected} in reply to {clip(command)}", clip(reply), f"{answer} in reply to {command['type']}")

    # -- time ------------------------------------------------------------------------------------------------------

    def advance(self, wire: Wire, seconds: float) -> None:
        """Moves the world's time on by `step`, or waits by the clock."""
        if self.probe.stepping:
            ticks = max(round(seconds * self.probe.tick_rate), 1)
            self.ask(wire, {"type": "step", "ticks": ticks}, "stepped")
        else:
            self.sleep(seconds)

    def sleep(self, seconds: float) -> None:
        """Waits by the clock."""
        self.halt.sleep(seconds)

    def watch(self, wire: Wire, name: str, seconds: float) -> Iterator[Message]:
        """Yields a cube's info now and then while that much of the world's time passes, at its end too."""
        yield self.info(wire, name)
        looks = max(round(seconds / GLANCE), 1)
        for _ in range(looks):
            self.advance(wire, seconds / looks)
            yield self.info(wire, name)

    def until(self, wire: Wire, name: str, seconds: float, done: Callable[[Message], bool], expected: str) -> Message:
        """Returns the first info of a cube for which `done` is true; by the clock it may come later."""
        slack = 1.0 if self.probe.stepping else CLOCK_SLACK
        info: Message | None = None
        for info in self.watch(wire, name, seconds * slack):
            if done(info):
                return info
        raise Finding(f"{expected} within {seconds:g} s of the world's time", clip(info))

    # -- judging ---------------------------------------------------------------------------------------------------

    def true(self, condition: bool, expected: str, received: Any) -> None:
        """Makes sure of something."""
        if not condition:
            raise Finding(expected, clip(received))

    def equal(self, got: Any, expected: Any, what: str) -> None:
        """Makes sure that two values are the same, true and 1 not being so."""
        if got != expected or isinstance(got, bool) != isinstance(expected, bool):
            raise Finding(f"{what}: {clip(expected)}", clip(got), f"wrong: {what}")

    def close(self, got: Sequence[float] | float, expected: Sequence[float] | float, error: float, what: str) -> None:
        """Makes sure that numbers differ by no more than `error`."""
        ours = list(expected) if isinstance(expected, Sequence) else [expected]
        theirs = list(got) if isinstance(got, Sequence) else [got]
        if len(ours) != len(theirs) or not all(abs(a - b) <= error for a, b in zip(ours, theirs, strict=True)):
            raise Finding(f"{what}: {expected}, {error:g} more or less", clip(got), f"wrong: {what}")

    def should(self, condition: bool, expected: str, received: Any) -> None:
        """Notes something that a strict server would do; the case goes on."""
        if not condition:
            self.remarks.append(Finding(expected, clip(received)))

    def error(self, reply: Message, codes: str | Collection[str], field: str | None = None) -> Message:
        """Makes sure that a reply is an error with that code; a wrong or missing `field` is not strict."""
        allowed = {codes} if isinstance(codes, str) else set(codes)
        expected = " or ".join(sorted(allowed))
        if reply["type"] != "error" or reply["code"] not in allowed:
            answer = f"error {reply['code']}" if reply["type"] == "error" else reply["type"]
            words = f"error {expected}" + (f" with field {field}" if field else "")
            raise Finding(words, clip(reply), f"{answer} in place of error {expected}")
        if field is not None:
            self.should(reply.get("field") == field, f"field {field!r}", reply)
        return reply

    def refused(
        self, wire: Wire, command: Mapping[str, Any], codes: str | Collection[str], field: str | None = None
    ) -> Message:
        """Sends a command that must fail with one of these codes."""
        reply = self.error(wire.ask(command), codes, field)
        self.should(reply.get("command") == command["type"], f"command {command['type']!r}", reply)
        return reply

    # -- the end ---------------------------------------------------------------------------------------------------

    def clean_up(self) -> None:
        """Despawns the case's cubes, or resets a world that may be reset.

        What goes wrong with that is no finding: the case has been judged.
        """
        may_reset = "lockstep" in self.case.needs
        if not (self._spawned or may_reset) or any(wire.ending == "timed out" for wire in self.wires):
            return
        try:
            with self.target.connect(Log(), "cleaner") as wire:
                self.target.enter(wire)
                names: Iterable[str] = dict.fromkeys(self._spawned)
                if may_reset:
                    wire.say({"type": "reset", "seed": self.probe.info.get("seed", 0)})
                else:
                    wire.say(*({"type": "despawn_cube", "cube_name": name} for name in names))
                wire.say({"type": "ping"})
                until = time.monotonic() + wire.timeout
                while read_json(wire.frame(until - time.monotonic())).get("type") != "pong":
                    pass
        except Finding as finding:
            self.log.add("cleaner", "note", f"could not clean up: {finding}".encode())

    def forget(self) -> None:
        """Forgets the names of cubes that were cleaned up."""
        self._spawned.clear()

    def close_all(self) -> dict[str, str]:
        """Closes the wires; returns how each of them had ended."""
        endings = {wire.name: wire.ending for wire in self.wires}
        for wire in self.wires:
            self.halt.forget(wire)
            wire.close()
        return endings

    def _count(self) -> int:
        self._names += 1
        return self._names
