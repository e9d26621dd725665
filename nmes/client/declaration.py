"""The declaration of a command: a method whose parameters are the command's fields and whose return type is its reply.

It hides how a call becomes a message. A class that can send messages (`request`) gets each declared command as a method
that returns what `request` returns: the reply, an awaitable of it, or a `Pending`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Coroutine, Sequence
from typing import TYPE_CHECKING, Any, Concatenate, Generic, ParamSpec, Protocol, Self, TypeVar, cast, overload

from nmes.errors import CommandFailed

if TYPE_CHECKING:
    from nmes.client.commands import AsyncCommands, BlockingCommands, Pipeline

__all__ = ["Array", "Pending", "Vector", "command"]

P = ParamSpec("P")
R = TypeVar("R")


class Array(Protocol):
    """An array or a scalar of numpy, by the one method that is used of it."""

    def tolist(self) -> Any:
        """Returns the plain numbers."""


Vector = Sequence[float] | Array


class Pending(Generic[R]):
    """A command that was sent, and its reply once it has come."""

    def __init__(self, message: dict[str, Any]) -> None:
        self.message = message
        self._reply: dict[str, Any] | None = None
        self._error: Exception | None = None
        self._callback: Callable[[], None] | None = None

    @property
    def done(self) -> bool:
        """Whether the reply has come, or can come no more."""
        return self._reply is not None or self._error is not None

    def result(self) -> R:
        """Returns the reply.

        Raises:
            CommandFailed: The server refused the command.
            Disconnected: The connection was lost before the reply came.
            RuntimeError: The reply has not come yet.
        """
        if self._error is not None:
            raise self._error
        if self._reply is None:
            raise RuntimeError(f"the reply to {self.message.get('type')!r} has not come yet")
        return cast(R, self._reply)

    def resolve(self, reply: dict[str, Any]) -> None:
        """Takes the server's reply, which may be an error."""
        if reply.get("type") == "error":
            self.fail(CommandFailed(str(reply.get("code")), str(reply.get("message")), reply.get("field")))
        else:
            self._reply = reply
            if self._callback is not None:
                self._callback()

    def fail(self, error: Exception) -> None:
        """Ends the wait for a reply with an error, for `result` to raise."""
        self._error = error
        if self._callback is not None:
            self._callback()

    def when_done(self, callback: Callable[[], None]) -> None:
        """Calls `callback` once the reply has come, or can come no more."""
        self._callback = callback
        if self.done:
            callback()


class command(Generic[P, R]):
    """Declares a command: the function's name is its type, the parameters its fields, the return type its reply."""

    def __init__(self, declaration: Callable[Concatenate[Any, P], type[R]]) -> None:
        self._declaration = declaration
        self._type = declaration.__name__
        code = declaration.__code__
        self._positional = code.co_varnames[1 : code.co_argcount]
        self.__doc__ = declaration.__doc__
        self.__wrapped__ = declaration

    @overload
    def __get__(self, client: None, owner: type) -> Self: ...
    @overload
    def __get__(self, client: BlockingCommands, owner: type) -> Callable[P, R]: ...
    @overload
    def __get__(self, client: AsyncCommands, owner: type) -> Callable[P, Coroutine[Any, Any, R]]: ...
    @overload
    def __get__(self, client: Pipeline, owner: type) -> Callable[P, Pending[R]]: ...
    def __get__(self, client: BlockingCommands | AsyncCommands | Pipeline | None, owner: type) -> object:
        if client is None:
            return self

        @functools.wraps(self._declaration)
        def send(*args: P.args, **kwargs: P.kwargs) -> object:
            self._declaration(client, *args, **kwargs)  # says what is wrong with the arguments, as any function would
            message: dict[str, Any] = {"type": self._type}
            for name, value in (*zip(self._positional, args, strict=False), *kwargs.items()):
                if value is not None:
                    message[name] = value
            return client.request(message)

        return send
