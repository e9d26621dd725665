"""The worker of a world: short work is done in the event loop, long work in a thread of the host's pool.

It hides how long work will take, which is guessed: of ticks from the processor's time that they took before, of all
else from what the world says. So the clock decides where work is done, and never what comes of it.

Invariants:

- A world is touched by one thread at a time.
- Nobody waits for long: ticks run in slices of `SLICE` s, then others have their turn, in the loop and in the pool.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import threading
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from time import monotonic, thread_time
from typing import Any, Protocol, TypeAlias, TypeVar

from nmes.protocol import Request
from nmes.world import World
from nmes.world.costs import BUILDING

__all__ = ["LONG_COMMANDS", "SLICE", "Tell", "Worker", "WorkerPool"]

SLICE = 0.005  # s: how long one world's commands or its ticks may keep the others waiting
BRIEF = 0.0005  # s: what is not worth the way to another thread and back
# s: of a tick that takes less, nearly all is Python. In threads such worlds only wait for its lock, and to pass that on
# takes longer than their ticks: they would fall ever further behind.
LIGHT = 1.5e-4
THREADS = 1000  # worlds that can be in a thread; no more of them run at once than there are cores

_TICK = 1e-4  # s: what a tick is taken to cost before one was measured
_SAVED = 2e-5  # s a cube: what it costs at a tick where the world is saved

LONG_COMMANDS = frozenset(  # those that may take long: of these the world is asked what they cost
    {
        "adopt",
        "batch",
        "despawn_cube",
        "get_camera",
        "get_cube_info",
        "get_cube_list",
        "get_joint_list",
        "get_joints_for_cube",
        "get_life",
        "get_planets",
        "get_world_info",
        "get_world_state",
        "give",
        "grow",
        "hear",
        "link_body_cubes",
        "link_cube_chains",
        "reset",
        "sense",
        "set_cube_state",
        "set_objective",
        "shed",
        "spawn_creature",
        "spawn_cube",
        "step",
    }
)

_TUNING = frozenset({"set_joint_param", "set_joint_params"})

Tell: TypeAlias = Callable[[Request, bytes], bytes]
"""Makes what is sent to a client of a request and the encoded reply to it."""

T = TypeVar("T")


class WorkerPool:
    """The threads for worlds with long work: as many run at once as there are cores, each in its turn.

    Attributes:
        last: Whose world ticked last: another one that comes now is not alone in having work.
    """

    def __init__(self) -> None:
        self.last: object = None
        self._pool = ThreadPoolExecutor(THREADS, "nmes-world")  # makes them when they are needed
        self._lock = threading.Lock()
        self._free = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        self._queue: deque[threading.Lock] = deque()  # of those that wait for their turn

    def run(self, work: Callable[[], T]) -> Future[T]:
        """Runs a function in a thread."""
        return self._pool.submit(self._in_turn, work)

    def _in_turn(self, work: Callable[[], T]) -> T:
        self._begin()
        try:
            return work()
        finally:
            self._end()

    def give_way(self) -> None:
        """Lets those that wait go first: called by what is running, now and then."""
        if self._queue:
            self._end()
            self._begin()

    def _begin(self) -> None:
        with self._lock:
            if self._free:
                self._free -= 1
                return
            turn = threading.Lock()
            turn.acquire()
            self._queue.append(turn)
        turn.acquire()

    def _end(self) -> None:
        with self._lock:
            if self._queue:
                self._queue.popleft().release()
            else:
                self._free += 1

    def close(self, wait: bool) -> None:
        """Ends the threads, when their work is done; waits for that or not."""
        self._pool.shutdown(wait)


class Owner(Protocol):
    """The hosted world of a worker, which is told where its world is."""

    def prepare_thread(self) -> bool:
        """Prepares for the world to go to a thread; returns whether it may."""

    def end_slice(self) -> None:
        """Sends events and flushes the recording, after a slice of ticks; called in the world's thread."""

    def take_back(self, finish: Callable[[], None]) -> None:
        """Goes on with a world that is back in the event loop; `finish` hands over the result of its work."""


class _Stopped(BaseException):
    """The host closes: what a world is doing ends in the middle, after a tick."""


class Worker:
    """Does the work of one world, in the event loop or in a thread of the pool.

    Attributes:
        away: Whether the world is in a thread. Then nobody else may touch it.
    """

    def __init__(self, world: World, pool: WorkerPool, owner: Owner) -> None:
        """Makes a worker whose world is in the event loop."""
        self.away = False
        self._world = world
        self._pool = pool
        self._owner = owner
        self._cost = _TICK  # s: what a tick has cost of late
        self._until = 0.0  # when the slice ends that runs in the thread
        self._stopping = False
        self._returned = asyncio.Event()  # set when the world came back last

    # -- how long it takes -----------------------------------------------------------------------------------------

    def takes_long(self, command: Mapping[str, Any]) -> bool:
        """Whether a command is to be executed in a thread."""
        return not self._is_short(self._expected(command))

    def _is_short(self, expected: float) -> bool:
        """Whether work that takes as long (s) as expected is done in the loop."""
        return expected <= (SLICE if self._pool.last is self else BRIEF)

    def _expected(self, command: Mapping[str, Any]) -> float:
        """Returns how long (s) a command will take, as far as one can tell."""
        kind = command["type"]
        if kind == "step":
            return self._ticks_cost(command.get("ticks", 1))
        cost = self._world.cost(command)
        if kind == "batch":
            inner = command["commands"]
            steps = [each.get("ticks", 1) for each in inner if each["type"] == "step"]
            if steps:
                # What the others build is taken up by the first tick. Most that agents send there are short.
                builds = any(map(self._builds, inner))
                cost += self._ticks_cost(sum(steps)) + (math.inf if builds else 0.0)
        return cost

    def _builds(self, command: Mapping[str, Any]) -> bool:
        """Whether the engine may have to build its model anew for a command, also since a motor comes or goes."""
        if command["type"] not in _TUNING:
            return command["type"] in BUILDING
        joint = self._world.entities.joints.get(command["joint_name"])
        names = command.get("params", (command.get("param_name"),))
        return joint is not None and ("motor_enabled" in names or not joint.params["motor_enabled"])

    def _ticks_cost(self, ticks: float) -> float:
        """Returns how long (s) ticks will take; the first one takes up what was edited."""
        world = self._world
        first = world.rebuild_cost + world.telling_cost(ticks) + len(world.entities.cubes) * _SAVED
        return ticks * self._cost + first + self._births_cost(ticks)

    def _births_cost(self, ticks: float) -> float:
        """Returns how much longer (s) ticks will take since creatures come, develop, die and are born in them."""
        life, development = self._world.life, self._world.all_creatures.development_cost(ticks)
        return development if life is None else development + life.cost(self._world.frame, ticks)

    def _measure(self, ticks: int, duration: float) -> None:
        """Learns at once that ticks have become longer, and by and by that they are shorter again."""
        self._pool.last = self
        if ticks > 0:
            tick = duration / ticks
            self._cost = max(tick, self._cost + (tick - self._cost) / 4)

    # -- the work --------------------------------------------------------------------------------------------------

    def execute(self, client: int, request: Request, tell: Tell) -> bytes:
        """Executes a request and measures its ticks, in the thread in which the world is; returns what `tell` does."""
        if request.type != "step":
            return tell(request, self._world.handle(client, request))
        start, frame = thread_time(), self._world.frame
        reply = self._world.handle(client, request)
        self._measure(self._world.frame - frame, thread_time() - start)
        return tell(request, reply)

    def advance(self, most: float, then: Callable[[int], None]) -> None:
        """Ticks for one slice, in the loop or in a thread.

        Args:
            most: The most ticks that are wanted; may be infinite.
            then: Called in the loop with the number of ticks, at once or when the world is back.
        """
        few = min(most, BRIEF // max(self._cost, 1e-6))
        if most < 1 or self._is_short(self._ticks_cost(most)):
            then(self._tick(most))
        elif most < math.inf and self._cost < LIGHT and self._is_short(self._ticks_cost(1) + self._births_cost(few)):
            then(self._tick(few))  # it is behind
        else:
            self.run(partial(self._tick, most), lambda ticks: then(ticks.result()))

    def _tick(self, most: float) -> int:
        """Ticks for one slice, in the thread in which the world is; returns the number of ticks."""
        world, until, start, ticks = self._world, monotonic() + SLICE, thread_time(), 0
        while ticks < most and world.fault is None:
            world.tick()
            ticks += 1
            if monotonic() >= until:
                break
        if ticks:
            self._measure(ticks, thread_time() - start)
        return ticks

    # -- in a thread -----------------------------------------------------------------------------------------------

    def run(self, work: Callable[[], T], then: Callable[[Future[T]], None]) -> bool:
        """Takes the world to a thread and does some work there; returns whether the owner let it go.

        Args:
            work: Called in the thread.
            then: Called in the loop with the result, when the world is back, unless its host closes.
        """
        if self._stopping or not self._owner.prepare_thread():
            return False
        self.away = True
        self._world.between = self._between
        self._until = monotonic() + SLICE
        self._returned.clear()
        loop = asyncio.get_running_loop()
        result = self._pool.run(work)
        result.add_done_callback(lambda result: loop.call_soon_threadsafe(self._return, then, result))
        return True

    def _between(self) -> None:
        """Lets others have their turn after a slice of ticks; called by the world after each tick, in its thread."""
        if self._stopping:
            raise _Stopped
        if monotonic() < self._until:
            return
        self._owner.end_slice()
        self._pool.give_way()
        self._until = monotonic() + SLICE

    def _return(self, then: Callable[[Future[T]], None], result: Future[T]) -> None:
        self.away, self._world.between = False, None
        self._returned.set()
        self._owner.take_back(partial(then, result))

    async def wait(self) -> None:
        """Returns when the world is back in the event loop."""
        await self._returned.wait()

    async def stop(self, patience: float) -> bool:
        """Ends what is done in a thread, after the tick it is at; returns whether the world came back in time (s)."""
        self._stopping = True
        if self.away:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(patience):
                    await self._returned.wait()
        return not self.away
