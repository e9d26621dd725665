"""Processes are started whole, whatever signal comes meanwhile."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import util
from multiprocessing.connection import Connection

import pytest

from nmes.evaluation.processes import signals_deferred, start_process
from processes import signal_handler


@contextmanager
def another_thread() -> Iterator[None]:
    """A thread that does nothing: the system gives it the signals that the main thread holds back."""
    over = threading.Event()
    thread = threading.Thread(target=over.wait)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def answer(pipe: Connection, number: int) -> None:
    """What a process does here: with nobody to answer to, it complains."""
    pipe.send((number, signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())))


def test_a_process_is_started_that_calls_a_function_and_holds_ctrl_c_back() -> None:
    process, pipe = start_process(answer, 7)
    assert pipe.recv() == (7, True)
    with pytest.raises(EOFError):
        pipe.recv()
    process.join()
    assert process.exitcode == 0
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_ctrl_c_while_a_process_is_begun_comes_when_it_has_all_it_needs(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    begun: list[int] = []
    begin = util.spawnv_passfds

    def interrupted(path: bytes, arguments: Sequence[str], passed: Sequence[int]) -> int:
        begun.append(begin(path, arguments, passed))
        taken, told = os.pipe()
        os.set_blocking(told, False)
        before = signal.set_wakeup_fd(told)
        os.kill(os.getpid(), signal.SIGINT)
        os.read(taken, 1)  # the other thread has taken it, upon which Python handles it in this one
        signal.set_wakeup_fd(before)
        os.close(taken)
        os.close(told)
        return begun[-1]

    with another_thread(), signal_handler(signal.SIGINT, signal.default_int_handler):
        first, pipe = start_process(answer, 1)  # what tracks the memory of processes is there now
        assert pipe.recv()[0] == 1
        first.join()
        monkeypatch.setattr(util, "spawnv_passfds", interrupted)
        with pytest.raises(KeyboardInterrupt):
            start_process(answer, 2)
    assert len(begun) == 1
    with pytest.raises(ProcessLookupError):  # nobody would know of it
        os.kill(begun[0], 0)
    assert capfd.readouterr().err == ""


def test_signals_that_are_held_back_come_at_the_end_in_their_order() -> None:
    came: list[int] = []

    def note(number: int, _: object) -> None:
        came.append(number)

    with signal_handler(signal.SIGINT, note), signal_handler(signal.SIGTERM, note):
        with signals_deferred():
            signal.raise_signal(signal.SIGTERM)
            signal.raise_signal(signal.SIGINT)
            assert came == []
        assert came == [signal.SIGTERM, signal.SIGINT]


def test_another_thread_starts_processes_too() -> None:
    told: list[object] = []

    def start() -> None:
        process, pipe = start_process(answer, 3)
        told.append(pipe.recv())
        process.join()

    thread = threading.Thread(target=start)
    thread.start()
    thread.join()
    assert told == [(3, True)]
