"""Bytes that are no HTTP, or nearly, and frames that are no WebSocket's: the host goes on, and logs no traceback."""

from __future__ import annotations

import logging
import random
import socket
from collections.abc import Iterator

import pytest

from browsers import get, socket_to, web_port
from nmes.protocol import Limits
from servers import PATIENCE, Served, served

KEY = b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n"
UPGRADE = b"GET /ws HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n" + KEY + b"\r\n"
GOOD = [
    UPGRADE,
    b"GET /health HTTP/1.1\r\nHost: localhost\r\n\r\n",
    b"GET /health HTTP/1.0\r\n\r\n",
    b"POST /health HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n5\r\nabcde\r\n0\r\n\r\n",
    b"GET /health HTTP/1.1\r\nHost: localhost\r\n\r\nGET /%00%ff HTTP/1.1\r\nHost: localhost\r\n\r\n",
    b"GET /health HTTP/1.1\r\nHost: localhost\r\nExpect: 100-continue\r\nContent-Length: 3\r\n\r\nabc",
]
ODD = [
    b"\x00",
    b"\xff" * 9,
    b"\r\n",
    b"\r\n\r\n",
    b" ",
    b":",
    b"Upgrade: h2c\r\n",
    b"Host: x\r\n",
    b"Origin: null\r\n",
    KEY,
]


def masked(opcode: int, data: bytes, fin: bool = True) -> bytes:
    """Returns a frame as a client sends it, under a mask of zeros."""
    size = len(data)
    length = bytes([0x80 | size]) if size < 126 else b"\xfe" + size.to_bytes(2)
    return bytes([(0x80 if fin else 0) | opcode]) + length + bytes(4) + data


FRAMES = [
    masked(1, b'{"type":"auth","password":"x"}'),
    masked(1, b"\xff\xfe"),
    masked(1, b'{"ty', fin=False) + masked(0, b'pe":"ping"}'),
    masked(0, b"goes on from nothing"),
    masked(2, b"binary"),
    masked(3, b"of no known kind"),
    masked(8, b""),
    masked(8, b"\x00"),
    masked(8, b"\x03\xe7no such code"),
    masked(9, b"ping"),
    masked(9, bytes(126)),
    masked(10, b"nobody asked"),
    b"\xc1\x80" + bytes(4),  # compressed, which was not agreed on
    b"\x81\xff" + b"\xff" * 8 + bytes(4),
    b"\x81\x05hello",  # without a mask
]


def draws(seed: int, count: int) -> Iterator[bytes]:
    """Yields streams of bytes: good requests with bytes changed, cut and repeated, and rows of odd frames."""
    draw = random.Random(seed)
    for _ in range(count):
        if draw.random() < 0.4:
            yield UPGRADE + b"".join(draw.choices(FRAMES, k=draw.randint(1, 6)))
            continue
        stream = bytearray(draw.choice(GOOD))
        for _ in range(draw.randint(0, 4)):
            place = draw.randint(0, len(stream))
            match draw.randrange(4):
                case 0:
                    stream[place:place] = draw.choice(ODD)
                case 1:
                    del stream[place : place + draw.randint(1, 8)]
                case 2:
                    stream[place : place + 1] = bytes([draw.randrange(256)])
                case 3:
                    stream += stream[place:]
        yield bytes(stream)


def throw(server: Served, port: int, seed: int, count: int) -> None:
    """Sends streams, each on a socket of its own, and waits until the server hangs up or answers no more."""
    for number, stream in enumerate(draws(seed, count)):
        with socket.create_connection(("127.0.0.1", port)) as peer:
            peer.settimeout(PATIENCE)
            try:
                peer.sendall(stream)
                peer.shutdown(socket.SHUT_WR)
                while peer.recv(1 << 16):
                    pass
            except ConnectionError:  # it may hang up in the middle
                pass
        if number % 50 == 0:
            assert get(port, "/health")[0] == 200
    with socket_to(port) as client:
        assert client.enter()["type"] == "auth_success"


def test_a_host_survives_bytes_of_strangers(caplog: pytest.LogCaptureFixture) -> None:
    with served(limits=Limits(auth_timeout=0.3)) as server:
        port = web_port(server)
        throw(server, port, 0, 200)
        assert server.call(lambda: server.host.connections) <= 1
    assert [each.message for each in caplog.records if each.levelno >= logging.ERROR] == []


@pytest.mark.long
def test_a_host_survives_many_bytes_of_strangers(caplog: pytest.LogCaptureFixture) -> None:
    with served(limits=Limits(auth_timeout=0.3)) as server:
        throw(server, web_port(server), random.randrange(1 << 30), 5000)
    assert [each.message for each in caplog.records if each.levelno >= logging.ERROR] == []
