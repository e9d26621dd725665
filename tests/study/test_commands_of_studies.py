"""Commands of a study's runs: how they end, what they are given, and what is beside them; and runs that end badly."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterable
from concurrent.futures import Future, wait
from pathlib import Path
from typing import Any

import pytest

from command_line import run
from nmes.errors import StudyError
from nmes.study import Study, run_study
from nmes.study.commands import Stopper
from nmes.study.document import PlannedRun
from nmes.study.run import count_done
from processes import process
from servers import PATIENCE
from studies import make_bare_study

CHECK = "nmes genome check walker --json"

Begun = Callable[[list[str], subprocess.Popen[bytes]], None]
"""Is told the words of a process, and the process, before anything else happens."""


def watch(monkeypatch: pytest.MonkeyPatch, begun: Begun) -> None:
    """Has each process that a study begins told to a function."""

    class Watched(Stopper):
        def begin(self, words: list[str], *others: Any) -> subprocess.Popen[bytes]:
            command = super().begin(words, *others)
            begun(words, command)
            return command

    monkeypatch.setattr("nmes.study.run.Stopper", Watched)


# -- how commands end -------------------------------------------------------------------------------------------------


def test_a_column_of_statuses_takes_none_of_a_command_that_did_not_do_its_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    commands = {"check": "nmes genome check nobody --json"}
    folder = make_bare_study(tmp_path / "bare", commands, {"status": "check status"})
    told = "run 0 (arm only, seed 1): nmes genome check nobody --json\n"
    result = run("study", "run", folder, "--jobs", "1")
    assert result.exit_code == 1
    assert f"{told}ended with status 2: " in result.output and "there is no file nobody" in result.output
    watch(monkeypatch, lambda words, begun: begun.kill())
    result = run("study", "run", folder, "--jobs", "1")
    assert result.exit_code == 1 and f"{told}was killed by signal 9: it said nothing" in result.output


# -- what commands are given ------------------------------------------------------------------------------------------


TASK = {"format": "nmes-task/1", "name": "any", "duration": 1, "seeds": [1], "objective": "height"}


def told(folder: Path, arm: str = "", **commands: str) -> str:
    """Runs a study that is refused or in which a command fails, beside whose `study.toml` there is a task.

    Returns:
        What is said.
    """
    make_bare_study(folder, commands, dict.fromkeys(commands, f"{next(iter(commands))} status"), arm)
    (folder / "any.json").write_text(json.dumps({**TASK, "description": "Of {braces}, {seed}."}))
    result = run("study", "run", folder, "--jobs", "1")
    assert result.exit_code == (1 if result.output.startswith("Error: run 0 ") else 2), result.output
    return result.output


@pytest.mark.parametrize(
    ("pointer", "words"),
    [
        ("/limits/cubes", "nmes tasks 32 no"),
        ("/settle", "nmes tasks 0.5 no"),
        ("/development", "nmes tasks true no"),
        ("/objective/0", "printed nothing at /objective/0"),
    ],
)
def test_what_a_command_has_printed_is_given_to_others_as_it_was(pointer: str, words: str, tmp_path: Path) -> None:
    commands = {"first": "nmes tasks injury --json", "told": f"nmes tasks {{first{pointer}}} no"}
    assert words in told(tmp_path / "bare", **commands)


def test_null_is_nothing_that_a_command_can_be_given(tmp_path: Path) -> None:
    commands = {"first": "nmes backends --json", "told": "nmes tasks {first/0/defect}"}
    assert "nmes backends --json\nprinted null at /0/defect" in told(tmp_path / "bare", **commands)


def test_only_settings_have_placeholders_that_are_filled(tmp_path: Path) -> None:
    folder = tmp_path / "{none} {seed}"
    commands = {"first": "nmes tasks {task} --json", "told": "nmes tasks '{which} {first/description}' no"}
    output = told(folder, 'settings = { task = "{study}/any.json", which = "seed {seed} of {study}:" }', **commands)
    assert f"nmes tasks 'seed 1 of {folder}: Of {{braces}}, {{seed}}.' no\n" in output


@pytest.mark.parametrize(
    ("arm", "words"),
    [
        ('beside = { host = "nmes serve --port 0" }', "there is nothing that {host.port} stands for"),
        (
            'beside = { host = "nmes serve --json", one = "nmes worlds {last.port}", last = "nmes serve --json" }',
            "there is nothing that {last.port} stands for",
        ),
    ],
)
def test_a_placeholder_of_what_no_command_has_printed_yet_is_refused(arm: str, words: str, tmp_path: Path) -> None:
    assert words in told(tmp_path / "bare", arm, check=CHECK, told="nmes worlds {host.port}")


def test_a_placeholder_of_a_whole_output_is_refused(tmp_path: Path) -> None:
    output = told(tmp_path / "bare", check=CHECK, told="nmes tasks {check}")
    assert "there is nothing that {check} stands for" in output


def test_a_value_of_a_factor_has_no_placeholder_of_nothing(tmp_path: Path) -> None:
    folder = make_bare_study(tmp_path / "bare", {"check": "nmes genome check {name}"}, {"status": "check status"})
    path = folder / "study.toml"
    path.write_text(path.read_text().replace("[commands]", '[factors]\nname = ["{nobody}"]\n\n[commands]'))
    result = run("study", "run", folder)
    assert result.exit_code == 2 and "setting name: there is nothing that {nobody} stands for" in result.output


@pytest.mark.parametrize("name", ["nothing", "worlds"])
def test_what_a_command_beside_does_not_print_is_told(name: str, tmp_path: Path) -> None:
    arm = 'beside = { host = "nmes serve --backend ballistic --port 0 --no-record --json" }'
    output = told(tmp_path / "bare", arm, told=f"nmes worlds {{host.{name}}}")
    assert f"run 0 (arm only, seed 1): nmes worlds {{host.{name}}}\n" in output
    assert f"no text and no number was printed that {{host.{name}}} stands for" in output


def test_what_no_command_line_can_hold_is_told(tmp_path: Path) -> None:
    commands = {"first": "nmes tasks {study}/zero.json --json", "told": "nmes tasks {first/description}"}
    folder = tmp_path / "bare"
    make_bare_study(folder, commands, {"status": "told status"})
    (folder / "zero.json").write_text(json.dumps({**TASK, "description": "A \0."}))
    result = run("study", "run", folder, "--jobs", "1")
    assert result.exit_code == 1 and "cannot be begun: embedded null byte" in result.output, result.output


# -- what is beside them ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("nmes serve --no-such-option", "ended with status 2: "),
        ("nmes genome check walker", "ended with status 0: it said nothing"),
    ],
)
def test_a_command_beside_that_ends_before_the_others_stops_the_study(
    command: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def begun(words: list[str], beside: subprocess.Popen[bytes]) -> None:
        if "--json" not in words:
            beside.wait()

    watch(monkeypatch, begun)
    folder = make_bare_study(
        tmp_path / "bare", {"check": CHECK}, {"status": "check status"}, f'beside = {{ load = "{command}" }}'
    )
    result = run("study", "run", folder, "--jobs", "1")
    assert result.exit_code == 1
    told = f"run 0 (arm only, seed 1): load, beside it, did not last until the others were done: it {words}"
    assert told in result.output, result.output
    assert not list(folder.glob("work/*/done/*"))


def test_a_host_that_dies_beside_commands_is_told_and_not_what_they_say_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hosts: list[subprocess.Popen[bytes]] = []

    def begun(words: list[str], command: subprocess.Popen[bytes]) -> None:
        if "serve" in words:
            hosts.append(command)
        else:
            hosts[-1].kill()
            hosts[-1].wait()

    watch(monkeypatch, begun)
    commands = {"worlds": "nmes worlds {host.host}:{host.port} --password {host.password}"}
    arm = 'beside = { host = "nmes serve --backend ballistic --port 0 --no-record --json" }'
    result = run(
        "study", "run", make_bare_study(tmp_path / "bare", commands, {"s": "worlds status"}, arm), "--jobs", "1"
    )
    assert result.exit_code == 1
    assert "host, beside it, did not last until the others were done: it was killed by signal 9" in result.output


# -- when they are to end ---------------------------------------------------------------------------------------------


def test_a_command_that_does_not_end_when_it_is_told_to_is_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    commands: list[subprocess.Popen[bytes]] = []

    def begun(words: list[str], command: subprocess.Popen[bytes]) -> None:
        command.send_signal(signal.SIGSTOP)  # from then on SIGTERM is for later
        commands.append(command)

    def interrupt(done: int, total: int) -> None:
        if commands:
            raise KeyboardInterrupt

    watch(monkeypatch, begun)
    monkeypatch.setattr("nmes.study.commands._PATIENCE", 0.1)
    plan = Study.load(make_bare_study(tmp_path / "bare", {"check": CHECK}, {"status": "check status"})).plan("small")
    with pytest.raises(KeyboardInterrupt):
        run_study(plan, 1, interrupt)
    assert [command.returncode for command in commands] == [-signal.SIGKILL]


def test_commands_end_when_the_study_is_killed(tmp_path: Path) -> None:
    serve = "nmes serve --backend ballistic --port 0 --no-record --json"
    folder = make_bare_study(
        tmp_path / "bare", {"serve": serve}, {"status": "serve status"}, f'beside = {{ host = "{serve}" }}'
    )
    with process("study", "run", str(folder), "--jobs", "1") as study:
        ports = [_port(study, folder, name) for name in ("beside-host", "serve")]
        study.kill()
        study.wait(PATIENCE)
    until = time.monotonic() + PATIENCE
    while any(map(_answers, ports)):
        assert time.monotonic() < until, "a command goes on without its study"
        time.sleep(0.01)


def _port(study: subprocess.Popen[str], folder: Path, name: str) -> int:
    """Returns the port of a host that a study runs, once it is told."""
    while study.poll() is None:
        for path in folder.glob(f"work/*/under-way/*/{name}.out"):
            line, feed, _ = path.read_text().partition("\n")
            if feed:
                return int(json.loads(line)["port"])
        time.sleep(0.01)
    raise AssertionError(study.communicate())


def _answers(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), PATIENCE).close()
    except ConnectionError:
        return False
    return True


# -- runs that fail beside others -------------------------------------------------------------------------------------


def test_runs_that_are_done_when_others_fail_are_kept_and_the_first_failure_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = Study.load(make_bare_study(tmp_path / "bare", {"check": CHECK}, {"status": "check status"})).plan("small")
    together = threading.Barrier(3)

    def perform(study: Study, run: PlannedRun, *others: object) -> dict[str, object]:
        together.wait(PATIENCE)
        if run.number == 1:
            return {"status": 0.0}
        raise StudyError("command_failed", f"run {run.number} failed")

    def all_done(futures: Iterable[Future[Any]], *others: object) -> Any:
        return wait(futures, PATIENCE)

    monkeypatch.setattr("nmes.study.run.perform", perform)
    monkeypatch.setattr("nmes.study.run.wait", all_done)
    with pytest.raises(StudyError, match="run 0 failed"):
        run_study(plan, 3, lambda done, total: None)
    assert count_done(plan) == 1


def test_a_run_that_is_done_while_another_is_told_to_have_failed_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = Study.load(make_bare_study(tmp_path / "bare", {"check": CHECK}, {"status": "check status"})).plan("small")
    began, stopped = threading.Event(), threading.Event()

    class Told(Stopper):
        def stop(self) -> None:
            super().stop()
            stopped.set()

    def perform(study: Study, run: PlannedRun, *others: object) -> dict[str, object]:
        if run.number == 0:
            began.wait(PATIENCE)
            raise StudyError("command_failed", f"run {run.number} failed")
        began.set()
        stopped.wait(PATIENCE)
        return {"status": 0.0}

    monkeypatch.setattr("nmes.study.run.perform", perform)
    monkeypatch.setattr("nmes.study.run.Stopper", Told)
    with pytest.raises(StudyError, match="run 0 failed"):
        run_study(plan, 2, lambda done, total: None)
    assert count_done(plan) == 1  # and the third was not begun
