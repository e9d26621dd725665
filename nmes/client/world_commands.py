"""Commands about a world as a whole: its state, its time, its events.

The docstrings of the methods are written by `make format` from the schemas (tools/client_docs.py).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from nmes.client.declaration import command
from nmes.client.replies import (
    BatchResult,
    Mode,
    ModeSet,
    Paused,
    Planets,
    Pong,
    Resumed,
    Stepped,
    Subscribed,
    Unsubscribed,
    WorldInfo,
    WorldReset,
    WorldState,
)

__all__ = ["WorldCommands"]


class WorldCommands:
    """Commands about a world as a whole."""

    @command
    def get_world_state(self, *, cubes: Sequence[str] | None = None, sensors: bool | None = None) -> type[WorldState]:
        """Reads the moving part of many cubes at one moment.

        Args:
            cubes: The cubes, at most 10,000 and each once, in the order in which they are wanted; all that there are,
                in order of creation, if left out.
            sensors: Whether to read each cube's contacts, accelerometer and gyro too. Default: False.

        Returns:
            WorldState: Many cubes at one moment.

        Raises:
            CommandFailed: The server refused it: `cube_not_found`, `invalid`, `not_allowed`, `unsupported` or
                `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return WorldState

    @command
    def get_world_info(self) -> type[WorldInfo]:
        """Reads what world this is and what it can do.

        Returns:
            WorldInfo: What world this is and what it can do.

        Raises:
            CommandFailed: The server refused it: `unsupported`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return WorldInfo

    @command
    def get_planets(self) -> type[Planets]:
        """Lists the planets of the world; there are none unless its scene has them.

        Returns:
            Planets: The planets of the world, capitalised as the deployed clients expect. In the raw dialect the object
                has one key a planet, its name, and a list of that planet alone.

        Raises:
            CommandFailed: The server refused it: `unsupported` or `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return Planets

    @command
    def reset(self, *, seed: int | None = None) -> type[WorldReset]:
        """Brings the world back to what it was when created: no cubes, frame 0, names as from the start.

        Mode, rate, clients and subscriptions stay.

        Args:
            seed: A new seed, from 0 to 9,223,372,036,854,775,807; the same as before if left out.

        Returns:
            WorldReset: The world is as it was created.

        Raises:
            CommandFailed: The server refused it: `invalid`, `not_allowed`, `unsupported` or `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return WorldReset

    @command
    def step(self, ticks: int | None = None) -> type[Stepped]:
        """Makes the world tick, in mode lockstep or while it is paused; the reply comes after the last tick.

        With the barrier of set_mode it waits for the others, and what its connection sends after it waits too.

        Args:
            ticks: How many ticks, from 1 to 10,000. Default: 1.

        Returns:
            Stepped: The world has ticked.

        Raises:
            CommandFailed: The server refused it: `invalid`, `not_allowed`, `unsupported`, `world_faulted` or
                `wrong_mode`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return Stepped

    @command
    def pause(self) -> type[Paused]:
        """Stops the world from ticking by itself.

        Returns:
            Paused: The world does not tick by itself.

        Raises:
            CommandFailed: The server refused it: `not_allowed`, `unsupported` or `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return Paused

    @command
    def resume(self) -> type[Resumed]:
        """Lets a paused world tick by itself again.

        Returns:
            Resumed: The world ticks by itself again.

        Raises:
            CommandFailed: The server refused it: `not_allowed`, `unsupported` or `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return Resumed

    @command
    def set_mode(
        self,
        mode: Mode,
        *,
        rate: float | None = None,
        barrier: bool | None = None,
        agents: int | None = None,
        timeout: float | None = None,
    ) -> type[ModeSet]:
        """Sets what makes the world tick.

        Args:
            mode: What makes the world tick: the clock (realtime), the command step (lockstep), or the host as fast as
                it can (fast).
            rate: Seconds of the world in one second of the clock, in mode realtime, from 0.001 to 1,000; as it is if
                left out.
            barrier: In mode lockstep: the world ticks when every controlling connection has said step. One controls
                once it has said step, until it leaves or a time-out passes it over. Off, unless each set_mode says it.
                Default: False.
            agents: With barrier: how many connections must control before the first tick, from 1 to 1,000. Default: 1.
            timeout: With barrier: how long, by the clock, a step waits for the others, in s from 0.001 to 3,600. Those
                that are late are told of by barrier_timeout, and no longer waited for. Default: 10.

        Returns:
            ModeSet: What makes the world tick.

        Raises:
            CommandFailed: The server refused it: `invalid`, `not_allowed`, `unsupported`, `world_faulted` or
                `wrong_mode`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return ModeSet

    @command
    def subscribe(
        self,
        *,
        events: Sequence[Literal["tick", "state", "life", "creatures"]] | None = None,
        every: int | None = None,
        position_threshold: float | None = None,
        rotation_threshold: float | None = None,
    ) -> type[Subscribed]:
        """Asks for events.

        A second subscribe replaces the first.

        Args:
            events: Which events: tick; state; of a world with life what happens in its ecosystem, whenever it does; and
                creatures, when one of them has lost or gained parts, or develops. Default: ['tick', 'state'].
            every: Only every so many ticks, from 1 to 1,000,000. Default: 1.
            position_threshold: How far a cube must have moved since it was last sent to be sent again, in m, from 0 to
                1,000,000. Default: 0.
            rotation_threshold: How far a cube must have turned since it was last sent to be sent again, in rad, from 0
                to 1,000. Default: 0.

        Returns:
            Subscribed: What the connection is subscribed to.

        Raises:
            CommandFailed: The server refused it: `invalid`, `not_allowed` or `unsupported`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return Subscribed

    @command
    def unsubscribe(self) -> type[Unsubscribed]:
        """Ends the events.

        Returns:
            Unsubscribed: No events from now on.

        Raises:
            CommandFailed: The server refused it: `unsupported`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return Unsubscribed

    @command
    def batch(self, commands: Sequence[Mapping[str, Any]]) -> type[BatchResult]:
        """Applies commands in order with nothing in between.

        One that fails does not undo the earlier, but a batch that holds an invalid command is refused as a whole. When
        the replies are over 8 MiB, the rest of the commands is not executed, and each answered with `limit_reached`.

        Args:
            commands: The commands, at most 10,000, with at most 10,000 ticks in all.

        Returns:
            BatchResult: What became of each command.

        Raises:
            CommandFailed: The server refused it: `invalid`, `unknown_type`, `unsupported` or `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return BatchResult

    @command
    def ping(self) -> type[Pong]:
        """Does nothing; keeps the connection open.

        Returns:
            Pong: The connection is alive.

        Raises:
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return Pong
