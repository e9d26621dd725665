"""Servers that are wrong about time or subscriptions. See `defects`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from pytest import MonkeyPatch

from defects import Answer, JsonObject, around, defect
from nmes.server.barrier import StepBarrier
from nmes.server.clock import Clock
from nmes.server.hosted_world import HostedWorld
from nmes.world import World
from nmes.world.clients import Client, Clients
from nmes.world.subscription import Subscription

# -- time -------------------------------------------------------------------------------------------------------------


@defect("10.12", "10.14", mode="realtime")
def a_pause_that_is_none(patch: MonkeyPatch) -> None:
    """It lets the time run while it says that it is paused."""
    patch.setattr(World, "running", property(lambda world: world.mode != "lockstep" and world.fault is None))


@defect("10.8", "10.3")
def lockstep_that_runs(patch: MonkeyPatch) -> None:
    """It ticks by itself in lockstep."""
    patch.setattr(World, "running", property(lambda world: not world.paused and world.fault is None))


@defect("10.4")
def answers_before_it_steps(patch: MonkeyPatch) -> None:
    """It tells the frame and the time from before a step."""

    def early(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        frame, time = world.frame, world.time
        return {**answer(world, client, command), "frame": frame, "t": time}

    around(patch, "step", early)


@defect("10.7", mode="realtime")
def steps_in_realtime(patch: MonkeyPatch) -> None:
    """It steps a world that ticks by itself."""

    def force(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        paused, world.paused = world.paused, True
        try:
            return answer(world, client, command)
        finally:
            world.paused = paused

    around(patch, "step", force)


@defect("10.2", "10.1:1")
def two_ticks_a_step(patch: MonkeyPatch) -> None:
    """It ticks once more than it is told to."""
    around(
        patch,
        "step",
        lambda answer, world, client, command: answer(world, client, {**command, "ticks": command.get("ticks", 1) + 1}),
    )


@defect("10.10", mode="realtime")
def the_rate_ignored(patch: MonkeyPatch) -> None:
    """It tells the rate that it was given, and goes as before."""
    patch.setattr(Clock, "_speed", property(lambda clock: float(clock._world.config["tick_rate"])))


@defect("10.1:60")
def time_in_milliseconds(patch: MonkeyPatch) -> None:
    """It tells the time in milliseconds."""
    patch.setattr(World, "time", property(lambda world: 1000.0 * world.frame / world._tick_rate))


@defect("10.16", "10.17")
def a_barrier_that_does_not_wait(patch: MonkeyPatch) -> None:
    """It ticks at a barrier as soon as anybody says step."""
    patch.setattr(
        StepBarrier, "_complete", lambda barrier: barrier._world.barrier is not None and bool(barrier.waiting)
    )


@defect("10.20")
def a_barrier_waits_for_the_gone(patch: MonkeyPatch) -> None:
    """It goes on waiting at a barrier for a connection that has left."""

    def remember(barrier: StepBarrier, client: int) -> None:
        barrier._released.discard(client)
        barrier.waiting.pop(client, None)

    patch.setattr(StepBarrier, "forget", remember)


@defect("10.18")
def a_barrier_waits_for_ever(patch: MonkeyPatch) -> None:
    """It goes on waiting at a barrier for those who do not come."""
    patch.setattr(HostedWorld, "_pass_over_late", lambda hosted: None)


@defect("10.11", only_strict=True)
def fast_is_realtime(patch: MonkeyPatch) -> None:
    """It goes no faster than the clock in mode fast."""
    turn = HostedWorld._turn

    def slow(hosted: HostedWorld) -> None:
        mode = hosted.world.mode
        hosted.world.mode = "realtime" if mode == "fast" else mode
        try:
            turn(hosted)
        finally:
            hosted.world.mode = mode

    patch.setattr(HostedWorld, "_turn", slow)


@defect("10.9", mode="realtime")
def twice_as_fast_as_the_clock(patch: MonkeyPatch) -> None:
    """It ticks twice as often in realtime as it should."""
    patch.setattr(Clock, "_speed", property(lambda clock: 2.0 * clock._world.rate * clock._world._tick_rate))


@defect("10.21")
def steps_in_batches_at_a_barrier(patch: MonkeyPatch) -> None:
    """It takes a step in a batch at a barrier for done."""

    def let_in(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        world.in_batch = False
        return answer(world, client, command)

    around(patch, "step", let_in)


@defect("10.13", mode="realtime")
def no_steps_in_a_pause(patch: MonkeyPatch) -> None:
    """It ticks no further in a pause, though told to step."""

    def stay(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        if world.paused:
            return {"type": "stepped", "frame": world.frame, "t": world.time}
        return answer(world, client, command)

    around(patch, "step", stay)


# -- subscriptions ----------------------------------------------------------------------------------------------------


def _events(patch: MonkeyPatch, change: Callable[[Client, Clients], None]) -> None:
    """Has a world's clients changed before each tick's events."""
    tick = Clients.tick

    def changed(clients: Clients, *arguments: Any) -> None:
        for client in clients.values():
            change(client, clients)
        tick(clients, *arguments)

    patch.setattr(Clients, "tick", changed)


@defect("11.3")
def subscriptions_leak(patch: MonkeyPatch) -> None:
    """It tells events to all as soon as one has subscribed."""

    def leak(client: Client, clients: Clients) -> None:
        if client.subscription is None:
            client.subscription = next(
                (other.subscription for other in clients.values() if other.subscription is not None), None
            )

    _events(patch, leak)


@defect("11.10")
def nothing_is_removed(patch: MonkeyPatch) -> None:
    """It does not tell subscribers that a cube is gone."""
    changes = Subscription.changes
    patch.setattr(Subscription, "changes", lambda subscription, *arguments: (changes(subscription, *arguments)[0], []))


@defect("11.2:2", "11.2:10")
def every_tick_told(patch: MonkeyPatch) -> None:
    """It tells every tick, though asked for every so many."""

    def each(client: Client, clients: Clients) -> None:
        if client.subscription is not None:
            client.subscription.every = 1

    _events(patch, each)


@defect("11.4")
def no_way_out_of_a_subscription(patch: MonkeyPatch) -> None:
    """It goes on telling those who unsubscribed."""
    around(patch, "unsubscribe", lambda answer, world, client, command: {"type": "unsubscribed"})


@defect("11.8", "11.9")
def moved_since_the_last_tick(patch: MonkeyPatch) -> None:
    """It compares a cube with where it was a tick ago, not with what it told last, and so never tells a slow one."""
    changes = Subscription.changes

    def forgetful(subscription: Subscription, version: int, names: list[str], states: Any) -> Any:
        result = changes(subscription, version, names, states)
        subscription._sent[:] = states[:, :7]
        return result

    patch.setattr(Subscription, "changes", forgetful)


@defect("11.7")
def all_cubes_in_every_state(patch: MonkeyPatch) -> None:
    """It tells of all cubes every time, also of those that do not move."""

    def forget(client: Client, clients: Clients) -> None:
        if client.subscription is not None:
            client.subscription._sent[:] = np.nan

    _events(patch, forget)


@defect("11.5")
def subscribed_twice_told_twice(patch: MonkeyPatch) -> None:
    """It tells those twice who subscribed twice."""
    times: dict[int, int] = {}
    tick = Clients.tick

    def count(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        times[client.number] = times.get(client.number, 0) + 1
        return answer(world, client, command)

    def repeat(clients: Clients, emit: Any, *arguments: Any) -> None:
        def again(client: int, event: bytes) -> None:
            for _ in range(times.get(client, 1)):
                emit(client, event)

        tick(clients, again, *arguments)

    around(patch, "subscribe", count)
    patch.setattr(Clients, "tick", repeat)


@defect("11.1")
def a_tick_lost(patch: MonkeyPatch) -> None:
    """It tells all ticks but each third."""
    tick = Clients.tick

    def lose(clients: Clients, emit: Any, frame: int, *arguments: Any) -> None:
        if frame % 3:
            tick(clients, emit, frame, *arguments)

    patch.setattr(Clients, "tick", lose)
