"""Orders and sockets between a supervisor and a worker: messages over a Unix socket.

It hides how messages are cut and queued. A message is JSON; bytes and a descriptor may go beside it. Invariants:
messages come in the order in which they were sent, whatever of them waits; a descriptor comes with its message, or not
at all; what was told is in the system's hands, and outlives the process that told it, once `drained`.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import struct
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import orjson

from nmes.errors import NmesError

__all__ = ["Line", "LineEnded", "Message"]

_HEAD = struct.Struct(">II")  # the lengths of the JSON and of the bytes beside it
_READ = 256 << 10
_RETRY = 0.01  # s: after which is tried again what the system has no room for


class LineEnded(NmesError):
    """The other process has ended, or is about to."""

    def __init__(self) -> None:
        super().__init__("worker_ended", "a worker process has ended")


class Message(NamedTuple):
    """What one side told the other.

    Attributes:
        body: The message; `order` says what it is, and `ask`, if it is there, that an answer is waited for.
        data: Bytes beside it.
        socket: A socket beside it; None: there is none, or the system had no descriptor left for it.
    """

    body: dict[str, Any]
    data: bytes
    socket: socket.socket | None

    def discard(self) -> None:
        """Closes the socket."""
        if self.socket is not None:
            self.socket.close()


class Line:
    """One end of the line between a supervisor and a worker, in the event loop's thread.

    Args:
        end: One of a pair of Unix sockets, which is the line's from now on.
        hear: Called with each message that is no answer.
        ended: Called once, when the other side is gone.
    """

    def __init__(self, end: socket.socket, hear: Callable[[Message], None], ended: Callable[[], None]) -> None:
        end.setblocking(False)
        self._end, self._hear, self._ended = end, hear, ended
        self._loop = asyncio.get_running_loop()
        self._received = bytearray()
        self._sockets: deque[socket.socket | None] = deque()  # that came, for messages that are not complete yet
        self._unsent: deque[tuple[memoryview, int | None]] = deque()
        self._drained = asyncio.Event()
        self._drained.set()
        self._answers: dict[int, asyncio.Future[Message]] = {}
        self._asked = 0
        self._open = True
        self._loop.add_reader(end, self._read)

    # -- out -------------------------------------------------------------------------------------------------------

    def tell(self, order: str, *, data: bytes = b"", descriptor: int | None = None, **fields: Any) -> None:
        """Sends a message; the descriptor stays the caller's too. Once the other side is gone, does nothing."""
        if not self._open:
            return
        body = orjson.dumps({"order": order, "with_socket": descriptor is not None, **fields})
        copy = None if descriptor is None else os.dup(descriptor)
        self._unsent.append((memoryview(_HEAD.pack(len(body), len(data)) + body + data), copy))
        self._drained.clear()
        if len(self._unsent) == 1:
            self._write()

    async def ask(self, order: str, **fields: Any) -> Message:
        """Sends a message and returns the answer.

        Raises:
            LineEnded: The other side is gone, or goes before it answers.
        """
        if not self._open:
            raise LineEnded
        self._asked += 1
        answer: asyncio.Future[Message] = self._loop.create_future()
        self._answers[self._asked] = answer
        self.tell(order, ask=self._asked, **fields)
        return await answer

    def answer(self, question: Message, *, data: bytes = b"", **fields: Any) -> None:
        """Answers a message for which an answer is waited."""
        self.tell("answer", data=data, to=question.body["ask"], **fields)

    def _write(self) -> None:
        while self._unsent:
            data, descriptor = self._unsent[0]
            try:
                beside = [] if descriptor is None else [descriptor]
                sent = socket.send_fds(self._end, [data], beside) if beside else self._end.send(data)
            except (BlockingIOError, InterruptedError):
                self._loop.add_writer(self._end, self._write)
                return
            except (BrokenPipeError, ConnectionError):
                self.close()
                self._ended()
                return
            except OSError:  # too many descriptors are on their way: some will have been taken soon
                self._loop.remove_writer(self._end)
                self._loop.call_later(_RETRY, self._write_again)
                return
            if descriptor is not None:  # it went with the first byte
                os.close(descriptor)
            if sent < len(data):
                self._unsent[0] = (data[sent:], None)
            else:
                self._unsent.popleft()
        self._loop.remove_writer(self._end)
        self._drained.set()

    def _write_again(self) -> None:
        if self._open:
            self._write()

    async def drained(self) -> None:
        """Returns when all that was told is in the system's hands, or the other side is gone."""
        await self._drained.wait()

    # -- in --------------------------------------------------------------------------------------------------------

    def _read(self) -> None:
        try:
            data, descriptors, flags, _ = socket.recv_fds(self._end, _READ, 1)
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            data, descriptors, flags = b"", [], 0
        self._sockets += [socket.socket(fileno=each) for each in descriptors]
        if flags & socket.MSG_CTRUNC and not descriptors:
            self._sockets.append(None)
        if not data:
            self.close()
            self._ended()
            return
        self._received += data
        for message in self._complete():
            if message.body["order"] == "answer":
                answer = self._answers.pop(message.body["to"], None)
                if answer is not None and not answer.done():
                    answer.set_result(message)
            else:
                self._hear(message)

    def _complete(self) -> list[Message]:
        """Takes out the messages that are complete."""
        messages, start, received = [], 0, self._received
        while len(received) - start >= _HEAD.size:
            length, beside = _HEAD.unpack_from(received, start)
            middle = start + _HEAD.size + length
            if len(received) < middle + beside:
                break
            body = orjson.loads(received[start + _HEAD.size : middle])
            taken = self._sockets.popleft() if body["with_socket"] else None
            messages.append(Message(body, bytes(received[middle : middle + beside]), taken))
            start = middle + beside
        del received[:start]
        return messages

    def close(self) -> None:
        """Ends the line: who waits for an answer gets LineEnded."""
        if not self._open:
            return
        self._open = False
        self._loop.remove_reader(self._end)
        self._loop.remove_writer(self._end)
        self._end.close()
        for _, descriptor in self._unsent:
            if descriptor is not None:
                os.close(descriptor)
        self._unsent.clear()
        self._drained.set()
        for each in self._sockets:
            if each is not None:
                with contextlib.suppress(OSError):
                    each.close()
        self._sockets.clear()
        answers, self._answers = self._answers, {}
        for answer in answers.values():
            if not answer.done():
                answer.set_exception(LineEnded())
