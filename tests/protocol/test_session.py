"""Streams and sessions: framing, auth, dialects; laws as property tests, cases as examples."""

from __future__ import annotations

import itertools
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nmes import protocol
from nmes.errors import RejectedMessage
from nmes.protocol import (
    COMMANDS,
    DELIMITER,
    Auth,
    FrameSplitter,
    Limits,
    Request,
    Session,
    decode,
    encode,
)

PING = b'{"type":"ping"}'
AUTH = b'{"type":"auth","password":"open sesame"}'
WELCOME = {"type": "auth_success", "protocol": 1}
SMALL = Limits(frame=64, auth_frame=48, pending=10_000)


def read(session: Session, data: bytes) -> list[Auth | Request]:
    """What a host makes of the bytes that it receives."""
    received = session.receive(data)
    return [session.redacted(session.parse(item)) if isinstance(item, bytes) else item for item in received]


def opened(first: bytes = AUTH, limits: Limits | None = None) -> Session:
    """A session past its auth."""
    session = Session(limits)
    assert len(read(session, first + DELIMITER)) == 1
    session.accept(WELCOME)
    return session


def violation(session: Session) -> str | None:
    """The code of what made the session end, if anything did."""
    return None if session.violation is None else session.violation.code


# -- frames -----------------------------------------------------------------------------------------------------------

pieces = st.lists(
    st.sampled_from(
        [DELIMITER, DELIMITER, PING, AUTH, b"<???", b"DONE???---", b"<", b"-", b"\r\n ", b"x" * 40, b"{", b"\xff"]
    )
    | st.binary(max_size=20),
    max_size=30,
)


def cut(data: st.DataObject, stream: bytes) -> list[bytes]:
    places = data.draw(st.lists(st.integers(0, len(stream)), max_size=20))
    ends = [0, *sorted(places), len(stream)]
    return [stream[start:end] for start, end in itertools.pairwise(ends)]


@given(pieces, st.integers(0, 60), st.data())
def test_the_chunks_of_a_stream_do_not_change_its_frames(stream: list[bytes], limit: int, data: st.DataObject) -> None:
    whole = b"".join(stream)
    # What frames are, said again in the simplest way.
    *complete, rest = whole.split(DELIMITER)
    fitting = next((i for i, frame in enumerate(complete) if len(frame) > limit), len(complete))
    expected = [frame.strip(b" \t\r\n") for frame in complete[:fitting]]
    exceeded = fitting < len(complete) or len(rest) > limit + len(DELIMITER) - 1
    for parts in ([whole], cut(data, whole), [whole[i : i + 1] for i in range(len(whole))]):
        splitter = FrameSplitter(limit)
        assert [frame for part in parts for frame in splitter.feed(part)] == [frame for frame in expected if frame]
        assert splitter.exceeded == exceeded
        assert exceeded or splitter.waiting == len(rest)


@pytest.mark.parametrize("offset", range(1, 14))
def test_a_delimiter_cut_at_any_inner_offset_ends_its_frame(offset: int) -> None:
    session = opened()
    assert read(session, PING + DELIMITER[:offset]) == []
    (request,) = read(session, DELIMITER[offset:] + PING)
    assert isinstance(request, Request) and request.raw == PING
    assert len(read(session, DELIMITER)) == 1


@pytest.mark.parametrize("offset", range(1, 14))
def test_the_beginning_of_a_delimiter_is_no_delimiter(offset: int) -> None:
    splitter = FrameSplitter()
    assert splitter.feed(b"a" + DELIMITER[:offset]) == []
    assert splitter.feed(DELIMITER + b"b" + DELIMITER) == [b"a" + DELIMITER[:offset], b"b"]


def test_a_thousand_coalesced_messages_come_out_in_order() -> None:
    stream = b"".join(b'{"type":"ping","id":%d}' % i + DELIMITER for i in range(1000))
    received = read(opened(), stream)
    assert [request.id for request in received] == list(range(1000))


def test_white_space_and_empty_frames_are_ignored() -> None:
    session = opened()
    received = read(session, DELIMITER + b" \r\n\t" + DELIMITER * 2 + b"\n " + PING + b"\r\n" + DELIMITER + b"\n")
    assert [request.raw for request in received if isinstance(request, Request)] == [PING]
    assert violation(session) is None


def test_a_delimiter_inside_a_string_gives_errors_and_the_stream_goes_on() -> None:
    received = read(opened(), b'{"type":"ping","id":"a<???DONE???---b"}' + DELIMITER + PING + DELIMITER)
    codes = [request.error and request.error.code for request in received]
    assert codes == ["bad_json", "bad_json", None]


def test_a_frame_of_the_limit_passes_and_one_byte_more_does_not() -> None:
    limits = Limits(frame=200, auth_frame=100)
    session = opened(AUTH.ljust(100), limits)
    earlier = read(session, PING.ljust(200) + DELIMITER + PING.ljust(201) + DELIMITER + PING + DELIMITER)
    assert len(earlier) == 1 and session.violation is not None
    assert session.violation.code == "frame_too_large" and "200" in session.violation.message
    assert read(session, PING + DELIMITER) == []
    before_auth = Session(limits)
    assert read(before_auth, AUTH.ljust(101) + DELIMITER) == []
    assert violation(before_auth) == "frame_too_large"


def test_a_frame_that_never_ends_is_refused_at_the_limit() -> None:
    session = opened(limits=Limits(frame=200))
    for _ in range(300):
        read(session, b"x")
    assert session.violation is not None
    unknown = Session(SMALL)
    read(unknown, b" " * 100)
    assert unknown.violation is not None


def test_the_limit_before_auth_is_not_applied_to_what_follows_auth() -> None:
    session = Session(Limits(auth_frame=100))
    assert len(read(session, AUTH + DELIMITER + PING.ljust(500) + DELIMITER)) == 1
    assert violation(session) is None
    session.accept(WELCOME)
    assert len(read(session, b"")) == 1


# -- sessions ---------------------------------------------------------------------------------------------------------


@given(pieces, st.sampled_from([AUTH, b"open sesame", b"{", b""]), st.booleans(), st.data())
@settings(max_examples=200)
def test_no_stream_makes_a_session_raise_and_cutting_it_changes_nothing(
    stream: list[bytes], first: bytes, welcome: bool, data: st.DataObject
) -> None:
    whole = first + DELIMITER + b"".join(stream)

    def run(parts: list[bytes]) -> tuple[list[Any], str | None]:
        session = Session(SMALL)
        out: list[Any] = []
        for part in parts:
            received = read(session, part)
            while received:
                out += [(i.raw, i.type) if isinstance(i, Request) else (i.dialect, i.password) for i in received]
                if isinstance(received[0], Auth) and welcome:
                    session.accept(WELCOME)
                received = read(session, b"") if isinstance(received[0], Auth) else []
        return out, violation(session)

    assert run([whole]) == run(cut(data, whole)) == run([whole[i : i + 1] for i in range(len(whole))])


def test_auth_in_the_json_dialect_is_read() -> None:
    session = Session()
    (auth,) = read(session, b'{"type":"auth","password":"open sesame","world":"moon","id":null,"x":1}' + DELIMITER)
    assert isinstance(auth, Auth)
    assert auth == Auth("json", "open sesame", "moon", None, None)
    assert "sesame" not in repr(auth)
    assert read(session, PING + DELIMITER) == []
    assert session.accept(WELCOME) == encode({**WELCOME, "id": None}) + DELIMITER
    (request,) = read(session, b"")
    assert isinstance(request, Request) and request.raw == PING
    assert session.reply(request, b'{"type":"pong"}') == b'{"type":"pong"}' + DELIMITER
    assert session.event(b'{"type":"tick"}') == b'{"type":"tick"}' + DELIMITER


def test_auth_in_the_raw_dialect_is_read() -> None:
    session = Session()
    (auth,) = read(session, "  sésame \n".encode() + DELIMITER)
    assert auth == Auth("raw", "sésame")
    assert session.accept(WELCOME) == b"auth_success" + DELIMITER
    refused = Session()
    read(refused, b"wrong" + DELIMITER)
    assert refused.refuse(RejectedMessage("auth_failed", "no")) == b"auth_failed" + DELIMITER
    assert read(refused, PING + DELIMITER) == []


@pytest.mark.parametrize(
    ("first", "dialect", "code"),
    [
        (PING, "json", "auth_failed"),
        (b'{"password":"x"}', "json", "auth_failed"),
        (b'{"type":"auth"}', "json", "invalid"),
        (b'{"type":"auth","password":7}', "json", "invalid"),
        (b'{"type":"auth","password":"x","world":7}', "json", "invalid"),
        (b'{"type":"auth","password":"x","password":"y"}', "json", "bad_json"),
        (b"{", "json", "bad_json"),
        (b'{"\xff":1}', "json", "bad_frame"),
        (b"\xff", "raw", "auth_failed"),
    ],
)
def test_a_first_frame_that_is_no_auth_is_refused(first: bytes, dialect: str, code: str) -> None:
    session = Session()
    (auth,) = read(session, first + DELIMITER)
    assert isinstance(auth, Auth) and auth.dialect == dialect
    assert auth.error is not None and auth.error.code == code
    answer = session.refuse(auth.error)
    if dialect == "json":
        reply = decode(answer.removesuffix(DELIMITER))
        protocol.validate_reply(reply)
        assert reply["code"] == code and reply["command"] == "auth"
    else:
        assert answer == b"auth_failed" + DELIMITER


def test_a_password_is_never_repeated() -> None:
    session = Session()
    (auth,) = read(session, b'{"type":"auth","password":["open sesame"],"id":1}' + DELIMITER)
    assert isinstance(auth, Auth) and auth.error is not None
    assert "sesame" not in auth.error.message and "sesame" not in repr(auth)
    assert decode(session.refuse(auth.error).removesuffix(DELIMITER))["id"] == 1


def test_a_flood_before_the_answer_to_auth_is_refused() -> None:
    session = Session(Limits(pending=500))
    read(session, AUTH + DELIMITER)
    read(session, b"x" * 500)
    assert violation(session) is None
    read(session, b"x")
    assert violation(session) == "frame_too_large"


@pytest.mark.parametrize("first", [AUTH, b"open sesame"])
def test_an_open_session_ends_with_an_error_in_json(first: bytes) -> None:
    session = opened(first)
    answer = session.refuse(RejectedMessage("slow_consumer", "read faster"))
    assert decode(answer.removesuffix(DELIMITER)) == {
        "type": "error",
        "code": "slow_consumer",
        "message": "read faster",
    }
    assert read(session, PING + DELIMITER) == []


def test_a_session_refused_before_its_first_frame_ends_with_an_error_in_json() -> None:
    answer = Session().refuse(RejectedMessage("auth_timeout", "too late"))
    assert decode(answer.removesuffix(DELIMITER))["code"] == "auth_timeout"


def test_the_raw_dialect_is_silent_after_these_commands_and_no_others() -> None:
    raw, json_dialect = opened(b"open sesame"), opened()
    silent = set()
    for name, command in COMMANDS.items():
        for frame in (encode(command.schema["examples"][0]), encode({"type": name, "cube_name": 7})):
            (request,) = read(raw, frame + DELIMITER)
            assert isinstance(request, Request)
            if not raw.reply(request, b"{}"):
                silent.add(name)
            assert json_dialect.reply(request, b'{"type":"x"}').startswith(b'{"type":"x"')
    assert silent == {"spawn_cube", "despawn_cube", "apply_force", "apply_physics", "freeze_cube", "set_color"}
    for frame in (b"{", b"\xff", b'{"type":"fly"}', b'{"type":["spawn_cube"]}'):
        (request,) = read(raw, frame + DELIMITER)
        assert isinstance(request, Request) and raw.reply(request, b"{}") == b"{}" + DELIMITER


def test_planets_have_a_key_each_in_the_raw_dialect() -> None:
    planets = [{"Name": "(0, 0, 0)"}, {"Name": "(0, 0, 1)"}]
    reply = encode({"type": "planets", "planets": planets, "id": 4})
    failed = encode({"type": "error", "code": "world_faulted", "message": "", "command": "get_planets"})
    for session, raw in ((opened(b"open sesame"), True), (opened(), False)):
        (request,) = read(session, b'{"type":"get_planets","id":4}' + DELIMITER)
        assert isinstance(request, Request)
        answer = encode({planet["Name"]: [planet] for planet in planets}) if raw else reply
        assert session.reply(request, reply) == answer + DELIMITER
        assert session.reply(request, failed) == failed + DELIMITER


def test_silence_is_kept_for_commands_that_are_not_valid() -> None:
    session = opened(b"open sesame")
    (request,) = read(session, b'{"type":"apply_force","force":"up"}' + DELIMITER)
    assert isinstance(request, Request) and request.error is not None
    assert session.reply(request, b"{}") == b""
