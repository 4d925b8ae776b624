"""Signals to a command that has to end other processes in order."""

from __future__ import annotations

import os
import signal
import time
from contextlib import nullcontext, suppress

import pytest

from denoc_ros.cli.interrupts import NUMBERS, Interrupt, Interrupts, interrupt


@pytest.mark.parametrize('number', NUMBERS)
def test_every_signal_interrupts_once(number: int) -> None:
    before = signal.getsignal(number)
    with Interrupts():
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), number)
        for again in NUMBERS:
            os.kill(os.getpid(), again)
    assert signal.getsignal(number) == before


def test_what_is_held_is_done_first() -> None:
    done = []
    with Interrupts() as interrupts, pytest.raises(KeyboardInterrupt):  # noqa: PT012
        with interrupts.held():
            with interrupts.held():
                os.kill(os.getpid(), signal.SIGTERM)
            os.kill(os.getpid(), signal.SIGTERM)
            done.append('whole')
        done.append('beyond')
    assert done == ['whole']


def test_an_interrupt_that_came_to_nothing_comes_again() -> None:
    with Interrupts() as interrupts:
        interrupts.check()
        with suppress(KeyboardInterrupt):  # as a callback of a C library does
            os.kill(os.getpid(), signal.SIGINT)
        with interrupts.held():
            interrupts.check()
        with pytest.raises(KeyboardInterrupt):
            interrupts.check()


def test_an_error_inside_goes_before_the_interrupt() -> None:
    with Interrupts() as interrupts, pytest.raises(ValueError, match='here'), interrupts.held():  # noqa: PT012
        os.kill(os.getpid(), signal.SIGINT)
        raise ValueError('here')


def test_a_process_deaf_to_hangups_stays_so() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with Interrupts():
            os.kill(os.getpid(), signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_process_that_ends_stays_deaf() -> None:
    before = signal.getsignal(signal.SIGTERM)
    try:
        with pytest.raises(KeyboardInterrupt), Interrupts(is_process=True):
            os.kill(os.getpid(), signal.SIGTERM)
        assert [signal.getsignal(number) for number in NUMBERS] == [signal.SIG_IGN] * len(NUMBERS)
    finally:
        for number in NUMBERS:
            signal.signal(number, signal.default_int_handler if number == 2 else before)


def test_an_interrupt_in_a_finalizer_comes_again(capsys: pytest.CaptureFixture[str]) -> None:
    class Finalized:
        def __del__(self) -> None:
            os.kill(os.getpid(), signal.SIGINT)

    begin = time.monotonic()
    with pytest.raises(KeyboardInterrupt), Interrupts():  # noqa: PT012
        Finalized()
        time.sleep(60.0)
    assert time.monotonic() - begin < 30.0  # it ends the wait
    assert 'Traceback' not in capsys.readouterr().err


@pytest.mark.parametrize('handled', ['command', 'session'])
def test_an_interrupt_within_the_compiler_waits_for_its_end(handled: str) -> None:
    """Raised while a kernel was loaded, it ended in SIGSEGV."""
    done: list[int] = []
    within = {'__name__': 'llvmlite.binding.ffi', 'os': os, 'signal': signal, 'done': done}
    within['call'] = lambda: time.sleep(0.1)
    exec('def load():\n os.kill(os.getpid(), signal.SIGINT)\n call()\n done.append(1)', within)
    before = signal.getsignal(signal.SIGINT)
    begin = time.monotonic()
    try:
        if handled == 'command':
            signal.signal(signal.SIGINT, interrupt)
        with Interrupts() if handled == 'session' else nullcontext(), pytest.raises(Interrupt):  # noqa: PT012
            within['load']()  # type: ignore[operator]
            time.sleep(60.0)
    finally:
        signal.signal(signal.SIGINT, before)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
    assert done == [1]
    assert time.monotonic() - begin < 30.0


def test_an_error_made_of_an_interrupt_is_the_interrupt() -> None:
    with pytest.raises(KeyboardInterrupt), Interrupts():  # noqa: PT012
        try:
            os.kill(os.getpid(), signal.SIGINT)
        except KeyboardInterrupt as interrupt:  # as a C extension while it is imported
            raise ImportError('initialization failed') from interrupt


def test_an_error_at_the_end_of_an_interrupted_command_is_told() -> None:
    with pytest.raises(OSError, match='disk'), Interrupts():  # noqa: PT012
        try:
            os.kill(os.getpid(), signal.SIGINT)
        finally:
            raise OSError('disk')
