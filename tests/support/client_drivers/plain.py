"""A client of the protocol in the standard library alone, and its driver for `nmes conform-client`.

Tests plant faults in it by changing its text, so that some of its lines are longer than they would have to be.
"""

from __future__ import annotations

import json
import select
import socket
import sys
from collections import deque
from typing import Any

DELIMITER = b"<???DONE???---"
CONNECTING = 5.0  # s
WAITING = 30.0  # s for one reply
EVENTS_KEPT = 10_000


class Lost(Exception):
    """The connection is lost."""


class Client:
    def __init__(self) -> None:
        self.socket: socket.socket | None = None
        self.events: deque[dict[str, Any]] = deque(maxlen=EVENTS_KEPT)
        self.buffer = b""
        self.searched = 0
        self.count = 0
        self.reason = "not connected"

    def open(self, host: str, port: int, password: str, world: str | None = None) -> dict[str, Any]:
        self.buffer, self.searched = b"", 0
        self.events.clear()
        try:
            self.socket = socket.create_connection((host, port), CONNECTING)
        except OSError as error:
            raise self.lose(f"unreachable: {error}") from error
        auth = {"type": "auth", "password": password}
        if world is not None:
            auth["world"] = world
        (answer,) = self.exchange(encode(auth), [None])
        if answer["type"] == "error":
            self.close()
        return answer

    def close(self) -> None:
        if self.socket is not None:
            self.socket.close()
            self.socket = None
            self.reason = "closed"

    def lose(self, reason: str) -> Lost:
        self.close()
        self.reason = reason
        return Lost(reason)

    def request(self, commands: list[dict[str, Any]]) -> list[dict[str, Any]]:
        ids = []
        data = []
        for command in commands:
            ids.append(self.count)
            data.append(encode({**command, "id": self.count}))
            self.count += 1
        return self.exchange(b"".join(data), ids)

    def exchange(self, data: bytes, ids: list[Any]) -> list[dict[str, Any]]:
        """Sends frames and returns the replies; those that were lost are of the type lost."""
        replies: list[dict[str, Any]] = []
        unsent = memoryview(data)
        try:
            while len(replies) < len(ids):
                for message in self.receive(unsent):
                    self.take(message, ids, replies)
                unsent = unsent[self.sent :]
        except Lost as lost:
            replies += [{"type": "lost", "reason": str(lost)}] * (len(ids) - len(replies))
        return replies

    def take(self, message: Any, ids: list[Any], replies: list[dict[str, Any]]) -> None:
        if not isinstance(message, dict):
            raise self.lose("bad_reply: no object")
        expected = ids[len(replies)] if len(replies) < len(ids) else None
        number = message.pop("id", None)
        if number is not None and number != expected:
            raise self.lose("bad_reply: not next in line")
        if len(replies) < len(ids) and number == expected:
            replies.append(message)
        elif message["type"] == "error":
            raise self.lose(f"{message['code']}: {message['message']}")
        else:
            self.events.append(message)

    def receive(self, unsent: memoryview) -> list[Any]:
        """Writes what can be written, and reads what has come."""
        self.sent = 0
        if self.socket is None:
            raise Lost(self.reason)
        readable, writable, _ = select.select([self.socket], [self.socket] if unsent else [], [], WAITING)
        try:
            if writable:
                self.socket.setblocking(False)
                self.sent = self.socket.send(unsent[: 64 << 10])
            if not readable and not writable:
                raise self.lose("no reply in time")
            if not readable:
                return []
            data = self.socket.recv(64 << 10)
        except OSError as error:
            raise self.lose(f"disconnected: {error}") from error
        if not data:
            raise self.lose("disconnected")
        self.buffer += data
        return self.split()

    def split(self) -> list[Any]:
        messages = []
        while (end := self.buffer.find(DELIMITER, self.searched)) >= 0:
            frame, self.buffer = self.buffer[:end].strip(), self.buffer[end + len(DELIMITER) :]
            self.searched = 0
            if frame:
                try:
                    messages.append(json.loads(frame.decode()))
                except ValueError as error:
                    raise self.lose(f"bad_reply: {error}") from error
        self.searched = max(0, len(self.buffer) - len(DELIMITER) + 1)
        return messages

    def wait_for_events(self, count: int) -> list[dict[str, Any]]:
        try:
            while len(self.events) < count:
                for message in self.receive(memoryview(b"")):
                    self.take(message, [], [])
        except Lost:
            pass
        return [self.events.popleft() for _ in range(min(count, len(self.events)))]


def encode(message: dict[str, Any]) -> bytes:
    text = json.dumps(message, ensure_ascii=False)
    return text.replace("<", "\\u003c").encode() + DELIMITER


def outcome(reply: dict[str, Any]) -> dict[str, Any]:
    if reply["type"] == "lost":
        return {"lost": reply["reason"]}
    if reply["type"] == "error":
        return {"error": {key: reply[key] for key in ("code", "message", "field") if key in reply}}
    return {"reply": reply}


def obey(client: Client, told: dict[str, Any]) -> dict[str, Any]:
    do = told.pop("do")
    if do == "open":
        try:
            answer = outcome(client.open(**told))
        except Lost as lost:
            return {"lost": str(lost)}
        return {"opened": answer["reply"]} if "reply" in answer else answer
    if do == "send":
        return outcome(client.request([told["command"]])[0])
    if do == "pipeline":
        return {"outcomes": [outcome(reply) for reply in client.request(told["commands"])]}
    if do == "batch":
        (reply,) = client.request([{"type": "batch", "commands": told["commands"]}])
        return {"outcomes": [outcome(each) for each in reply["results"]]} if "results" in reply else outcome(reply)
    if do == "events":
        return {"events": client.wait_for_events(told["count"])}
    client.close()
    return {}


def main() -> None:
    client = Client()
    for line in sys.stdin:
        print(json.dumps(obey(client, json.loads(line))), flush=True)


if __name__ == "__main__":
    main()
