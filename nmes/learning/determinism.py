"""Whether an environment does the same again: what upstream's checkers let through.

    check_determinism("nmes/walk-v0", genome="walker")
    check_determinism(lambda: gymnasium.make("CartPole-v1"))

Hides the runs that are laid beside one another: the same seeds and actions, the second time in the same environment
after other episodes, with other global generators, another clock and one buffer for all actions; then in another
environment, in another thread, while the first goes on; then in another process, with another hash seed. Each call's
observation, reward, ends and info are compared bit by bit, and what was handed out is looked at again later.
"""

from __future__ import annotations

import os
import pickle
import random
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import gymnasium
import numpy as np

from nmes.errors import NotDeterministic
from nmes.learning.registration import register

__all__ = ["check_determinism"]

_SEED, _OTHER_SEED = 20, 21
_EPISODES, _LONGEST = 4, 250  # how many episodes there are at the least, and after how many steps one is given up
_SHIFT: Final = 987654.321  # s by which clocks are set forward
_CLOCKS: Final = ("time", "monotonic", "perf_counter", "process_time")
_HASH_SEEDS: Final = ("4711", "4712")
_AGO: Final = 8  # calls for which what was handed out is looked at again at once; all of it at the end
_CHILD: Final = "from nmes.learning.determinism import _answer; _answer()"

_FIELDS: Final = ("observation", "reward", "terminated", "truncated", "info")
Environment = gymnasium.Env[Any, Any]
Source = str | gymnasium.envs.registration.EnvSpec | Callable[[], Environment]


def check_determinism(env: Environment | Source, *, steps: int = 600, **settings: Any) -> tuple[str, ...]:
    """Makes sure that an environment does the same from the same seed and actions, to the last bit.

    Args:
        env: A factory, or a name or spec that `gymnasium.make` takes; or an environment, of which others are made by
            its spec. Without one, and where a factory cannot be sent to another process (pickled), less is tried.
        steps: How many steps each run has at least, over several episodes, each of which is given up after so many or
            250: what shows later is not found.
        settings: For `gymnasium.make`, where `env` is a name.

    Returns:
        What was tried.

    Raises:
        NotDeterministic: It does not: with what differs, in which episode, at which step, and in which field.
    """
    source = _source(env, settings)
    first = env if isinstance(env, gymnasium.Env) else _make(source)
    tried = ["again"]
    findings = _again(first, steps)
    if source is not None and not findings.problems:
        tried += ["another environment", "another thread"]
        findings.compare(_in_a_thread(source, first, steps), "in another environment, while the first goes on")
    if source is not None and not findings.problems:
        trace = _in_a_process(source, steps)
        if trace is not None:
            tried.append("another process")
            findings.compare(trace, "in another process")
    if not isinstance(env, gymnasium.Env):
        first.close()
    if findings.problems:
        raise NotDeterministic(findings.problems)
    return tuple(tried)


def _source(env: Environment | Source, settings: dict[str, Any]) -> Source | None:
    register()  # so that a name of ours is known, whatever was imported first
    if isinstance(env, gymnasium.Env):
        return env.spec
    if isinstance(env, str) and settings:
        spec = deepcopy(gymnasium.spec(env))
        spec.kwargs.update(settings)
        return spec
    return env


def _make(source: Source | None) -> Environment:
    assert source is not None
    return source() if callable(source) else gymnasium.make(source)


# -- one run ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Call:
    """What one call of an environment gave: where it was, and each field as bits."""

    episode: int
    step: int
    fields: dict[str, Any]


@dataclass(slots=True)
class _Trace:
    """One run.

    Attributes:
        calls: What each call gave.
        problems: What was wrong in the run itself.
    """

    calls: list[_Call]
    problems: list[str]


class _Player:
    """Plays episodes with actions that depend on nothing but how many there were."""

    def __init__(self, env: Environment, seed: int, steps: int, *, one_buffer: bool = False) -> None:
        self._env, self._seed, self._steps, self._one_buffer = env, seed, steps, one_buffer
        self._actions = deepcopy(env.action_space)
        self._actions.seed(seed)
        self._buffer: Any = None
        self.trace = _Trace([], [])
        self._handed: list[tuple[str, Any, Any]] = []  # what it is, the thing, and what it was when it was handed out

    def play(self) -> _Trace:
        """Plays until there are steps and episodes enough."""
        for _ in self.steps():
            pass
        return self.trace

    def steps(self) -> Iterator[None]:
        """Plays the same, a step at a time."""
        episode = total = 0
        while total < self._steps or episode < _EPISODES:
            episode += 1
            observation, info = self._env.reset(seed=self._seed) if episode == 1 else self._env.reset()
            self._take(episode, 0, {"observation": observation, "info": info})
            for step in range(1, min(_LONGEST, self._steps) + 1):
                values = dict(zip(_FIELDS, self._env.step(self._action(episode, step)), strict=True))
                self._checked_action(episode, step)
                self._take(episode, step, values)
                total += 1
                yield
                if values["terminated"] or values["truncated"]:
                    break
        self._look(self._handed)

    def _action(self, episode: int, step: int) -> Any:
        action = self._actions.sample()
        if self._one_buffer and isinstance(action, np.ndarray):
            self._buffer = action if self._buffer is None else self._buffer
            self._buffer[...] = action
            action = self._buffer
        self._given = action, _bits(action)
        return action

    def _checked_action(self, episode: int, step: int) -> None:
        action, bits = self._given
        if _bits(action) != bits:
            self._blame(f"episode {episode}, step {step}: the action was changed by the step that it was given to")

    def _take(self, episode: int, step: int, values: dict[str, Any]) -> None:
        where = f"episode {episode}, {_place(step)}"
        self._look(self._handed[-_AGO:])
        for name in ("observation", "info"):
            for what, before, _ in self._handed[-_AGO:]:
                if _shares(before, values[name]):
                    self._blame(f"{where}: {name} is in the memory of {what}, which was handed out before")
        bits = {name: _bits(value) for name, value in values.items()}
        self._handed += [(f"{name} of {where}", values[name], bits[name]) for name in ("observation", "info")]
        self.trace.calls.append(_Call(episode, step, bits))

    def _look(self, handed: Sequence[tuple[str, Any, Any]]) -> None:
        """Looks at what was handed out: it is the caller's, and must be as it was."""
        for what, thing, bits in handed:
            if _bits(thing) != bits:
                self._blame(f"the {what} was changed after it had been handed out")

    def _blame(self, problem: str) -> None:
        if not self.trace.problems:  # all that follows has the same reason
            self.trace.problems.append(problem)


def _place(step: int) -> str:
    return f"step {step}" if step else "reset"


def _shares(before: Any, now: Any) -> bool:
    if isinstance(before, np.ndarray) and isinstance(now, np.ndarray):
        return bool(np.shares_memory(before, now))
    if isinstance(before, dict) and isinstance(now, dict):
        return before is now or any(_shares(before[key], now[key]) for key in before.keys() & now.keys())
    if isinstance(before, tuple | list) and isinstance(now, tuple | list):
        return (before is now and before != ()) or any(map(_shares, before, now))
    return False


def _bits(value: Any) -> Any:
    """Returns a value as what can be compared exactly, and sent to another process."""
    if isinstance(value, np.ndarray) and value.dtype != object:
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, np.generic):
        return type(value).__name__, value.tobytes()
    if isinstance(value, dict):
        return [(_bits(key), _bits(item)) for key, item in value.items()]
    if isinstance(value, tuple | list | np.ndarray):
        return [type(value).__name__, *map(_bits, value)]
    if isinstance(value, float):
        return value.hex()
    if value is None or isinstance(value, bool | int | str | bytes):
        return value
    shown = repr(value)
    return type(value).__qualname__, "" if " at 0x" in shown else shown


# -- comparing --------------------------------------------------------------------------------------------------------


class _Findings:
    """What differs from a first run."""

    def __init__(self, reference: _Trace) -> None:
        self._reference = reference
        self.problems = list(reference.problems)

    def compare(self, other: _Trace, how: str) -> None:
        """Compares another run, and tells where it differs first."""
        self.problems += [f"{how}: {problem}" for problem in other.problems]
        for here, there in zip(self._reference.calls, other.calls, strict=False):
            differing = [name for name in here.fields if here.fields[name] != there.fields.get(name)]
            if differing:
                fields = ", ".join(_named(name, here.fields[name], there.fields.get(name)) for name in differing)
                self.problems.append(f"{how}: episode {here.episode}, {_place(here.step)}: {fields} differs")
                return
        if len(self._reference.calls) != len(other.calls):
            self.problems.append(
                f"{how}: there are {len(other.calls)} calls, and there were {len(self._reference.calls)}"
            )


def _named(name: str, here: Any, there: Any) -> str:
    """Returns the name of a field that differs, with the places in it, or the keys, that do."""
    if name == "info" and isinstance(here, list) and isinstance(there, list):
        mine, yours = ({str(key): value for key, value in items} for items in (here, there))
        keys = [key for key in mine | yours if mine.get(key) != yours.get(key)]
        return f"info[{', '.join(map(repr, keys))}]" if keys else "the order of info"
    if isinstance(here, tuple) and len(here) == 3 and isinstance(there, tuple) and here[:2] == there[:2]:
        places = np.flatnonzero(_bytes(here) != _bytes(there))
        size = np.dtype(here[0]).itemsize
        shown = list(dict.fromkeys((places // size).tolist()))
        return f"{name}[{', '.join(map(str, shown[:3]))}{', ...' if len(shown) > 3 else ''}]"
    return name


def _bytes(bits: tuple[str, tuple[int, ...], bytes]) -> Any:
    return np.frombuffer(bits[2], np.uint8)


# -- runs that should not differ --------------------------------------------------------------------------------------


def _again(env: Environment, steps: int) -> _Findings:
    """Plays twice in the same environment, with everything else changed that should not matter."""
    with _generators() as used:
        findings = _Findings(_Player(env, _SEED, steps).play())
        findings.problems += [f"the global generator of {name} is used" for name in used()]
        findings.problems += _restarted(env)
        if findings.problems:
            return findings
        other = _Player(env, _OTHER_SEED, steps // 4).play()
        findings.problems += other.problems
        random.seed(_OTHER_SEED)
        np.random.seed(_OTHER_SEED)
        with _another_clock():
            findings.compare(_Player(env, _SEED, steps, one_buffer=True).play(), "again, after other episodes")
    return findings


@contextmanager
def _generators() -> Iterator[Callable[[], list[str]]]:
    """Keeps the states of the global generators; gives what tells which were used since."""
    before = random.getstate(), np.random.get_state()

    def used() -> list[str]:
        now = random.getstate(), np.random.get_state()
        return [
            name for name, a, b in zip(("random", "numpy.random"), before, now, strict=True) if _state(a) != _state(b)
        ]

    try:
        yield used
    finally:
        random.setstate(before[0])
        np.random.set_state(before[1])


def _state(state: Any) -> Any:
    return _bits(tuple(state))


@contextmanager
def _another_clock() -> Iterator[None]:
    """Sets the clocks of Python's module `time` forward."""
    clocks = {name: getattr(time, name) for name in (*_CLOCKS, *(f"{clock}_ns" for clock in _CLOCKS))}
    for name, clock in clocks.items():
        shift = int(_SHIFT * 1e9) if name.endswith("_ns") else _SHIFT
        setattr(time, name, lambda clock=clock, shift=shift: clock() + shift)
    try:
        yield
    finally:
        for name, clock in clocks.items():
            setattr(time, name, clock)


def _restarted(env: Environment) -> list[str]:
    """Finds a reset without a seed that begins the stream of random numbers anew."""
    states = []
    for reset in (partial(env.reset, seed=_SEED), env.reset):
        reset()
        states.append(_bits(env.unwrapped.np_random.bit_generator.state))
    fresh = _bits(gymnasium.utils.seeding.np_random(_SEED)[0].bit_generator.state)
    if states[0] == states[1] != fresh:
        return ["reset without a seed begins the random numbers of the seed anew, where it should go on with them"]
    return []


def _in_a_thread(source: Source, first: Environment, steps: int) -> _Trace:
    """Plays in another environment, in another thread, while the first one plays something else."""
    players: list[_Player] = []
    failures: list[BaseException] = []

    def play() -> None:
        try:
            env = _make(source)
            players.append(_Player(env, _SEED, steps))
            beside = _Player(first, _OTHER_SEED, steps).steps()
            for _ in players[0].steps():
                next(beside, None)
            env.close()
        except BaseException as error:  # it is raised where somebody sees it
            failures.append(error)

    thread = threading.Thread(target=play)
    thread.start()
    thread.join()
    if failures:
        raise failures[0]
    return players[0].trace


def _in_a_process(source: Source, steps: int) -> _Trace | None:
    """Plays in another process, with another hash seed; None where the environment cannot be made there."""
    try:
        asked = pickle.dumps((sys.path, pickle.dumps(source), steps))
    except (pickle.PicklingError, AttributeError, TypeError):  # a lambda, or what is defined in a function
        return None
    if getattr(source, "__module__", "") == "__main__":
        return None
    other = next(seed for seed in _HASH_SEEDS if seed != os.environ.get("PYTHONHASHSEED"))
    settings = {**os.environ, "PYTHONHASHSEED": other}
    done = subprocess.run(
        [sys.executable, "-P", "-c", _CHILD], input=asked, capture_output=True, env=settings, check=False
    )
    if done.returncode:
        raise NotDeterministic([f"in another process: it fails: {done.stderr.decode(errors='replace').strip()[-400:]}"])
    trace: _Trace = pickle.loads(done.stdout)
    return trace


def _answer() -> None:
    """Plays what standard input asks for; what was played goes to standard output."""
    path, source, steps = pickle.loads(sys.stdin.buffer.read())
    sys.path[:] = path
    out, sys.stdout = sys.stdout.buffer, sys.stderr  # what environments print is no answer
    trace = _Player(_make(pickle.loads(source)), _SEED, steps).play()
    out.write(pickle.dumps(trace))
    out.flush()
