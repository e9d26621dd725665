"""Cases about which reply belongs to which command, about events, and about connections that end."""

from __future__ import annotations

import time

from nmes.conformance.clients.case import Group
from nmes.conformance.clients.stage import Stage, frame, tick
from nmes.protocol import DELIMITER

__all__ = ["CONNECTIONS", "MATCHING"]

_PING = {"type": "ping"}
_STEP = {"type": "step"}
_GONE = {"code": "cube_not_found", "message": "there is no cube 'gone'", "field": "cube_name"}
# Cases of reading while writing send more than a system keeps, 4 MB by measurement: 10,000 commands of 600 bytes.
_MANY = [
    {"type": "spawn_cube", "cube_name": f"{number:04}{chr(0x1F419) * 124}", "position": [number, 0.1, 1e-9]}
    for number in range(10_000)
]
_BIG_REPLIES = 1000  # of them
_BIG = ["x" * 127] * 32  # 4 KiB

MATCHING = Group(4, "replies and events")


def _error(told: dict[str, str]) -> dict[str, str]:
    return {"type": "error", **told}


@MATCHING.case("2.2.3")
def _in_order(t: Stage) -> None:
    """Each of many commands that are sent without waiting gets its own reply."""
    peer = t.enter()
    t.pipeline([_STEP] * 300)
    commands = [peer.command("step") for _ in range(300)]
    peer.say(*(peer.reply(command, "stepped", frame=n, t=n / 60) for n, command in enumerate(commands)))
    for number, outcome in enumerate(t.outcomes("pipeline", 300)):
        t.outcome(outcome, {"frame": number})


@MATCHING.case("2.2.5")
def _events_between(t: Stage) -> None:
    """Events before, between and after replies are no replies."""
    peer = t.enter()
    command = t.ask(peer, {"type": "subscribe", "events": ["tick"]})
    peer.answer(command, "subscribed", events=["tick"])
    t.got({})
    t.pipeline([_STEP] * 20)
    for number in range(20):
        command = peer.command("step")
        peer.say(tick(1000 + number))
        if number == 0:
            t.waits()
        peer.say(peer.reply(command, "stepped", frame=number, t=number / 60))
    for number, outcome in enumerate(t.outcomes("pipeline", 20)):
        t.outcome(outcome, {"frame": number})
    t.events([tick(1000 + number) for number in range(20)])


@MATCHING.case("2.2.5")
def _unasked_event(t: Stage) -> None:
    """An event that comes while nothing is awaited is no reply to what is sent next."""
    peer = t.enter()
    peer.say(tick(41), {"type": "world_fault", "code": "world_faulted", "frame": 41, "message": "an engine failed"})
    time.sleep(0.05)
    command = t.ask(peer, _STEP)
    peer.answer(command, "stepped", frame=42, t=0.7)
    t.got({"frame": 42})
    t.events([tick(41), {"type": "world_fault", "frame": 41}])


@MATCHING.case("3.2.1")
def _unknown_event(t: Stage) -> None:
    """An event of a type that the client does not know is no reply, and ends nothing."""
    peer = t.enter()
    command = t.ask(peer, _STEP)
    peer.say({"type": "eclipse", "frame": 9, "t": 9 / 60, "of": "the sun"})
    t.waits()
    peer.answer(command, "stepped", frame=5, t=5 / 60)
    t.got({"frame": 5})
    t.ping(peer)


@MATCHING.case("2.2.3")
def _late(t: Stage) -> None:
    """A reply that comes late is waited for, whatever events come meanwhile."""
    peer = t.enter()
    command = t.ask(peer, _STEP)
    for number in range(4):
        t.waits(0.15)
        peer.say(tick(number))
    peer.answer(command, "stepped", frame=4, t=4 / 60)
    t.got({"frame": 4})


@MATCHING.case("3.3.1")
def _errors(t: Stage) -> None:
    """A command that is refused is told the program with code, message and field, and the next ones go on."""
    peer = t.enter()
    command = t.ask(peer, {"type": "get_cube_state", "cube_name": "gone"})
    peer.say(_error(_GONE) | peer.reply(command, "error"))
    t.refused(t.hear("send"), **_GONE)
    t.ping(peer)


@MATCHING.case("3.3.1")
def _errors_in_a_row(t: Stage) -> None:
    """In a row of commands a refused one is that one alone."""
    peer = t.enter()
    t.pipeline([_STEP, {"type": "get_cube_state", "cube_name": "gone"}, _STEP])
    first, second, third = peer.command("step"), peer.command("get_cube_state"), peer.command("step")
    peer.say(
        peer.reply(first, "stepped", frame=1, t=1 / 60),
        _error(_GONE) | peer.reply(second, "error"),
        peer.reply(third, "stepped", frame=2, t=2 / 60),
    )
    outcomes = t.outcomes("pipeline", 3)
    t.outcome(outcomes[0], {"frame": 1})
    t.refused(outcomes[1], **_GONE)
    t.outcome(outcomes[2], {"frame": 2})


@MATCHING.case("4.batch")
def _batch(t: Stage) -> None:
    """Of a batch, each command has its own outcome."""
    peer = t.enter()
    t.tell("batch", commands=[_STEP, {"type": "get_cube_state", "cube_name": "gone"}])
    command = peer.command("batch")
    kinds = [part["type"] for part in command["commands"]]
    t.true(kinds == ["step", "get_cube_state"], "both commands in the batch", command)
    peer.answer(command, "batch_result", results=[{"type": "stepped", "frame": 1, "t": 1 / 60}, _error(_GONE)])
    outcomes = t.outcomes("batch", 2)
    t.outcome(outcomes[0], {"frame": 1})
    t.refused(outcomes[1], **_GONE)


@MATCHING.case("4.tick")
def _all_events(t: Stage) -> None:
    """Events reach the program in the order in which they came, all of a thousand."""
    peer = t.enter()
    events = [tick(number) for number in range(1000)]
    peer.say(*events)
    t.ping(peer)
    t.events(events)


@MATCHING.case("1.4.5")
def _flood(t: Stage) -> None:
    """Who does not ask for events still gets replies, after however many of them."""
    peer = t.enter()
    command = t.ask(peer, _STEP)
    for start in range(0, 50_000, 1000):
        peer.say(*(tick(start + number) for number in range(1000)))
    peer.answer(command, "stepped", frame=50_000, t=50_000 / 60)
    t.got({"frame": 50_000})


@MATCHING.case("2.2.3")
def _another_id(t: Stage) -> None:
    """A reply with another command's id is not taken for the reply to the one that is next in line."""
    peer = t.enter()
    t.pipeline([_STEP, _STEP])
    first, second = peer.command("step"), peer.command("step")
    if "id" not in first or "id" not in second:
        t.skip("its commands have no ids")
    peer.say(peer.reply(second, "stepped", frame=2, t=2 / 60))
    peer.close()
    for number, outcome in enumerate(t.outcomes("pipeline", 2), 1):
        reply = outcome.get("reply") if isinstance(outcome, dict) else None
        if reply is None:
            t.lost(outcome)
        else:
            t.true(reply.get("frame") == number == 2, "that reply, if at all, to the second command", outcome)


@MATCHING.case("1.3.1")
def _no_json(t: Stage) -> None:
    """A frame that is no JSON object is told the program as a loss, not as a reply, nor by silence."""
    for broken in (b'{"type":"stepped","frame":1', b"[]", b"stepped", b'{"type":"stepped","frame":\xff}'):
        peer = t.enter()
        t.ask(peer, _STEP)
        peer.send(broken + DELIMITER)
        t.lost(t.hear("send"))
        t.tell("close")
        t.hear("close")


CONNECTIONS = Group(5, "connections that end")


@CONNECTIONS.case("1.1.1")
def _nobody(t: Stage) -> None:
    """Where nobody listens, the program is told."""
    t.tell("open", host="127.0.0.1", port=t.free_port(), password="sesame")
    t.lost(t.hear("open"))


@CONNECTIONS.case("1.1.2")
def _within_a_frame(t: Stage) -> None:
    """A connection that ends within a frame is a loss, as are all commands after it."""
    peer = t.enter()
    command = t.ask(peer, _STEP)
    peer.send(frame(peer.reply(command, "stepped", frame=1, t=1 / 60)).removesuffix(DELIMITER) + DELIMITER[:7])
    peer.close()
    t.lost(t.hear("send"))
    for _ in range(2):
        t.tell("send", command=_PING)
        t.lost(t.hear("send"))


@CONNECTIONS.case("2.2.3")
def _several_waiting(t: Stage) -> None:
    """What was answered before the end is a reply, and all that was not is lost."""
    peer = t.enter()
    t.pipeline([_STEP] * 5)
    commands = [peer.command("step") for _ in range(5)]
    peer.say(*(peer.reply(command, "stepped", frame=n, t=n / 60) for n, command in enumerate(commands[:3])))
    peer.close()
    outcomes = t.outcomes("pipeline", 5)
    for number in range(3):
        t.outcome(outcomes[number], {"frame": number})
    t.lost(outcomes[3])
    t.lost(outcomes[4])


@CONNECTIONS.case("1.1.1")
def _reset(t: Stage) -> None:
    """A connection that is reset is a loss."""
    peer = t.enter()
    t.ask(peer, _STEP)
    peer.reset()
    t.lost(t.hear("send"))


@CONNECTIONS.case("1.4.5")
def _reason(t: Stage) -> None:
    """An error that answers no command ends all that wait, and its code is told."""
    peer = t.enter()
    t.pipeline([_STEP, _STEP])
    commands = [peer.command("step"), peer.command("step")]
    if "id" not in commands[0]:
        t.skip("its commands have no ids, so that it cannot tell whom an error is for")
    peer.say(_error({"code": "slow_consumer", "message": "the client does not read"}))
    peer.close()
    for outcome in t.outcomes("pipeline", 2):
        t.lost(outcome, "slow_consumer")


@CONNECTIONS.case("4.world_closed")
def _world_closed(t: Stage) -> None:
    """The end of the world is told as an event, then as a loss."""
    peer = t.enter()
    peer.say({"type": "world_closed"})
    peer.close()
    t.events([{"type": "world_closed"}])
    t.tell("send", command=_PING)
    t.lost(t.hear("send"))


@CONNECTIONS.case("1.1.1")
def _slow_reading(t: Stage) -> None:
    """A server that reads slowly gets every command, whole and in order."""
    peer = t.enter()
    t.pipeline(_MANY)
    time.sleep(0.3)
    for number, given in enumerate(_MANY):
        command = peer.command("spawn_cube")
        if command.get("cube_name") != given["cube_name"]:
            t.true(False, f"command {number} of {len(_MANY)}", command)
        peer.answer(command, "cube_list", spawned=given["cube_name"], cubes=[])
        if number % 1000 == 0:
            time.sleep(0.05)
    t.outcomes("pipeline", len(_MANY))


@CONNECTIONS.case("1.4.5")
def _reading_while_writing(t: Stage) -> None:
    """The client reads replies while it still sends, as a server reads no further than it can answer."""
    peer = t.enter()
    t.pipeline(_MANY)
    for number, given in enumerate(_MANY):
        command = peer.command("spawn_cube")
        peer.answer(command, "cube_list", spawned=given["cube_name"], cubes=_BIG if number < _BIG_REPLIES else [])
    for given, outcome in zip(_MANY, t.outcomes("pipeline", len(_MANY)), strict=True):
        t.outcome(outcome, {"spawned": given["cube_name"]})


@CONNECTIONS.case("1.1.2")
def _anew(t: Stage) -> None:
    """A new connection begins anew, whatever the one before it left unfinished."""
    peer = t.enter()
    command = t.ask(peer, _STEP)
    peer.send(frame(peer.reply(command, "stepped", frame=1, t=1 / 60))[:20])
    peer.close()
    t.lost(t.hear("send"))
    t.tell("close")
    t.hear("close")
    peer = t.enter()
    command = t.ask(peer, _STEP)
    peer.answer(command, "stepped", frame=2, t=2 / 60)
    t.got({"frame": 2})


@CONNECTIONS.case("3.6.4")
def _closing(t: Stage) -> None:
    """A client that is closed ends the connection, and sends nothing more."""
    peer = t.enter()
    t.ping(peer)
    t.tell("close")
    rest = peer.rest()
    t.true(not rest, "nothing more", rest)
    t.hear("close")
