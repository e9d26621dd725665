"""The worker processes of a supervisor: started, chosen by load, noticed when they end, and started again.

It hides processes and their lines. Invariants: one is gone from when its line ends, and it is `ended` only when its
process is: until then nobody may have what it had. Worlds that clients wait for come before all others.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from nmes.errors import MachineError, WorldError
from nmes.fleet.control import Line, LineEnded, Message

if TYPE_CHECKING:
    from nmes.fleet.visitor import Visitor

__all__ = ["WorkerProcess", "WorkerProcesses"]

logger = logging.getLogger(__name__)

START = 60.0  # s: how long a worker may take to start
AT_ONCE = 2  # worlds that a worker brings up at the same time
LAST = 1.0  # s: how long one may take to end whose line has ended
PATIENCE = 15.0  # s: how long workers may take to close
WATCH = 1.0  # s: how often it is looked whether workers say anything
SILENT = 30  # such looks in a row without a word, after which one hangs: it tells of its worlds twice a second
RETRY = (0.5, 30.0)  # s: after which one is started again that did not start: at first, and at most
UNEVEN = 4  # awake worlds that one has more than another, half of its own at least, from which on worlds are moved


class WorkerProcess:
    """A worker as its supervisor sees it.

    Attributes:
        number: Its place among the workers; the one that is started in its stead has the same.
        port: Its own port.
        draining: Whether it was told to end, and gives its worlds away.
        gone: Whether it has ended, or is about to.
        ended: Set when its process is no more.
        awake: The worlds there that take time, with the numbers of their clients, as it told last.
        hosting: How many worlds are being brought up there.
        visitors: The connections that were handed to it, by number.
        silent: How often in a row it was looked and it had said nothing.
    """

    line: Line
    port = 0

    def __init__(self, number: int, process: asyncio.subprocess.Process) -> None:
        self.number = number
        self.process = process
        self.draining = self.gone = self.ready = False
        self.ended = asyncio.Event()
        self.awake: dict[str, int] = {}
        self.hosting = 0
        self.visitors: dict[int, Visitor] = {}
        self.silent = 0

    @property
    def load(self) -> int:
        """How many worlds take time there, or are about to."""
        return len(self.awake) + self.hosting

    @property
    def takes(self) -> bool:
        """Whether it takes worlds."""
        return self.ready and not self.draining and not self.gone

    async def close(self) -> list[tuple[str, str]]:
        """Has it close its worlds and end; returns those whose recordings are not whole, and why.

        Raises:
            LineEnded: It has ended before it said so.
        """
        return [(name, why) for name, why in (await self.line.ask("close")).body["lost"]]


class WorkerProcesses:
    """The workers, as many as there are to be.

    Args:
        command: What starts one; the number of its end of the line is added.
        begin: What each is told first.
        hear: Called with what one says of itself.
        lost: Called when one is gone.
    """

    def __init__(
        self,
        command: Sequence[str],
        begin: Mapping[str, Any],
        hear: Callable[[WorkerProcess, Message], None],
        lost: Callable[[WorkerProcess], None],
    ) -> None:
        self._command, self._begin, self._hear, self._lost = command, begin, hear, lost
        self._slots: dict[int, WorkerProcess] = {}
        self._alive: dict[WorkerProcess, None] = {}  # these, and those that drain
        self._urgent: dict[str, asyncio.Future[WorkerProcess]] = {}  # worlds that wait for a worker
        self._others: dict[str, asyncio.Future[WorkerProcess]] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._closing = False
        self.restarts = 0

    @property
    def running(self) -> list[WorkerProcess]:
        """Those that have started and are not gone, by number."""
        return [worker for _, worker in sorted(self._slots.items()) if worker.ready and not worker.gone]

    # -- processes -------------------------------------------------------------------------------------------------

    async def start(self, count: int) -> None:
        """Starts all.

        Raises:
            MachineError: One does not start (`worker_failed`).
        """
        starting = (self._start(number) for number in range(1, count + 1))
        for outcome in await asyncio.gather(*starting, return_exceptions=True):
            if outcome is not None:
                raise outcome
        self._spawn(self._watch())

    async def _watch(self) -> None:
        """Ends workers that hang, so that others have their worlds.

        What one has said while this process itself was held up is heard before the next look: it is looks that count.
        """
        while True:
            await asyncio.sleep(WATCH)
            for worker in list(self._alive):
                worker.silent += 1
                if worker.silent == SILENT and worker.ready and not worker.gone:
                    logger.error("worker %d says nothing any more, and is ended", worker.number)
                    worker.process.kill()

    async def _start(self, number: int) -> None:
        try:
            ours, process = await self._spawn_process()
        except OSError as error:
            raise MachineError("worker_failed", f"worker {number} cannot be started: {error.strerror}") from error
        worker = self._slots[number] = WorkerProcess(number, process)
        self._alive[worker] = None
        worker.line = Line(ours, lambda message: self._listen(worker, message), lambda: self._end(worker))
        try:
            async with asyncio.timeout(START):
                told = (await worker.line.ask("begin", **self._begin)).body
        except (LineEnded, TimeoutError) as error:
            await self._bury(worker)
            late = isinstance(error, TimeoutError)
            how = f"it took over {START:g} s" if late else f"it ended with status {process.returncode}"
            raise MachineError("worker_failed", f"worker {number} did not start: {how}; see the log") from error
        if "error" in told:
            await self._bury(worker)
            raise MachineError("worker_failed", f"worker {number} did not start: {told['error']}")
        worker.port, worker.ready = told["port"], True
        self._dispatch()

    async def _spawn_process(self) -> tuple[socket.socket, asyncio.subprocess.Process]:
        """Starts a process; returns our end of the line to it, and the process.

        Raises:
            OSError: The system has no room for it.
        """
        ours, theirs = socket.socketpair()
        with theirs:
            try:
                process = await asyncio.create_subprocess_exec(
                    *self._command,
                    str(theirs.fileno()),
                    pass_fds=[theirs.fileno()],
                    stdin=asyncio.subprocess.DEVNULL,
                    stdout=asyncio.subprocess.DEVNULL,
                    start_new_session=True,  # signals of a terminal are for the supervisor
                )
            except OSError:
                ours.close()
                raise
        return ours, process

    def _listen(self, worker: WorkerProcess, message: Message) -> None:
        worker.silent = 0
        self._hear(worker, message)

    async def _start_again(self, number: int) -> None:
        delay, most = RETRY
        while not self._closing:
            try:
                await self._start(number)
            except MachineError as error:
                logger.error("%s; it is tried again in %g s", error.message, delay)
                self._give_up_waiting()
                await asyncio.sleep(delay)
                delay = min(2 * delay, most)
            else:
                self.restarts += 1
                logger.warning("worker %d was started again", number)
                return

    def _end(self, worker: WorkerProcess) -> None:
        """Notes that a worker is gone; called when its line has ended."""
        worker.gone = True
        if self._closing or not worker.ready:
            self._spawn(self._bury(worker))
            return
        if not worker.draining:
            logger.error("worker %d has ended; its worlds go to others, and it is started again", worker.number)
        self._spawn(self._bury(worker))
        self._lost(worker)
        if not worker.draining:
            self._spawn(self._start_again(worker.number))

    async def _bury(self, worker: WorkerProcess) -> None:
        """Sees to it that the process of a worker is no more."""
        worker.gone = True
        worker.line.close()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(LAST):
                await worker.process.wait()
        if worker.process.returncode is None:
            worker.process.kill()
            await worker.process.wait()
        worker.ended.set()
        self._alive.pop(worker, None)

    def replace(self, worker: WorkerProcess) -> None:
        """Starts another in the place of one that drains."""
        worker.draining = True
        self._spawn(self._start_again(worker.number))

    async def close(self) -> list[tuple[str, str]]:
        """Has all complete their recordings and end; returns the worlds whose recordings are not whole, and why."""
        self._closing = True
        lost: list[tuple[str, str]] = []

        async def end(worker: WorkerProcess) -> None:
            if worker.ready and not worker.gone:
                with contextlib.suppress(LineEnded, TimeoutError):
                    async with asyncio.timeout(PATIENCE):
                        lost.extend(await worker.close())
            worker.line.close()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(PATIENCE):
                    await worker.process.wait()
            await self._bury(worker)

        await asyncio.gather(*(end(worker) for worker in self._alive))
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        return sorted(lost)

    def _spawn(self, work: Any) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    # -- which one has room ----------------------------------------------------------------------------------------

    async def reserve(self, world: str, urgent: bool) -> WorkerProcess:
        """Returns the worker that has the least to do, as soon as one may bring up a world; `free` it then.

        Raises:
            WorldError: No worker runs, and none can be started (`world_unavailable`).
        """
        queue = self._urgent if urgent else self._others
        turn: asyncio.Future[WorkerProcess] = asyncio.get_running_loop().create_future()
        queue[world] = turn
        self._dispatch()
        return await turn

    def hurry(self, world: str) -> None:
        """Puts a world that waits for a worker before those for which no client waits."""
        if world in self._others:
            self._urgent[world] = self._others.pop(world)

    def free(self, worker: WorkerProcess) -> None:
        """Notes that a world is up there, or cannot be."""
        worker.hosting -= 1
        self._dispatch()

    def _dispatch(self) -> None:
        while queue := self._urgent or self._others:
            free = [worker for worker in self._slots.values() if worker.takes and worker.hosting < AT_ONCE]
            if not free:
                return
            turn = queue.pop(next(iter(queue)))
            if not turn.done():
                worker = min(free, key=lambda worker: (worker.load, worker.number))
                worker.hosting += 1
                turn.set_result(worker)

    def _give_up_waiting(self) -> None:
        """Tells who waits for a worker where there is none at all."""
        if not self.running:
            error = WorldError("world_unavailable", "no worker process of this host runs; see the server's log")
            for turn in [*self._urgent.values(), *self._others.values()]:
                if not turn.done():
                    turn.set_exception(error)
            self._urgent.clear()
            self._others.clear()

    def uneven(self) -> tuple[WorkerProcess, int] | None:
        """Returns the worker that has too much to do, and how many worlds it should give away; None: there is none."""
        workers = [worker for worker in self._slots.values() if worker.takes]
        if len(workers) < 2:
            return None
        most = max(workers, key=lambda worker: (worker.load, worker.number))
        least = min(workers, key=lambda worker: (worker.load, worker.number))
        more = most.load - least.load
        return (most, more // 2) if more >= UNEVEN and 2 * more >= most.load else None
