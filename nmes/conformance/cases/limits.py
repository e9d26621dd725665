"""Limits: what is too long, too many, too slow."""

from __future__ import annotations

import itertools
from typing import Any

from nmes.conformance.case import Category, Level, NotTried, Scope
from nmes.conformance.cases.auth import SLACK, only_error
from nmes.conformance.trial import Trial
from nmes.conformance.wire import frame_of, read_message
from nmes.protocol import DELIMITER, Limits

LIMITS = Category(12, "limits")
case, table = LIMITS.case, LIMITS.table

DEFAULT = Limits()
MANY = 2000  # cubes or joints, at most, that a case makes to reach a limit


@case(1, "1.4.2")
def a_frame_of_nearly_a_mebibyte(t: Trial) -> None:
    """A frame just under 1 MiB is read."""
    wire = t.join()
    ping = b'{"type":"ping","id":1,"x":"'
    wire.send(ping + b"x" * (DEFAULT.frame - len(ping) - 2) + b'"}' + DELIMITER)
    t.equal(wire.reply("pong").get("id"), 1, "the id")
    t.fence(wire)


@case(2, "1.4.2")
def a_frame_over_a_mebibyte(t: Trial) -> None:
    """A frame over 1 MiB gets frame_too_large, and the connection is closed."""
    wire = t.join()
    wire.send(b'{"type":"ping","x":"' + b"x" * DEFAULT.frame + b'"}' + DELIMITER)
    only_error(t, wire.rest(), "frame_too_large")


@case(3, "1.4.2")
def a_frame_without_an_end(t: Trial) -> None:
    """A frame that goes on without a delimiter is given up, after the frames before it are answered."""
    wire = t.join()
    wire.send(frame_of({"type": "ping", "id": 1}) + b"x" * (3 * DEFAULT.frame))
    frames = wire.rest()
    t.equal(len(frames), 2, "the number of frames before the end")
    t.equal(read_message(frames[0]).get("id"), 1, "the id of the pong")
    t.error(read_message(frames[1]), "frame_too_large")


@case(4, "1.4.2")
def too_long_a_frame_hurts_nobody_else(t: Trial) -> None:
    """While one connection sends too long a frame, others are served."""
    wire, other = t.join(), t.join()
    wire.send(b"[" * (2 * DEFAULT.frame))
    t.fence(other)
    only_error(t, wire.rest(), "frame_too_large")
    t.fence(other)


@case(5, "1.4.2")
def many_short_frames_are_no_long_one(t: Trial) -> None:
    """Many frames that together are longer than the limit are read."""
    wire = t.join()
    frame = frame_of({"type": "nothing", "x": "x" * 10_000})
    wire.send(frame * 150)
    for _ in range(150):
        t.error(wire.reply("an error"), "unknown_type")
    t.fence(wire)


@case(6, "1.4.5", level=Level.SHOULD, wait=DEFAULT.stall_timeout + 2)
def a_client_that_does_not_read(t: Trial) -> None:
    """A client that does not read what it is sent is cut off, and others are served."""
    wire, other = t.join(), t.join()
    ping = frame_of({"type": "ping", "id": "x" * 100_000})
    sent = wire.stuff(ping, DEFAULT.pending * 4, 1.0)
    t.fence(other)
    t.sleep(DEFAULT.stall_timeout + SLACK)
    # Its last word, slow_consumer, may be lost: there is no room for it, and it is too late.
    received = sum(map(len, wire.rest(t.target.timeout + SLACK, whole=False)))
    t.true(received < sent, "a connection that is cut before all is answered", f"{received} of {sent} bytes answered")


def _allow_open_files(count: int) -> None:
    """Lets this process have so many files open.

    Raises:
        NotTried: The machine does not allow it.
    """
    try:
        import resource
    except ImportError:  # Windows allows as many sockets as there is memory for
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < count:
        if hard < count and hard != resource.RLIM_INFINITY:
            raise NotTried(f"this machine allows the suite only {hard} open files")
        resource.setrlimit(resource.RLIMIT_NOFILE, (count, hard))


@case(7, "1.4.6", level=Level.SHOULD, scope=Scope.HOST)
def too_many_connections(t: Trial) -> None:
    """Who joins when 1,024 connections have joined gets too_many_connections, and those that were there are served."""
    most = DEFAULT.connections
    _allow_open_files(most + 200)
    first = t.join()
    for _ in range(most):
        wire = t.connect()
        wire.say({"type": "auth", "password": t.target.password})
        answer = wire.frame(what="auth_success")
        if read_message(answer)["type"] == "error":
            only_error(t, [answer, *wire.rest()], "too_many_connections")
            break
    else:
        t.true(False, f"a refusal beyond {most} connections", "none")
    t.fence(first)


@case(8, "1.4.7", needs=("get_world_info",), scope=Scope.WORLD)
def too_many_cubes(t: Trial) -> None:
    """A cube over the world's limit gets limit_reached, and there is room again when one goes."""
    wire = t.join()
    info = t.ask(wire, {"type": "get_world_info"}, "world_info")
    room = info["limits"]["cubes"] - info["counts"]["cubes"]
    if room > MANY:
        raise NotTried(f"there is room for {room:,} cubes more")
    names = [t.name() for _ in range(room + 1)]
    cube = {"type": "spawn_cube", "list": False}
    wire.say(*({**cube, "cube_name": name, "position": t.at(y=100 + 2 * n)} for n, name in enumerate(names)))
    replies = [wire.reply("cube_list") for _ in names]
    t.equal([reply["type"] for reply in replies[:-1]], ["cube_list"] * room, "the replies within the limit")
    t.error(replies[-1], "limit_reached")
    t.ask(wire, {"type": "despawn_cube", "cube_name": names[0]}, "cube_despawned")
    t.ask(wire, {**cube, "cube_name": names[-1], "position": t.at()}, "cube_list")


@case(9, "1.4.7", needs=("get_world_info", "joint.fixed"), scope=Scope.WORLD)
def too_many_joints(t: Trial) -> None:
    """A joint over the world's limit gets limit_reached."""
    wire = t.join()
    info = t.ask(wire, {"type": "get_world_info"}, "world_info")
    room = info["limits"]["joints"] - info["counts"]["joints"]
    space = info["limits"]["cubes"] - info["counts"]["cubes"]
    if room > MANY or space < room + 2:
        raise NotTried(f"there is room for {room:,} joints and {space:,} cubes more")
    cubes = [t.base(wire, position=t.at(y=100 + 2 * n)) for n in range(room + 2)]
    for one, two in itertools.pairwise(cubes[:-1]):
        t.join_cubes(wire, one, two)
    command: dict[str, Any] = {"type": "create_joint", "cube1": cubes[-2], "cube2": cubes[-1], "joint_type": "fixed"}
    t.refused(wire, command, "limit_reached")


@case(10, "4.batch", needs=("batch",))
def a_batch_of_a_thousand(t: Trial) -> None:
    """A batch may hold a thousand commands."""
    commands = [{"type": "ping", "id": n} for n in range(1000)]
    results = t.ask(t.join(), {"type": "batch", "commands": commands}, "batch_result")["results"]
    t.equal([result.get("id") for result in results], list(range(1000)), "the ids of the results")


@case(11, "4.batch", needs=("batch", "step", "stepping"), scope=Scope.TIME)
def a_batch_of_too_many_ticks(t: Trial) -> None:
    """A batch asks for no more ticks than one step may."""
    wire = t.join()
    command = {"type": "batch", "commands": [{"type": "step", "ticks": 10_000}] * 2}
    t.refused(wire, command, "invalid")


@case(12, "4.error.invalid", needs=("step", "stepping"), scope=Scope.TIME)
def too_many_ticks(t: Trial) -> None:
    """A step of more than 10,000 ticks, of none or of a part of one is invalid, and does nothing."""
    wire = t.join()
    before = t.ask(wire, {"type": "step"}, "stepped")["frame"]
    for ticks in (0, -1, 10_001, 10**12, 1.5, "1", None):
        t.refused(wire, {"type": "step", "ticks": ticks}, "invalid", "ticks")
    t.equal(t.ask(wire, {"type": "step", "ticks": 2.0}, "stepped")["frame"], before + 2, "frame after 2.0 ticks")


@case(13, "1.4.4")
def a_connection_that_rests(t: Trial) -> None:
    """A connection that says nothing for a few seconds is still served."""
    wire = t.join()
    t.sleep(3.0)
    t.fence(wire)
