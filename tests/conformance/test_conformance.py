"""The suite over our own server, and over what is none: the broken servers proper stand elsewhere."""

from __future__ import annotations

import html
import json
import os
import random
import re
import secrets
import signal
import socket
import subprocess
import sys
import threading
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from click.testing import CliRunner
from click.testing import Result as Outcome

from disks import full_disk
from hostile_servers import listening
from layout import ROOT
from nmes.cli import main
from nmes.conformance import CASES, Category, Options, Report, Target, Trial, Verdict, run, select, suite_hash
from nmes.conformance.__main__ import page
from nmes.conformance.clauses import CLAUSES, UNTESTED
from nmes.protocol import DELIMITER, Request, Session
from nmes.world import World
from nmes.world.commands import COMMANDS
from servers import PASSWORD, PATIENCE, Served, served, until

BAD = {Verdict.FAILED, Verdict.FAULT, Verdict.NON_STRICT}


def judge(server: Served, *only: str, **options: Any) -> Report:
    return run(Target("127.0.0.1", server.port, PASSWORD, PATIENCE), Options(only=only, **options))


def bad(report: Report) -> list[tuple[str, Any, Any, Any]]:
    return [(r.case.number, r.expected, r.received, r.reason) for r in report.results if r.verdict in BAD]


def cli(*arguments: str) -> Outcome:
    return CliRunner().invoke(main, ["conform", *arguments], env={"NMES_PASSWORD": PASSWORD})


def process(*arguments: str) -> tuple[int, str]:
    """Runs `nmes conform` in a process of its own, in which Hypothesis draws by the seed alone; status and output."""
    environment = {**os.environ, "NMES_PASSWORD": PASSWORD}
    command = [sys.executable, "-m", "nmes", "conform", *arguments]
    outcome = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=PATIENCE * 4)
    return outcome.returncode, outcome.stdout


# -- our own server ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("backend", "mode"),
    [
        ("ballistic", "lockstep"),
        ("mujoco", "realtime"),
        pytest.param("pymunk", "lockstep", marks=pytest.mark.long),
    ],
)
def test_our_server_conforms(backend: str, mode: str) -> None:
    roles: dict[str, Any] = {"roles": {"player": {}, "viewer": {}}} if backend == "ballistic" else {}
    with served({"backend": backend, "mode": mode, **roles}, auth_delay=1.0) as server:
        report = judge(server)
        asked = {result.case.number: result.verdict for result in report.results if result.case.category == "roles"}
        assert set(asked.values()) == {Verdict.OK if roles else Verdict.SKIPPED} and len(asked) > 15
        assert bad(report) == []
        assert report.exit_status == 0
        assert server.call(server.hosted.world.cubes) == []  # it cleans up
        assert server.call(lambda: (server.hosted.world.mode, server.hosted.world.paused)) == (mode, False)


@pytest.mark.parametrize("mode", ["realtime", "lockstep"])
def test_a_world_that_is_found_paused_conforms_and_is_left_paused(mode: str) -> None:
    with served({"mode": mode}) as server:
        with server.client() as client:
            client.pause()
        report = judge(server, "10.*", "11.1")
        assert bad(report) == [] and report.exit_status == 0
        assert server.call(lambda: (server.hosted.world.mode, server.hosted.world.paused)) == (mode, True)


# -- servers that are none --------------------------------------------------------------------------------------------


def test_a_silent_server_fails_each_case_after_one_time_out() -> None:
    with listening(lambda connection: None) as port:
        report = run(Target("127.0.0.1", port, PASSWORD, timeout=0.3), Options(only=["1.5", "1.7", "4.1:n*"]))
    assert {result.verdict for result in report.results} == {Verdict.FAILED}
    assert {ending for result in report.results for ending in result.endings.values()} <= {"timed out"}
    assert max(result.seconds for result in report.results) < 0.3 * 3
    assert report.exit_status == 1


def test_a_server_that_hangs_up_fails() -> None:
    with listening(lambda connection: connection.shutdown(socket.SHUT_RDWR)) as port:
        report = run(Target("127.0.0.1", port, PASSWORD), Options(only=["1.*"]))
    assert set(report.counts) == {Verdict.FAILED, Verdict.NON_STRICT}  # the latter where the case is a SHOULD


@pytest.mark.parametrize(
    "reply",
    [
        b'{"type":"auth_success"}',
        b'{"type":"auth_success","protocol":NaN}',
        b"[]",
        b"\xff",
        b'{"type":["auth_success"]}',
        b'{"type":"tick","frame":"x"}',
        b"{" * 100_000,
    ],
)
def test_invalid_answers_are_failures_of_the_server_not_of_the_suite(reply: bytes) -> None:
    with listening(lambda connection: connection.sendall((reply + DELIMITER) * 20)) as port:
        report = run(Target("127.0.0.1", port, PASSWORD, timeout=0.3), Options(only=["1.*", "3.10*", "4.3*"]))
    assert report.counts[Verdict.FAULT] == 0
    assert report.exit_status == 1


# -- the search -------------------------------------------------------------------------------------------------------

# None is a new seed each time. One that has found a mistake of our server is added here, and stays.
SEEDS = [pytest.param(None, marks=pytest.mark.long, id="new")]


@pytest.mark.parametrize("seed", SEEDS)
def test_the_search_finds_no_mistake_of_our_server(seed: int | None) -> None:
    seed = secrets.randbits(32) if seed is None else seed
    with served() as server:
        report = judge(server, "17.*", seed=seed)
        assert (seed, bad(report)) == (seed, [])
        assert report.counts[Verdict.OK] == 4


def test_where_two_things_are_wrong_the_search_takes_an_error_about_either(tmp_path: Path) -> None:
    spawn = {"type": "spawn_cube", "cube_name": "{c0}"}
    wrong = {**spawn, "shape": "capsule", "size": 1.0}  # which is no longer than wide, and a name that was taken
    commands = [spawn, wrong, {"type": "despawn_cube", "cube_name": "{c0}"}, wrong]
    script = [{"client": 0, "command": command} for command in commands]
    (tmp_path / "case.json").write_text(json.dumps({"nmes.conform.case": 1, "script": script}))
    with served({"backend": "mujoco"}) as server:
        outcome = cli(f"127.0.0.1:{server.port}", "--replay", str(tmp_path / "case.json"))
    assert (outcome.exit_code, "fixed" in outcome.output) == (0, True), outcome.output


def own_the_base_of_another(monkeypatch: pytest.MonkeyPatch) -> None:
    spawn = COMMANDS["spawn_cube"]

    def broken(world: World, client: Any, command: dict[str, Any]) -> dict[str, Any]:
        reply = spawn(world, client, command)
        for other in world._clients.values():
            other.owned = reply["spawned"]
        return reply

    monkeypatch.setitem(COMMANDS, "spawn_cube", broken)


def test_the_search_finds_the_shortest_conversation(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    with served() as server:
        address = f"127.0.0.1:{server.port}"
        with monkeypatch.context() as defect:
            own_the_base_of_another(defect)
            outcomes = [process(address, "--only", "17.1:0", "--json", "--seed", "3") for _ in range(2)]
            scripts = [json.loads(output)["results"][0]["script"] for _, output in outcomes]
            assert [status for status, _ in outcomes] == [1, 1]
            assert scripts[0] == scripts[1]  # same seed, same run
            assert len(scripts[0]) == 2
            assert scripts[0][0]["client"] != scripts[0][1]["client"]
            (saved,) = tmp_path.iterdir()
            status, output = process(address, "--replay", str(saved))
            assert (status, "failing" in output) == (1, True)
        status, output = process(address, "--replay", str(saved))
        assert (status, "fixed" in output) == (0, True)
        assert server.call(server.hosted.world.cubes) == []


@pytest.mark.parametrize("seed", range(2))
def test_a_server_that_errs_now_and_then_fails_and_is_no_fault_of_the_suite(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Under load a server is late now and then: asked the same again, it answers as it should."""
    reply, draw = Session.reply, random.Random(seed)

    def err(session: Session, request: Request, encoded: bytes) -> bytes:
        return reply(session, request, encoded if draw.random() > 0.02 else b'{"type":"pong"}')

    monkeypatch.setattr(Session, "reply", err)
    with served() as server:
        report = judge(server, "17.*")
    assert [(r.case.number, r.reason) for r in report.results if r.verdict is Verdict.FAULT] == []
    assert report.exit_status == 1


@pytest.mark.parametrize(
    "text", ["", "{}", '{"nmes.conform.case":1,"script":[{"client":7,"command":{"type":"ping"}}]}']
)
def test_an_unknown_case_is_wrong_usage(text: str, tmp_path: Path) -> None:
    (tmp_path / "case.json").write_text(text)
    outcome = cli("127.0.0.1:1", "--replay", str(tmp_path / "case.json"))
    assert outcome.exit_code == 2
    assert "no case of nmes conform" in outcome.output


# -- a run that ends early, and what failures have in common -----------------------------------------------------------


def lose_ids(monkeypatch: pytest.MonkeyPatch) -> None:
    reply = Session.reply

    def lose(session: Session, request: Request, encoded: bytes) -> bytes:
        return re.sub(rb',?"id":("[^"]*"|[0-9.]+|null)', b"", reply(session, request, encoded))

    monkeypatch.setattr(Session, "reply", lose)


def test_a_server_that_drops_ids_is_judged_without_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    """What cleans up after a case waits for no `id` that never comes: that would cost a time-out a case."""
    lose_ids(monkeypatch)
    with served() as server:
        report = run(Target("127.0.0.1", server.port, PASSWORD, timeout=0.5), Options(only=["5.*", "10.*", "14.*"]))
        assert server.call(server.hosted.world.cubes) == []
    assert report.counts[Verdict.FAILED] > 50
    notes = [entry.data for result in report.results for entry in result.log if entry.wire == "cleaner"]
    assert notes == []


def test_failures_of_one_cause_are_summed_up(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    lose_ids(monkeypatch)
    with served() as server:
        arguments = [f"127.0.0.1:{server.port}", "--only", "5.1", "--only", "5.8:*", "--only", "5.10"]
        junit, page = tmp_path / "out.xml", tmp_path / "out.html"
        text = cli(*arguments, "--junit", str(junit), "--report", str(page))
        document = json.loads(cli(*arguments, "--json").output)
    failed = [result["case"] for result in document["results"] if result["verdict"] == "failed"]
    assert document["causes"] == {"a reply without its id": failed} and len(failed) > 4
    assert (
        f"{len(failed):>5}  a reply without its id: {', '.join(failed[:3])} and {len(failed) - 3} more" in text.output
    )
    assert {failure.get("type") for failure in ElementTree.parse(junit).iter("failure")} == {"a reply without its id"}
    assert f"<td class='n'>{len(failed)}<td>a reply without its id<td><a href='#c{failed[0]}'>" in page.read_text()


def test_the_words_of_a_server_are_no_cause() -> None:
    """A cause is printed as it is: what a stranger calls a message must not be in it."""
    with listening(lambda connection: connection.sendall(b'{"type":"\\u001b[31m"}' + DELIMITER)) as port:
        report = run(Target("127.0.0.1", port, PASSWORD), Options(only=["4.3:object"]))
    assert [*report.causes] == ["a message of no known type against its schema"]


def test_silence_and_hanging_up_are_each_one_cause() -> None:
    only = Options(only=["3.1", "4.3:*", "8.14"])
    with listening(lambda connection: None) as port:
        silent = run(Target("127.0.0.1", port, PASSWORD, timeout=0.2), only)
    with listening(lambda connection: connection.shutdown(socket.SHUT_RDWR)) as port:
        gone = run(Target("127.0.0.1", port, PASSWORD), only)
    assert [*silent.causes] == ["nothing in time"]
    assert set(gone.causes) <= {"a connection closed by the server", "a connection reset by the server"}
    assert len(next(iter(silent.causes.values()))) == silent.counts[Verdict.FAILED] > 3


def test_fail_fast_ends_at_the_first_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    """What waits beside the case that fails is cut off, what comes later is not begun; the world is left as it was."""
    reply = Session.reply

    def err(session: Session, request: Request, encoded: bytes) -> bytes:
        return reply(session, request, b'{"type":"pong"}' if request.type == "step" else encoded)

    monkeypatch.setattr(Session, "reply", err)
    with served({"mode": "fast"}) as server:
        arguments = ["--only", "1.*", "--only", "10.*", "--only", "12.6", "--fail-fast", "--json"]
        outcome = cli(f"127.0.0.1:{server.port}", *arguments)
        assert server.call(lambda: (server.hosted.world.mode, server.hosted.world.paused)) == ("fast", False)
        until(lambda: server.call(lambda: server.host.connections) == 0)
    report = json.loads(outcome.output)
    failed = [result["case"] for result in report["results"] if result["verdict"] == "failed"]
    assert outcome.exit_code == 1
    assert report["halted"] == f"ended at the first failure, {failed[0]}"
    left = [result["case"] for result in report["results"] if result["reason"] == report["halted"]]
    assert "12.6" in left and len(left) > 10  # which waits for ten seconds, and those that had yet to begin


def test_a_time_limit_ends_what_waits_and_is_not_conformance() -> None:
    with served() as server:
        arguments = [f"127.0.0.1:{server.port}", "--only", "1.1", "--only", "12.6"]
        outcome = cli(*arguments, "--time-limit", "1.5")
        assert outcome.exit_code == 2
        assert "could not be judged" in outcome.output and "the time limit of 1.5 s was over" in outcome.output
        enough = cli(*arguments[:3], "--time-limit", "600")
    assert (enough.exit_code, "time limit" in enough.output) == (0, False)


def test_a_time_limit_cuts_a_case_that_waits_for_an_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    reply = Session.reply

    def keep_silent(session: Session, request: Request, encoded: bytes) -> bytes:
        return b"" if request.type == "ping" else reply(session, request, encoded)

    monkeypatch.setattr(Session, "reply", keep_silent)
    with served() as server:
        target = Target("127.0.0.1", server.port, PASSWORD, timeout=100 * PATIENCE)
        (result,) = run(target, Options(only=["5.1"], time_limit=1.0)).results
    assert (result.verdict, result.reason) == (Verdict.SKIPPED, "the time limit of 1 s was over")


def test_a_time_limit_ends_a_run_against_a_silent_server() -> None:
    with listening(lambda connection: None) as port:
        report = run(Target("127.0.0.1", port, PASSWORD, timeout=0.2), Options(time_limit=2.0))
    assert report.halted == "the time limit of 2 s was over"
    assert report.exit_status == 1 and report.counts[Verdict.FAILED] > 0
    assert report.counts[Verdict.SKIPPED] > 500


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interruption_leaves_the_world_as_it_was(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    reply, started = Session.reply, threading.Event()
    processes: list[subprocess.Popen[str]] = []

    def interrupt(session: Session, request: Request, encoded: bytes) -> bytes:
        if request.type != "step":
            return reply(session, request, encoded)
        started.wait()
        processes[0].send_signal(number)
        return b""

    monkeypatch.setattr(Session, "reply", interrupt)
    with served({"mode": "realtime"}) as server:
        arguments = [f"127.0.0.1:{server.port}", "--only", "11.6", "--timeout", "300"]
        with subprocess.Popen(
            [sys.executable, "-m", "nmes", "conform", *arguments],
            env={**os.environ, "NMES_PASSWORD": PASSWORD}, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        ) as process:  # fmt: skip
            processes.append(process)
            started.set()
            output, errors = process.communicate(timeout=PATIENCE * 4)
        assert (process.returncode, output) == (2, "")
        assert errors == "Error: interrupted before all was judged\n"
        assert server.call(server.hosted.world.cubes) == []
        assert server.call(lambda: (server.hosted.world.mode, server.hosted.world.paused)) == ("realtime", False)


# -- the command line -------------------------------------------------------------------------------------------------


def test_an_unreachable_server_exits_2() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    outcome = cli(f"127.0.0.1:{port}")
    assert outcome.exit_code == 2
    assert "nothing answers" in outcome.output


def test_a_wrong_password_exits_2() -> None:
    with served() as server:
        outcome = cli(f"127.0.0.1:{server.port}", "--password", "wrong")
    assert outcome.exit_code == 2
    assert "refuses that password" in outcome.output


@pytest.mark.parametrize(
    "arguments", [("--only", "99.*"), ("--category", "manners"), (), ("nowhere",), ("127.0.0.1:1", "--timeout", "0")]
)
def test_wrong_usage_exits_2(arguments: tuple[str, ...]) -> None:
    assert cli(*arguments).exit_code == 2


def test_a_failure_is_printed_and_exits_1() -> None:
    with listening(lambda connection: connection.sendall(b'{"type":"pong"}' + DELIMITER)) as port:
        outcome = cli(f"127.0.0.1:{port}", "--only", "1.1", "--timeout", "0.5")
    assert outcome.exit_code == 1
    assert "failed 1.1" in outcome.output
    assert 'received  {"type": "pong"}' in outcome.output
    assert CLAUSES["1.1.2"] in outcome.output


def test_the_list_names_every_case() -> None:
    outcome = cli("--list")
    assert outcome.exit_code == 0
    assert [line.split()[0] for line in outcome.output.splitlines()[:-1]] == [case.number for case in CASES]
    assert json.loads(cli("--list", "--json", "--category", "auth").output)[0]["case"] == "2.1"


def test_every_report_format_holds_all_results(tmp_path: Path) -> None:
    with listening(lambda connection: connection.sendall(b'{"type":"<b>"}' + DELIMITER)) as port:
        page, junit = tmp_path / "out.html", tmp_path / "out.xml"
        arguments = ["--only", "1.1", "--only", "3.14", "--timeout", "0.5", "--seed", "7", "--json"]
        outcome = cli(f"127.0.0.1:{port}", *arguments, "--report", str(page), "--junit", str(junit))
    assert outcome.exit_code == 1
    report = json.loads(outcome.output)
    failed, skipped = report["results"]
    assert (report["seed"], report["suite"]["hash"]) == (7, suite_hash())
    assert (failed["verdict"], failed["clause"], skipped["verdict"]) == ("failed", "1.1.2", "skipped")
    assert skipped["reason"] == "not claimed: get_planets"
    assert {entry["kind"] for entry in failed["log"]} >= {"sent", "received"}
    text = page.read_text()
    for part in (
        suite_hash(),
        "seed 7",
        html.escape(failed["expected"]),
        "not claimed: get_planets",
        "&lt;b&gt;",
        "does not conform",
    ):
        assert part in text
    assert '<b>"' not in text and "http" not in text  # nothing unescaped, nothing from elsewhere
    suites = ElementTree.parse(junit).getroot()
    assert [(suite.get("failures"), suite.get("skipped")) for suite in suites] == [("1", "0"), ("0", "1")]


@pytest.mark.parametrize("option", ["--report", "--junit"])
def test_a_report_that_cannot_be_written_is_found_before_anything_is_judged(option: str, tmp_path: Path) -> None:
    came: list[socket.socket] = []
    with listening(came.append) as port:
        outcome = cli(f"127.0.0.1:{port}", "--only", "1.1", option, str(tmp_path / "no" / "such" / "x"))
    assert outcome.exit_code == 2 and came == []
    assert outcome.stderr.startswith("Error: cannot write ") and outcome.stdout == ""


@pytest.mark.parametrize("option", ["--report", "--junit"])
def test_what_was_judged_is_printed_where_a_report_is_too_large_for_the_disk(option: str, tmp_path: Path) -> None:
    with served() as server, full_disk(100):
        judged = [f"127.0.0.1:{server.port}", "--only", "1.1", "--json"]
        outcome = cli(*judged, option, str(tmp_path / "x"))
    assert outcome.exit_code == 2 and "cannot write" in outcome.stderr and not [*tmp_path.iterdir()]
    assert json.loads(outcome.stdout)["results"][0]["verdict"] == "ok"


def test_what_was_judged_is_printed_where_a_conversation_cannot_be_saved(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    own_the_base_of_another(monkeypatch)
    with served() as server, full_disk(100):
        status, output = process(f"127.0.0.1:{server.port}", "--only", "17.1:0", "--seed", "3")
    assert status == 1 and "does not conform" in output and "--replay" not in output
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize(
    "options", [["--json"], ["--report", "x"], ["--junit", "x"], ["--only", "1.*"], ["--seed", "0"], ["--list"]]
)
def test_an_option_of_the_whole_suite_does_not_go_with_one_conversation(options: list[str], tmp_path: Path) -> None:
    (tmp_path / "case.json").write_text("{}")
    outcome = cli("127.0.0.1:1", "--replay", str(tmp_path / "case.json"), *options)
    assert outcome.exit_code == 2 and "--replay plays one conversation" in outcome.stderr


# -- as tests of somebody else ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("spoken", "status"), [(None, 0), (b'{"type":"pong"}', 1)])
def test_the_cases_run_as_pytest_tests(spoken: bytes | None, status: int, tmp_path: Path) -> None:
    with ExitStack() as stack:
        if spoken is None:
            port = stack.enter_context(served()).port
        else:
            port = stack.enter_context(listening(lambda connection: connection.sendall(spoken + DELIMITER)))
        selection = ["--pyargs", "nmes.conformance", "-k", "1.14 or 3.14", "-p", "no:cacheprovider", "-p", "no:asyncio"]
        target = ["--nmes-target", f"127.0.0.1:{port}", "--nmes-password", PASSWORD, "--nmes-timeout", "5"]
        plugin = ["-p", "nmes.conformance.plugin"]
        command = [sys.executable, "-m", "pytest", "-q", *plugin, *selection, *target]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == status, done.stdout + done.stderr
    count = sum("1.14" in case.number or "3.14" in case.number for case in CASES)
    assert (f"{count} passed" if spoken is None else "failed: 1.14 An error about") in done.stdout


# -- the cases themselves ---------------------------------------------------------------------------------------------


def test_numbers_are_unique_and_clauses_exist() -> None:
    assert len({case.number for case in CASES}) == len(CASES) >= 700
    assert {case.clause for case in CASES} <= CLAUSES.keys()
    assert select(Options(only=["4.3:null"]))[0].number == "4.3:null"


def test_a_category_of_several_files_has_their_cases_first_and_none_twice() -> None:
    part, other = Category(20, "parts"), Category(20, "parts")
    for category, number in ((part, 2), (part, 1), (other, 3)):
        category.case(number, "1.1.1")(ping)
    whole = Category(20, "parts", parts=(part, other))
    whole.case(4, "1.1.1")(ping)
    assert [case.number for case in whole] == ["20.2", "20.1", "20.3", "20.4"]
    with pytest.raises(ValueError, match=r"two cases 20\.3"):
        whole.case(3, "1.1.1")(ping)
    with pytest.raises(ValueError, match=r"two cases 20\.2"):
        Category(20, "parts", parts=(part, part))


def ping(trial: Trial) -> None:
    """The server answers."""
    trial.fence(trial.join())


def test_every_clause_has_a_case_or_a_reason_for_none() -> None:
    used = {case.clause for case in CASES}
    codes = {address for address in CLAUSES if address.startswith("4.error.")}
    assert CLAUSES.keys() - codes <= used | UNTESTED.keys() <= CLAUSES.keys()
    assert not used & UNTESTED.keys()


def test_the_table_of_cases_is_up_to_date() -> None:
    # `python -m nmes.conformance > docs/conformance-cases.md`
    assert (ROOT / "docs" / "conformance-cases.md").read_text() == page()


def test_the_clauses_quote_the_protocol() -> None:
    words = " ".join((ROOT / "docs" / "protocol.md").read_text().split())
    for address, sentence in CLAUSES.items():
        if not address.startswith("4."):
            assert " ".join(sentence.split()) in words, address
