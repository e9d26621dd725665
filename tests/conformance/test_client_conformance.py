"""`nmes conform-client`: our clients conform, and clients that are broken on purpose are caught by the cases named."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from layout import ROOT
from nmes.cli import main
from nmes.conformance import Verdict
from nmes.conformance.clauses import CLAUSES
from nmes.conformance.clients import CLIENT_CASES, judge

DRIVERS = ROOT / "tests" / "support" / "client_drivers"
PLAIN = (DRIVERS / "plain.py").read_text()
GO = shutil.which("go", path=os.pathsep.join([os.environ.get("PATH", os.defpath), "/usr/local/go/bin"]))


def failed(command: Sequence[str], *, timeout: float = 5.0, only: Sequence[str] = ()) -> dict[str, str]:
    """Returns the cases that a client does not pass, with what it did instead."""
    results = judge(command, timeout=timeout, only=only)
    return {each.case.number: f"{each.received} {each.reason}" for each in results if each.verdict is not Verdict.OK}


def test_a_client_of_the_standard_library_conforms() -> None:
    assert failed([sys.executable, "-S", str(DRIVERS / "plain.py")]) == {}


@pytest.mark.parametrize("way", ["blocking", "awaiting"])
def test_the_clients_in_python_conform(way: str) -> None:
    assert failed([sys.executable, str(DRIVERS / "python_client.py"), way]) == {}


@pytest.mark.skipif(GO is None, reason="Go is not installed: the Go client was not judged")
def test_the_client_in_go_conforms(tmp_path: Path) -> None:
    assert GO is not None
    offline = {**os.environ, "GOTOOLCHAIN": "local", "GOFLAGS": "-mod=readonly", "GOPROXY": "off"}
    driver = str(tmp_path / "driver")
    built = subprocess.run(
        [GO, "build", "-o", driver, "./conform"],
        cwd=ROOT / "clients" / "go", env=offline, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert built.returncode == 0, built.stderr
    assert failed([driver]) == {}


@dataclass(frozen=True)
class Fault:
    """One thing that a client does wrong, how its text is changed to do so, and which cases must find it."""

    about: str
    before: str
    after: str
    cases: tuple[str, ...]


FAULTS = [
    Fault("says the bare password", "(answer,) = self.exchange(encode(auth), [None])",
          "(answer,) = self.exchange(password.encode() + DELIMITER, [None])", ("1.1",)),
    Fault("says it is in before the server does", "(answer,) = self.exchange(encode(auth), [None])",
          'self.socket.send(encode(auth)); answer = {"type": "auth_success", "world": "arena"}', ("1.1", "1.4")),
    Fault("never names a world", "if world is not None:", "if False:", ("1.3",)),
    Fault("takes a refusal for success", 'return {"opened": answer["reply"]} if "reply" in answer else answer',
          'return {"opened": answer.get("reply", answer)}', ("1.4", "1.5")),
    Fault("goes on after a refusal", '        if answer["type"] == "error":\n            self.close()\n',
          '        if answer["type"] == "error":\n            self.socket.send(encode({"type": "ping"}))\n', ("1.4",)),
    Fault("takes a packet for a frame", "self.buffer += data\n", "self.buffer = data\n        self.searched = 0\n",
          ("2.1", "2.2", "2.8")),
    Fault("throws away what follows a frame", "self.buffer[:end].strip(), self.buffer[end + len(DELIMITER) :]",
          'self.buffer[:end].strip(), b""', ("2.3", "2.4", "4.1")),
    Fault("misses a delimiter in two packets", "max(0, len(self.buffer) - len(DELIMITER) + 1)", "len(self.buffer)",
          ("2.1", "2.2")),
    Fault("decodes packet by packet", "self.buffer += data\n",
          'self.buffer += data.decode("utf-8", "replace").encode()\n', ("2.6",)),
    Fault("takes an empty frame for a message", "            if frame:\n", "            if True:\n", ("2.5",)),
    Fault("reads no white space", ".strip(), self.buffer[", ', self.buffer[', ("2.5",)),
    Fault("keeps no reply of a megabyte", "        self.searched = max(",
          '        if len(self.buffer) > 1 << 20:\n            raise self.lose("too large")\n'
          "        self.searched = max(",
          ("2.8",)),
    Fault("undoes escapes before it splits", "self.buffer += data\n",
          'self.buffer += data.replace(b"\\\\u003c", b"<")\n', ("2.7",)),
    Fault("refuses fields that it does not know", "        number = message.pop",
          '        if "novel" in message:\n            raise self.lose("unknown field")\n        number = message.pop',
          ("2.9",)),
    Fault("rounds what it reads", "json.loads(frame.decode())",
          "json.loads(frame.decode(), parse_float=lambda text: round(float(text), 6))", ("2.10",)),
    Fault("sends null for what is left out", '{**command, "id": self.count}',
          '{"cube_name": None, **command, "id": self.count}', ("3.1",)),
    Fault("adds fields of its own", '{**command, "id": self.count}',
          '{**command, "id": self.count, "client": "mine"}', ("3.1", "3.2")),
    Fault("does not escape the <", 'text.replace("<", "\\\\u003c").encode()', "text.encode()", ("1.2", "3.2")),
    Fault("sends no characters but ASCII", ".encode() + DELIMITER\n", '.encode("ascii", "replace") + DELIMITER\n',
          ("3.3",)),
    Fault("rounds what it sends", "text = json.dumps(message, ensure_ascii=False)",
          "text = json.dumps(json.loads(json.dumps(message), parse_float=lambda t: round(float(t), 6)), "
          "ensure_ascii=False)", ("3.4",)),
    Fault("leaves zeros out", '{**command, "id": self.count}',
          '{**{k: v for k, v in command.items() if v or v != 0}, "id": self.count}', ("3.5",)),
    Fault("gives all commands one id", "self.count += 1", "self.count += 0", ("3.6",)),
    Fault("hands out replies in reverse", "        return replies\n", "        return replies[::-1]\n", ("4.1", "4.7")),
    Fault("takes events for replies", "if len(replies) < len(ids) and number == expected:",
          "if len(replies) < len(ids):", ("4.2", "4.4")),
    Fault("drops events between replies", "            self.events.append(message)\n",
          "            ids or self.events.append(message)\n", ("2.3", "4.2")),
    Fault("hands out the last event first", "self.events.popleft()", "self.events.pop()", ("4.3", "4.9")),
    Fault("keeps no more than 500 events", "EVENTS_KEPT = 10_000", "EVENTS_KEPT = 500", ("4.9",)),
    Fault("ends with an event that it does not know", "            self.events.append(message)\n",
          '            if message["type"] == "eclipse":\n                raise self.lose("unknown event")\n'
          "            self.events.append(message)\n", ("4.4",)),
    Fault("gives up after 0.1 s", "WAITING = 30.0", "WAITING = 0.1", ("4.5",)),
    Fault("forgets the code of errors", '("code", "message", "field")', '("message", "field")', ("1.4", "4.6")),
    Fault("forgets the field of errors", '("code", "message", "field")', '("code", "message")', ("4.6", "4.8")),
    Fault("ends a row at the first error", "            replies.append(message)\n",
          '            replies.append(message)\n            if message["type"] == "error":\n'
          '                raise self.lose("refused")\n', ("4.7",)),
    Fault("takes errors in a batch for replies", '"outcomes": [outcome(each) for each in reply["results"]]',
          '"outcomes": [{"reply": each} for each in reply["results"]]', ("4.8",)),
    Fault("takes a reply whatever its id", "        number = message.pop",
          '        if "id" in message and len(replies) < len(ids):\n            message["id"] = ids[len(replies)]\n'
          "        number = message.pop", ("4.11",)),
    Fault("passes over what is no JSON", 'raise self.lose(f"bad_reply: {error}") from error', "pass", ("4.12",)),
    Fault("takes silence for an end of waiting only", 'raise self.lose("disconnected")\n', "return []\n",
          ("5.2", "5.3")),
    Fault("takes half a frame for a reply", 'raise self.lose("disconnected")\n',
          'return [{"type": "stepped", "id": self.count - 1, "frame": 0}] if self.buffer else []\n', ("5.2",)),
    Fault("forgets what was answered before the end", "            replies += [{",
          "            replies.clear()\n            replies += [{", ("5.3",)),
    Fault("takes the server's last word for a reply", '        elif message["type"] == "error":\n',
          '        elif message["type"] == "error" and replies != ids:\n            replies.append(message)\n'
          '        elif message["type"] == "error":\n', ("5.5",)),
    Fault("forgets why the server hung up", 'raise self.lose(f"{message[\'code\']}: {message[\'message\']}")',
          'raise self.lose("disconnected")', ("5.5",)),
    Fault("says nothing of the world's end", "            self.events.append(message)\n",
          '            message["type"] == "world_closed" or self.events.append(message)\n', ("5.6",)),
    Fault("loses what the system did not take", "unsent = unsent[self.sent :]", "unsent = unsent[64 << 10 :]",
          ("5.7",)),
    Fault("writes all before it reads", "        try:\n            while len(replies) < len(ids):\n",
          "        try:\n            if self.socket:\n                self.socket.setblocking(True)\n"
          '                self.socket.sendall(unsent)\n            unsent = memoryview(b"")\n'
          "            while len(replies) < len(ids):\n", ("5.8",)),
    Fault("keeps half a frame for the next connection", '        self.buffer, self.searched = b"", 0\n', "", ("5.9",)),
    Fault("does not close", "            self.socket.close()\n",
          "            globals()[str(self.socket)] = self.socket\n", ("5.10",)),
]  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.about.replace(" ", "_"))
def test_a_client_with_a_fault_is_found(fault: Fault, tmp_path: Path) -> None:
    assert PLAIN.count(fault.before) == 1, "the line that the fault is about"
    (tmp_path / "driver.py").write_text(PLAIN.replace(fault.before, fault.after))
    assert set(failed([sys.executable, "-S", str(tmp_path / "driver.py")], timeout=0.5, only=fault.cases)) == {
        *fault.cases
    }


def test_every_case_finds_a_fault_or_is_of_a_kind_that_another_one_finds() -> None:
    found = {number for fault in FAULTS for number in fault.cases}
    missed = {case.number for case in CLIENT_CASES} - found
    assert missed == {"1.6", "4.10", "5.1", "5.4"}, "cases that no planted fault breaks"


def test_every_case_is_held_to_a_sentence_of_the_protocol() -> None:
    assert all(case.clause in CLAUSES for case in CLIENT_CASES)
    assert len({case.number for case in CLIENT_CASES}) == len(CLIENT_CASES)


def run(*arguments: str) -> Result:
    return CliRunner().invoke(main, ["conform-client", *arguments])


def test_the_status_tells_whether_a_client_conforms(tmp_path: Path) -> None:
    good = run("--only", "1.1", "--only", "2.1", sys.executable, "-S", str(DRIVERS / "plain.py"))
    assert (good.exit_code, good.stdout.splitlines()[-1]) == (0, "the client conforms: 2 ok")
    (tmp_path / "driver.py").write_text(PLAIN.replace('text.replace("<", "\\\\u003c")', "text"))
    bad = run("--only", "3.2", "--json", "--timeout", "0.5", sys.executable, "-S", str(tmp_path / "driver.py"))
    assert bad.exit_code == 1
    (row,) = json.loads(bad.stdout)["results"]
    assert (row["case"], row["verdict"]) == ("3.2", "failed") and row["sentence"] == CLAUSES["1.2.2"] and row["log"]


@pytest.mark.parametrize(
    ("program", "received"),
    [
        ("pass", "its end, with status 0"),
        ("import sys; sys.exit(3)", "its end, with status 3"),
        ("input(); print('hello', flush=True); input()", "hello"),
        ("input(); print('[]', flush=True); input()", "[]"),
        ("import time; time.sleep(60)", "none"),
    ],
)
def test_a_driver_that_does_not_obey_is_a_failure_and_no_traceback(program: str, received: str) -> None:
    result = run("--only", "1.1", "--timeout", "0.5", "--json", sys.executable, "-S", "-c", program)
    assert result.exit_code == 1, result.output
    (row,) = json.loads(result.stdout)["results"]
    assert received in row["received"]


HOSTILE = """
import json, socket, sys, time
opening = json.loads(sys.stdin.readline())
connection = socket.create_connection((opening["host"], opening["port"]))
delimiter = b"<???DONE???---"
connection.sendall(json.dumps({"type": "auth", "password": opening["password"]}).encode() + delimiter)
welcome = b""
while delimiter not in welcome:
    welcome += connection.recv(4096)
answer = json.loads(welcome.split(delimiter)[0])
print(json.dumps({"error" if answer["type"] == "error" else "opened": answer}), flush=True)
"""


@pytest.mark.parametrize(
    ("case", "then", "expected"),
    [
        ("5.8", "time.sleep(60)", "a driver that reads pipeline, in time"),
        ("3.1", "while True: connection.sendall(delimiter * 5000)", "the command ping in time"),
        ("1.4", "while True: connection.sendall(b'x' * 65536)", "the end of the connection"),
    ],
)
def test_a_client_or_driver_without_end_is_a_failure_after_one_time_out(case: str, then: str, expected: str) -> None:
    result = run("--only", case, "--timeout", "0.5", "--json", sys.executable, "-S", "-c", HOSTILE + then)
    assert result.exit_code == 1, result.output
    (row,) = json.loads(result.stdout)["results"]
    assert row["expected"].startswith(expected)


def test_what_a_client_cannot_do_is_skipped() -> None:
    program = "import sys, json\nfor line in sys.stdin: print(json.dumps({'unsupported': 'all'}), flush=True)"
    result = run("--only", "5.1", sys.executable, "-S", "-c", program)
    assert result.exit_code == 2 and "the client cannot do that: open" in result.stdout


def test_wrong_usage_is_told_in_one_line(tmp_path: Path) -> None:
    for arguments, words in [
        ((), "give the driver"),
        (("--only", "9.*", "true"), "no case fits"),
        ((str(tmp_path / "nothing"),), "cannot start"),
    ]:
        result = run(*arguments)
        assert result.exit_code == 2 and words in result.output.splitlines()[-1] and "Traceback" not in result.output


def test_the_list_has_every_case() -> None:
    assert len(run("--list").stdout.splitlines()) == len(CLIENT_CASES) + 1
