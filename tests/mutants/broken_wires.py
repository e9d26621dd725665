"""Servers that are wrong about bytes, auth, dialects, JSON, limits or connections. See `defects`."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Sequence
from typing import Any, cast

import orjson
from pytest import MonkeyPatch

from defects import defect
from nmes import protocol
from nmes.errors import NmesError, RejectedMessage
from nmes.protocol import (
    DELIMITER,
    NO_ID,
    Auth,
    FrameSplitter,
    Limits,
    Request,
    Session,
    messages,
    original,
    parse,
    session,
)
from nmes.schemas import documents
from nmes.schemas.documents import parse_json
from nmes.server import Host
from nmes.server.connection import Connection
from nmes.server.hosted_world import HostedWorld
from nmes.server.keys import Keys
from nmes.server.threads import Tell
from servers import PASSWORD

# -- framing ----------------------------------------------------------------------------------------------------------


@defect("5.1", "5.42")
def a_reply_too_many(patch: MonkeyPatch) -> None:
    """It answers a ping twice."""
    reply = Session.reply

    def twice(session: Session, request: Request, encoded: bytes) -> bytes:
        answer = reply(session, request, encoded)
        return answer * 2 if request.type == "ping" else answer

    patch.setattr(Session, "reply", twice)


@defect("1.6", "1.5")
def delimiters_in_one_piece(patch: MonkeyPatch) -> None:
    """It finds a delimiter only where all of it comes in one read."""
    feed = FrameSplitter.feed

    def forgetful(splitter: FrameSplitter, data: bytes, most: int | None = None) -> list[bytes]:
        splitter._scanned = max(splitter._scanned, len(splitter._buffer))
        return feed(splitter, data, most)

    patch.setattr(FrameSplitter, "feed", forgetful)


@defect("1.7", "1.8")
def one_frame_a_read(patch: MonkeyPatch) -> None:
    """It executes the first command of a read and forgets the others."""
    feed = FrameSplitter.feed

    def only_first(splitter: FrameSplitter, data: bytes, most: int | None = None) -> list[bytes]:
        frames = feed(splitter, data, most)
        if frames and most is None:
            splitter._start = splitter._scanned = len(splitter._buffer)
        return frames[:1]

    patch.setattr(FrameSplitter, "feed", only_first)


@defect("1.9:13")
def a_delimiter_from_its_beginning(patch: MonkeyPatch) -> None:
    """It splits a frame at the first 13 of the delimiter's 14 bytes."""
    feed = FrameSplitter.feed

    def early(splitter: FrameSplitter, data: bytes, most: int | None = None) -> list[bytes]:
        return feed(splitter, data.replace(DELIMITER, DELIMITER[:-1]).replace(DELIMITER[:-1], DELIMITER), most)

    patch.setattr(FrameSplitter, "feed", early)


@defect("1.3:many", "1.3:only-white-space")
def empty_frames_answered(patch: MonkeyPatch) -> None:
    """It answers an empty frame with an error."""

    def feed(splitter: FrameSplitter, data: bytes, most: int | None = None) -> list[bytes]:
        splitter._buffer += data
        frames: list[bytes] = []
        while len(frames) != most and (end := splitter._buffer.find(DELIMITER, splitter._start)) >= 0:
            frames.append(bytes(splitter._buffer[splitter._start : end]).strip())
            splitter._start = splitter._scanned = end + len(DELIMITER)
        return frames

    patch.setattr(FrameSplitter, "feed", feed)


@defect("1.12", "1.14")
def delimiter_not_escaped(patch: MonkeyPatch) -> None:
    """It writes the delimiter into strings as it is."""
    encode = protocol.encode

    def plain(message: Any) -> bytes:
        return encode(message).replace(b"\\u003c", b"<")

    for module in (protocol, messages, session):
        patch.setattr(module, "encode", plain)


@defect("1.17", "15.10")
def deaf_once_half_closed(patch: MonkeyPatch) -> None:
    """It drops a connection, and what it still has to do for it, as soon as the peer says no more."""
    work = Connection._work

    def late(connection: Connection, messages: Sequence[Auth | bytes] = ()) -> None:
        asyncio.get_running_loop().call_later(0.02, work, connection, messages)

    patch.setattr(Connection, "_work", late)


@defect("1.18")
def the_unfinished_executed(patch: MonkeyPatch) -> None:
    """It executes what came without a delimiter when the connection ends."""
    ended = Connection.eof_received

    def finished(connection: Connection) -> bool:
        if connection._world is not None:
            connection._work(connection._session.receive(DELIMITER))
        return ended(connection)

    patch.setattr(Connection, "eof_received", finished)


@defect("1.15")
def nothing_behind_auth(patch: MonkeyPatch) -> None:
    """It throws away what came in the same write as auth."""
    accept = Session.accept

    def forget(session: Session, welcome: Any) -> bytes:
        session._splitter = FrameSplitter(session._limits.frame)
        return accept(session, welcome)

    patch.setattr(Session, "accept", forget)


@defect("5.42", "7.12")
def errors_overtake(patch: MonkeyPatch) -> None:
    """It answers what it refuses before the commands that came earlier."""
    work = Connection._work

    def sort(connection: Connection, messages: Sequence[Auth | bytes] = ()) -> None:
        work(connection, sorted(messages, key=lambda frame: parse(cast(bytes, frame)).error is None))

    patch.setattr(Connection, "_work", sort)


# -- auth -------------------------------------------------------------------------------------------------------------


@defect("2.6:prefix")
def a_part_of_the_password(patch: MonkeyPatch) -> None:
    """It lets in who knows the beginning of the password."""
    patch.setattr(Keys, "accepts", lambda keys, password: password != "" and PASSWORD.startswith(password))


@defect("2.5", "3.3", auth_delay=0.0)
def refusals_at_once(patch: MonkeyPatch) -> None:
    """It refuses a password at once, so that guessing is quick."""


@defect("2.10", limits=Limits(auth_timeout=600.0))
def no_auth_time_out(patch: MonkeyPatch) -> None:
    """It waits for the password for ever."""


@defect("2.12")
def auth_time_out_put_off(patch: MonkeyPatch) -> None:
    """It begins to wait for the password anew whenever a byte comes."""
    updated = Connection.buffer_updated

    def again(connection: Connection, nbytes: int) -> None:
        if connection._world is None and connection._timer is not None:
            timer, left = connection._timer, connection._limits.auth_timeout
            timer.cancel()
            late = RejectedMessage("auth_timeout", "too late")
            connection._timer = asyncio.get_running_loop().call_later(left, connection.hang_up, late)
        updated(connection, nbytes)

    patch.setattr(Connection, "buffer_updated", again)


@defect("2.2:number", "2.2:null")
def the_id_of_auth_lost(patch: MonkeyPatch) -> None:
    """It answers auth without its id."""
    patch.setattr(Session, "_with_auth_id", lambda session, message: message)


@defect("2.13", limits=Limits(auth_frame=1 << 20))
def long_first_frames(patch: MonkeyPatch) -> None:
    """It reads a first frame of any length up to 1 MiB."""


@defect("2.24")
def all_wait_for_a_refusal(patch: MonkeyPatch) -> None:
    """It serves nobody while it makes somebody wait for a refusal."""

    def wait(connection: Connection, error: NmesError) -> None:
        time.sleep(1.0)
        connection.hang_up(error)

    patch.setattr(Connection, "_refuse", wait)


@defect("2.21", only_strict=True)
def the_password_repeated(patch: MonkeyPatch) -> None:
    """It repeats a wrong password in the error."""
    read = Session._read_auth

    def repeat(session: Session, frame: bytes) -> Auth:
        auth = read(session, frame)
        if session.dialect == "raw" or auth.password == PASSWORD:
            return auth
        return Auth("json", error=RejectedMessage("auth_failed", f"no: {frame.decode()}"), id=auth.id)

    patch.setattr(Session, "_read_auth", repeat)


@defect("2.4", "3.2")
def refused_and_let_stay(patch: MonkeyPatch) -> None:
    """It says that it refuses a password, and leaves the connection open."""
    end = Connection.hang_up

    def stay(connection: Connection, error: NmesError | None = None) -> None:
        if error is not None and error.code == "auth_failed":
            connection._transport.write(connection._session.refuse(error))
        else:
            end(connection, error)

    patch.setattr(Connection, "hang_up", stay)


@defect("2.23")
def heard_behind_a_wrong_password(patch: MonkeyPatch) -> None:
    """It executes what comes behind a wrong password."""
    refuse = Connection._refuse

    def listen(connection: Connection, error: NmesError) -> None:
        host = cast(Host, connection._host)
        world = host.worlds[host.world_name(None)].world
        client = world.join()
        for frame in connection._session._splitter.feed(b""):
            world.handle(client, protocol.parse(frame))
        world.leave(client)
        refuse(connection, error)

    patch.setattr(Connection, "_refuse", listen)


@defect("2.15")
def any_world(patch: MonkeyPatch) -> None:
    """It lets a connection into its world whatever world is named."""
    find = Host.world_name
    patch.setattr(Host, "world_name", lambda host, name: find(host, None))


# -- dialects ---------------------------------------------------------------------------------------------------------


def _not_silent(patch: MonkeyPatch, speaks: Callable[[Request, bytes], bool]) -> None:
    reply = Session.reply

    def loud(session: Session, request: Request, encoded: bytes) -> bytes:
        answer = reply(session, request, encoded)
        return answer or (encoded + DELIMITER if speaks(request, encoded) else b"")

    patch.setattr(Session, "reply", loud)


@defect("3.6:spawn_cube", "3.15")
def raw_spawns_answered(patch: MonkeyPatch) -> None:
    """It answers spawn_cube in the raw dialect."""
    _not_silent(patch, lambda request, reply: request.type == "spawn_cube")


@defect("3.7:despawn_cube", "3.7:apply_physics")
def raw_failures_answered(patch: MonkeyPatch) -> None:
    """It tells of errors in the raw dialect where it should be silent."""
    _not_silent(patch, lambda request, reply: b'"error"' in reply)


@defect("3.10:ping", "3.10:get_cube_list")
def raw_means_silent(patch: MonkeyPatch) -> None:
    """It answers nothing in the raw dialect."""
    reply = Session.reply

    def silent(session: Session, request: Request, encoded: bytes) -> bytes:
        return b"" if session.dialect == "raw" else reply(session, request, encoded)

    patch.setattr(Session, "reply", silent)


@defect("3.14")
def planets_with_a_type(patch: MonkeyPatch) -> None:
    """It answers get_planets in the raw dialect with a type, as in the other."""
    patch.setitem(original._ANSWERS, b"planets", lambda said, reply: reply)


@defect("3.20:1-kg", "3.20:2-kg")
def forces_are_forces_in_the_raw_dialect(patch: MonkeyPatch) -> None:
    """It takes apply_force in the raw dialect for a force of one tick, as in the other."""
    patch.delitem(original._COMMANDS, "apply_force")


@defect("3.21")
def no_central_impulse(patch: MonkeyPatch) -> None:
    """It does not know central_impulse."""
    patch.delitem(original._COMMANDS, "apply_physics")


@defect("3.22:fixed")
def joints_are_called_by_number(patch: MonkeyPatch) -> None:
    """It draws the names of joints in the raw dialect too."""
    translate = original._COMMANDS["create_joint"]

    def nameless(said: dict[str, Any]) -> dict[str, Any]:
        return {name: value for name, value in translate(said).items() if name != "joint_name" or name in said}

    patch.setitem(original._COMMANDS, "create_joint", nameless)


@defect("3.23")
def names_of_joints_are_taken(patch: MonkeyPatch) -> None:
    """It refuses a joint of a name that is taken in the raw dialect too."""
    translate = original._COMMANDS["create_joint"]

    def strict(said: dict[str, Any]) -> dict[str, Any]:
        return {name: value for name, value in translate(said).items() if name != "number_if_taken"}

    patch.setitem(original._COMMANDS, "create_joint", strict)


@defect("3.24:limit_enable", "3.24:motor_enable", backend="mujoco")
def parameters_told_in_our_words(patch: MonkeyPatch) -> None:
    """It answers that a parameter was set in the words of the other dialect."""
    patch.delitem(original._ANSWERS, b"joint_params_set")


@defect("3.24:motor_max_impulse", backend="mujoco")
def impulses_of_our_engine_steps(patch: MonkeyPatch) -> None:
    """It takes a motor's largest impulse in the raw dialect for that of one of its own engine steps."""
    patch.setattr(original, "_RATE", 240.0)


@defect("3.25:hinge", "3.25:conetwist", backend="mujoco")
def joints_told_in_our_words(patch: MonkeyPatch) -> None:
    """It tells a joint's parameters in the words of the other dialect."""
    patch.delitem(original._ANSWERS, b"joint_info")


@defect("3.25:slider", backend="mujoco")
def an_endless_slider(patch: MonkeyPatch) -> None:
    """It makes sliders without limits in the raw dialect, where none are given."""
    patch.setitem(original._DEFAULTS, "slider", {})


@defect("3.26:opaque", "3.26:with-opacity")
def no_colours_in_hex(patch: MonkeyPatch) -> None:
    """It does not know colours in hex."""
    patch.delitem(original._COMMANDS, "set_color")


@defect("3.27", backend="mujoco")
def notes_forgotten(patch: MonkeyPatch) -> None:
    """It does not tell back the parameters that have no effect."""
    tell = original._ANSWERS[b"joint_info"]

    def forget(said: dict[str, Any], reply: dict[str, Any]) -> dict[str, Any]:
        return tell(said, {name: value for name, value in reply.items() if name != "notes"})

    patch.setitem(original._ANSWERS, b"joint_info", forget)


@defect("3.1")
def raw_auth_in_json(patch: MonkeyPatch) -> None:
    """It answers the bare password with an auth_success in JSON."""
    accept = Session.accept

    def in_json(session: Session, welcome: Any) -> bytes:
        accept(session, welcome)
        return protocol.encode(welcome) + DELIMITER

    patch.setattr(Session, "accept", in_json)


# -- JSON -------------------------------------------------------------------------------------------------------------


def _leniently(patch: MonkeyPatch, mend: Callable[[bytes], bytes | None]) -> None:
    """Has frames that are refused read again, as `mend` returns them."""

    def parse(raw: bytes) -> Any:
        try:
            return parse_json(raw)
        except RejectedMessage:
            mended = mend(raw)
            if mended is None:
                raise
            return parse_json(mended)

    _read_json_with(patch, parse)


def _read_json_with(patch: MonkeyPatch, parse: Callable[[bytes], Any]) -> None:
    for module in (messages, session):
        patch.setattr(module, "parse_json", parse)


@defect("4.1:nan", "4.1:nan-deep-inside", "4.10:nan")
def nan_accepted(patch: MonkeyPatch) -> None:
    """It reads NaN as a number."""
    _leniently(patch, lambda raw: raw.replace(b"NaN", b"0.5"))


@defect("4.1:1e400", "4.10:1e400")
def infinite_numbers_accepted(patch: MonkeyPatch) -> None:
    """It reads 1e400 as the largest number that there is."""
    _leniently(patch, lambda raw: raw.replace(b"1e400", b"1000000"))


def _loosely(patch: MonkeyPatch, read: Callable[[bytes], Any]) -> None:
    """Has frames that are refused read by something else, which may refuse them too."""

    def parse(raw: bytes) -> Any:
        try:
            return parse_json(raw)
        except RejectedMessage as rejection:
            try:
                return read(raw)
            except (ValueError, RecursionError):
                raise rejection from None

    _read_json_with(patch, parse)


@defect("4.1:duplicate-key", "4.1:duplicate-key-inside", "4.1:duplicate-key-escaped")
def duplicate_keys_accepted(patch: MonkeyPatch) -> None:
    """It takes the last of several equal keys."""
    _loosely(patch, orjson.loads)


@defect("4.1:lone-high-surrogate", "4.1:lone-low-surrogate")
def lone_surrogates_accepted(patch: MonkeyPatch) -> None:
    """It takes half a character for a question mark."""
    _leniently(patch, lambda raw: raw.replace(b"\\ud800", b"?").replace(b"\\udc00", b"?"))


@defect("4.1:bytes-that-are-no-utf8", "4.1:latin1", "4.1:cut-utf8")
def broken_utf8_accepted(patch: MonkeyPatch) -> None:
    """It replaces bytes that are no UTF-8."""
    _leniently(patch, lambda raw: raw.decode(errors="replace").encode())


@defect("4.1:nested-201-deep")
def depth_not_limited(patch: MonkeyPatch) -> None:
    """It reads JSON however deep it is nested."""
    patch.setattr(documents, "_too_deep", lambda value: False)


@defect("4.6")
def depth_limited_too_much(patch: MonkeyPatch) -> None:
    """It refuses JSON that is nested more than 100 deep."""
    patch.setattr(documents, "NESTING", 100)


@defect("4.1:byte-order-mark")
def byte_order_marks_accepted(patch: MonkeyPatch) -> None:
    """It ignores a byte order mark."""
    _leniently(patch, lambda raw: raw.removeprefix(b"\xef\xbb\xbf"))


@defect("4.1:trailing-comma", "4.1:comment", "4.1:line-comment")
def comments_and_commas_accepted(patch: MonkeyPatch) -> None:
    """It reads JSON with comments, and with commas at the end."""
    _leniently(patch, lambda raw: raw.replace(b"/* hello */", b"").replace(b" // hello", b"").replace(b",}", b"}"))


@defect("4.1:rubbish-behind", "4.1:two-objects")
def the_rest_of_a_frame_ignored(patch: MonkeyPatch) -> None:
    """It reads the first value of a frame and ignores the rest."""
    _loosely(patch, lambda raw: json.JSONDecoder().raw_decode(raw.decode())[0])


@defect("4.2:list")
def lists_of_commands(patch: MonkeyPatch) -> None:
    """It executes the first command of a list."""

    def first(raw: bytes) -> Any:
        value = parse_json(raw)
        return value[0] if isinstance(value, list) and value else value

    _read_json_with(patch, first)


def _change_ids(patch: MonkeyPatch, change: Callable[[Any], Any]) -> None:
    """Has replies tell another id; NO_ID: none."""
    reply = Session.reply

    def other(session: Session, request: Request, encoded: bytes) -> bytes:
        if request.id is not NO_ID:
            message = json.loads(encoded)
            message["id"] = change(request.id)
            if message["id"] is NO_ID:
                del message["id"]
            encoded = protocol.encode(message)
        return reply(session, request, encoded)

    patch.setattr(Session, "reply", other)


@defect("4.3:zero", "4.3:true", "4.3:list")
def ids_as_text(patch: MonkeyPatch) -> None:
    """It echoes every id as a string."""
    _change_ids(patch, lambda identifier: identifier if isinstance(identifier, str) else json.dumps(identifier))


@defect("4.3:null", "4.3:zero")
def ids_that_are_false_lost(patch: MonkeyPatch) -> None:
    """It takes the ids 0, null, false and "" for none."""
    _change_ids(patch, lambda identifier: identifier or NO_ID)


@defect("4.4:2**53+1", only_strict=True)
def ids_as_doubles(patch: MonkeyPatch) -> None:
    """It reads integers as doubles, and tells another id than it was given."""
    _change_ids(patch, lambda identifier: int(float(identifier)) if type(identifier) is int else identifier)


@defect("7.10:cube_not_found", "7.10:invalid", "7.10:unknown_type")
def errors_without_id(patch: MonkeyPatch) -> None:
    """It loses the id of a command that fails."""
    reply = Session.reply

    def lose(session: Session, request: Request, encoded: bytes) -> bytes:
        message = json.loads(encoded)
        if message["type"] == "error":
            message.pop("id", None)
            encoded = protocol.encode(message)
        return reply(session, request, encoded)

    patch.setattr(Session, "reply", lose)


# -- limits -----------------------------------------------------------------------------------------------------------


@defect("12.2", "12.3", limits=Limits(frame=1 << 30))
def frames_without_limit(patch: MonkeyPatch) -> None:
    """It reads frames of any length."""


@defect("12.1", "1.19", limits=Limits(frame=256 << 10))
def frames_limited_too_much(patch: MonkeyPatch) -> None:
    """It refuses frames of more than 256 KiB."""


@defect("12.2")
def long_frames_without_a_word(patch: MonkeyPatch) -> None:
    """It hangs up on too long a frame and does not say why."""
    reply = Session.reply

    def say_nothing(session: Session, request: Request, encoded: bytes) -> bytes:
        return b"" if b'"frame_too_large"' in encoded else reply(session, request, encoded)

    patch.setattr(Session, "reply", say_nothing)


@defect("12.5", "15.8", limits=Limits(frame=1 << 20))
def the_limit_of_a_frame_for_all(patch: MonkeyPatch) -> None:
    """It counts all that a connection sends, not each frame, against the limit of a frame."""
    feed = FrameSplitter.feed
    sent: dict[int, int] = {}

    def count(splitter: FrameSplitter, data: bytes, most: int | None = None) -> list[bytes]:
        sent[id(splitter)] = sent.get(id(splitter), 0) + len(data)
        splitter.exceeded = splitter.exceeded or sent[id(splitter)] > splitter.limit // 8
        return feed(splitter, data, most)

    patch.setattr(FrameSplitter, "feed", count)


@defect("9.9", limits=Limits(connections=40))
def few_connections(patch: MonkeyPatch) -> None:
    """It serves no more than 40 connections."""


@defect("12.7", limits=Limits(connections=1 << 20), only_strict=True)
def any_number_of_connections(patch: MonkeyPatch) -> None:
    """It takes more connections than it says."""


# -- connections ------------------------------------------------------------------------------------------------------


@defect("7.13", "15.3:0")
def hangs_up_on_errors(patch: MonkeyPatch) -> None:
    """It closes a connection that sent something invalid, when it has said why."""
    work = Connection._work

    def last(connection: Connection, messages: Sequence[Auth | bytes] = ()) -> None:
        frames = [frame for frame in (*connection._backlog, *messages) if isinstance(frame, bytes)]
        bad = any(parse(frame).error is not None for frame in frames)
        work(connection, messages)
        if bad:
            connection.hang_up()

    patch.setattr(Connection, "_work", last)


@defect("7.12", "7.11")
def errors_swallowed(patch: MonkeyPatch) -> None:
    """It does not answer what it refuses."""
    reply = Session.reply

    def swallow(session: Session, request: Request, encoded: bytes) -> bytes:
        return b"" if b'"type":"error"' in encoded else reply(session, request, encoded)

    patch.setattr(Session, "reply", swallow)


@defect("15.3:0", "4.1:plain-text")
def dies_of_a_bad_frame(patch: MonkeyPatch) -> None:
    """It stops for all when a frame is no JSON."""
    work = Connection._work
    tasks = []

    def die(connection: Connection, messages: Sequence[Auth | bytes] = ()) -> None:
        work(connection, messages)
        errors = [parse(cast(bytes, frame)).error for frame in messages]
        if any(error is not None and error.code == "bad_json" for error in errors):
            for other in list(connection._host._connections):
                other.abort()
            tasks.append(asyncio.get_running_loop().create_task(connection._host._stop_listening()))

    patch.setattr(Connection, "_work", die)


@defect("15.1:half-a-command")
def dies_with_a_client(patch: MonkeyPatch) -> None:
    """It stops for all when a client breaks off in the middle of a frame."""
    lost = Connection.connection_lost
    tasks = []

    def die(connection: Connection, error: Exception | None) -> None:
        broken_off = connection._session._splitter.waiting > 0
        host = connection._host
        lost(connection, error)
        if broken_off:
            tasks.append(asyncio.get_running_loop().create_task(host._stop_listening()))

    patch.setattr(Connection, "connection_lost", die)


@defect("5.46")
def hangs(patch: MonkeyPatch) -> None:
    """It never answers get_cube_list."""
    reply = Session.reply

    def hang(session: Session, request: Request, encoded: bytes) -> bytes:
        return b"" if request.type == "get_cube_list" else reply(session, request, encoded)

    patch.setattr(Session, "reply", hang)


def _told_to_all(patch: MonkeyPatch, mark: bytes) -> None:
    """Has replies with a mark sent to all clients of a world."""
    submit = HostedWorld.submit

    def tell_all(hosted: HostedWorld, client: int, request: Request, tell: Tell) -> bytes | None:
        reply = submit(hosted, client, request, tell)
        if reply is not None and mark in reply:
            for other in hosted._peers:
                if other != client:
                    hosted._peers.send(other, reply.removesuffix(DELIMITER))
            hosted._settle_soon()
        return reply

    patch.setattr(HostedWorld, "submit", tell_all)


@defect("9.3")
def errors_told_to_all(patch: MonkeyPatch) -> None:
    """It tells everybody of an error."""
    _told_to_all(patch, b'"type":"error"')


@defect("9.4", "3.16")
def spawns_told_to_all(patch: MonkeyPatch) -> None:
    """It tells everybody of a spawned cube, also those who did not subscribe."""
    _told_to_all(patch, b'"spawned"')
