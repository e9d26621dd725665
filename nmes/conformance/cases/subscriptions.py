"""Subscriptions: who gets which events, and when."""

from __future__ import annotations

import itertools
from typing import Any

from nmes.conformance.case import Category, Row, Scope
from nmes.conformance.trial import Trial
from nmes.conformance.wire import Message, Wire, is_event

SUBSCRIPTIONS = Category(11, "subscriptions")
case, table = SUBSCRIPTIONS.case, SUBSCRIPTIONS.table

NEEDS = ("stepping", "step", "subscribe", "unsubscribe")


def events(t: Trial, wire: Wire) -> list[Message]:
    """Returns the events that came before the server answers a ping."""
    wire.say({"type": "ping", "id": "now"})
    messages = []
    for message in wire.messages("events and pong"):
        if not is_event(message):
            t.equal(message.get("id"), "now", "the id of the pong")
            break
        messages.append(message)
    return messages


def step(t: Trial, wire: Wire, ticks: int = 1) -> int:
    """Moves time on; returns the frame afterwards."""
    return int(t.ask(wire, {"type": "step", "ticks": ticks}, "stepped")["frame"])


def frames(messages: list[Message], kind: str) -> list[int]:
    """Returns the frames of events of a type."""
    return [message["frame"] for message in messages if message["type"] == kind]


@case(1, "4.tick", needs=NEEDS, scope=Scope.TIME)
def every_tick(t: Trial) -> None:
    """Who subscribes to ticks hears of each, once, in order."""
    wire, driver = t.join(), t.join()
    t.ask(wire, {"type": "subscribe", "events": ["tick"]}, "subscribed")
    last = step(t, driver, 5)
    got = events(t, wire)
    t.equal(frames(got, "tick"), list(range(last - 4, last + 1)), "the frames of the ticks")
    t.equal(len(got), 5, "the number of events")
    for event in got:
        t.close(event["t"], event["frame"] / t.probe.tick_rate, 1e-6, "t, frame / tick_rate")


@table(2, "4.subscribe", [Row(str(every), every) for every in (2, 3, 10)], needs=NEEDS, scope=Scope.TIME)
def every_so_many_ticks(t: Trial, every: int) -> None:
    """With `every`, only every so many ticks are told."""
    wire, driver = t.join(), t.join()
    t.ask(wire, {"type": "subscribe", "events": ["tick"], "every": every}, "subscribed")
    step(t, driver, 4 * every)
    got = frames(events(t, wire), "tick")
    t.equal(len(got), 4, "the number of ticks told")
    t.equal([after - before for before, after in itertools.pairwise(got)], [every] * 3, "frames between them")


@case(3, "2.2.5", needs=NEEDS, scope=Scope.TIME)
def who_did_not_subscribe(t: Trial) -> None:
    """Who did not subscribe hears nothing, in either dialect, though others do."""
    wire, other, raw, driver = t.join(), t.join(), t.raw(), t.join()
    t.ask(wire, {"type": "subscribe"}, "subscribed")
    t.spawn(driver)
    step(t, driver, 3)
    t.equal(len(frames(events(t, wire), "tick")), 3, "ticks for the subscriber")
    for bystander in (other, raw, driver):
        t.equal(events(t, bystander), [], f"events for {bystander.name}, who did not subscribe")


@case(4, "4.unsubscribe", needs=NEEDS, scope=Scope.TIME)
def unsubscribing(t: Trial) -> None:
    """After unsubscribe nothing more is told."""
    wire, driver = t.join(), t.join()
    t.ask(wire, {"type": "subscribe"}, "subscribed")
    step(t, driver)
    t.equal(len(frames(events(t, wire), "tick")), 1, "ticks before")
    t.ask(wire, {"type": "unsubscribe"}, "unsubscribed")
    step(t, driver, 3)
    t.equal(events(t, wire), [], "events afterwards")


@case(5, "4.subscribe", needs=NEEDS, scope=Scope.TIME)
def the_second_replaces_the_first(t: Trial) -> None:
    """A second subscribe replaces the first: nothing is told twice."""
    wire, driver = t.join(), t.join()
    t.ask(wire, {"type": "subscribe"}, "subscribed")
    t.ask(wire, {"type": "subscribe", "events": ["tick"]}, "subscribed")
    step(t, driver, 2)
    t.equal([event["type"] for event in events(t, wire)], ["tick", "tick"], "events")


def states(messages: list[Message], name: str) -> list[dict[str, Any]]:
    """Returns the states of a cube in `state` events, in order."""
    return [
        cube
        for message in messages
        if message["type"] == "state"
        for cube in message["cubes"]
        if cube["cube_name"] == name
    ]


@case(6, "4.state", needs=NEEDS, scope=Scope.TIME)
def a_falling_cube(t: Trial) -> None:
    """A cube that moves is in every state, where it is then."""
    wire, driver = t.join(), t.join()
    name = t.spawn(driver, position=t.at(y=30))
    t.ask(wire, {"type": "subscribe", "events": ["state"]}, "subscribed")
    step(t, driver, 5)
    messages = events(t, wire)
    t.true(all(event["type"] == "state" for event in messages), "states only", [event["type"] for event in messages])
    updates = states(messages, name)
    t.equal(len(updates), 5, "the number of times that the cube is told of")
    heights = [cube["position"][1] for cube in updates]
    t.true(heights == sorted(heights, reverse=True) and len(set(heights)) == 5, "heights that fall", heights)
    t.close(updates[-1]["position"], t.info(driver, name)["position"], 1e-6, "the last position")


@case(7, "4.state", needs=NEEDS, scope=Scope.TIME)
def a_cube_that_stays(t: Trial) -> None:
    """A cube that does not move is told of once, and not again."""
    wire, driver = t.join(), t.join()
    name = t.base(driver)
    t.ask(wire, {"type": "subscribe", "events": ["state"]}, "subscribed")
    step(t, driver, 2)
    events(t, wire)
    step(t, driver, 5)
    t.equal(states(events(t, wire), name), [], "what is told of the cube later")


@case(8, "4.state", needs=NEEDS, scope=Scope.TIME)
def the_threshold_of_position(t: Trial) -> None:
    """With a threshold, a cube is told of again when it has moved so far since."""
    wire, driver = t.join(), t.join()
    name = t.spawn(driver, position=t.at(y=60), linear_velocity=[0, -6, 0])
    t.ask(wire, {"type": "subscribe", "events": ["state"], "position_threshold": 1.0}, "subscribed")
    step(t, driver, round(0.5 * t.probe.tick_rate))  # it falls some 4 m
    heights = [cube["position"][1] for cube in states(events(t, wire), name)]
    t.true(3 <= len(heights) <= 6, "3 to 6 times in 4 m", heights)
    gaps = [before - after for before, after in itertools.pairwise(heights)]
    t.true(all(gap >= 0.999 for gap in gaps), "at least 1 m between", heights)


@case(9, "4.state", needs=NEEDS, scope=Scope.TIME)
def the_threshold_of_rotation(t: Trial) -> None:
    """With a threshold, a cube is told of again when it has turned so far since."""
    wire, driver = t.join(), t.join()
    name = t.spawn(driver, position=t.at(y=80), angular_velocity=[0, 0, 4])
    command = {"type": "subscribe", "events": ["state"], "position_threshold": 1000, "rotation_threshold": 0.5}
    t.ask(wire, command, "subscribed")
    step(t, driver, round(0.5 * t.probe.tick_rate))  # it turns some 2 rad
    count = len(states(events(t, wire), name))
    t.true(3 <= count <= 6, "3 to 6 times in 2 rad", count)


@case(10, "4.state", needs=NEEDS, scope=Scope.TIME)
def cubes_that_are_gone(t: Trial) -> None:
    """A cube that was despawned is among the removed of the next state, and of no later one."""
    wire, driver = t.join(), t.join()
    name = t.base(driver)
    t.ask(wire, {"type": "subscribe", "events": ["state"]}, "subscribed")
    step(t, driver, 2)
    events(t, wire)
    t.ask(driver, {"type": "despawn_cube", "cube_name": name}, "cube_despawned")
    step(t, driver, 3)
    removed = [event["removed"].count(name) for event in events(t, wire) if event["type"] == "state"]
    t.equal(sum(removed), 1, "the number of times that it is among the removed")


@case(11, "4.subscribe", needs=NEEDS, scope=Scope.TIME)
def each_its_own(t: Trial) -> None:
    """Each subscriber gets what it asked for, whatever the others did."""
    one, two, driver = t.join(), t.join(), t.join()
    t.ask(one, {"type": "subscribe", "events": ["tick"]}, "subscribed")
    t.ask(two, {"type": "subscribe", "events": ["tick"], "every": 4}, "subscribed")
    step(t, driver, 8)
    t.equal(len(events(t, one)), 8, "events of the first")
    t.equal(len(events(t, two)), 2, "events of the second")
    t.ask(one, {"type": "unsubscribe"}, "unsubscribed")
    step(t, driver, 8)
    t.equal(len(events(t, two)), 2, "events of the second when the first has unsubscribed")


@case(12, "4.subscribe", needs=NEEDS, scope=Scope.TIME)
def replies_among_events(t: Trial) -> None:
    """A subscriber gets its replies too, in order, none lost among the events."""
    wire = t.join()
    t.ask(wire, {"type": "subscribe"}, "subscribed")
    for n in range(20):
        wire.say({"type": "step", "id": n}, {"type": "ping", "id": f"p{n}"})
    replies: list[Any] = []
    ticks = 0
    while len(replies) < 40:
        for message in wire.messages("replies and events"):
            if not is_event(message):
                replies.append(message.get("id"))
                break
            ticks += message["type"] == "tick"
    t.equal(replies, [id for n in range(20) for id in (n, f"p{n}")], "the ids of the replies")
    t.equal(ticks, 20, "the number of ticks told")


@case(13, "2.2.5", needs=NEEDS, scope=Scope.TIME)
def subscribing_in_the_raw_dialect(t: Trial) -> None:
    """In the raw dialect who subscribes gets events, and replies as before."""
    wire, driver = t.raw(), t.join()
    t.ask(wire, {"type": "subscribe", "events": ["tick"]}, "subscribed")
    step(t, driver, 3)
    t.equal(len(frames(events(t, wire), "tick")), 3, "ticks")


@case(14, "4.subscribe", needs=NEEDS, scope=Scope.TIME)
def a_subscriber_that_leaves(t: Trial) -> None:
    """A subscription ends with its connection, and the world goes on."""
    wire, driver = t.join(), t.join()
    t.ask(wire, {"type": "subscribe"}, "subscribed")
    wire.reset()
    step(t, driver, 10)
    t.fence(driver)


@case(15, "4.tick", needs=("time", "subscribe"), scope=Scope.TIME)
def events_come_by_themselves(t: Trial) -> None:
    """Events come without being asked for again."""
    wire, driver = t.join(), t.join()
    t.ask(wire, {"type": "subscribe", "events": ["tick"]}, "subscribed")
    t.advance(driver, 0.2)
    event = wire.hear(what="a tick")
    t.equal(event["type"], "tick", "the event")
    t.equal(wire.hear(what="another tick")["frame"], event["frame"] + 1, "frame of the next")
