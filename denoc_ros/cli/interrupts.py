"""Ctrl-C, SIGTERM and SIGHUP for a command that must end other processes in order."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from types import FrameType, TracebackType
from typing import Any

NUMBERS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
SOON = 0.02  # s
COMPILER = ('llvmlite', 'numba')  # an exception within their work makes them crash


class Interrupt(KeyboardInterrupt):
    """A signal asks the command to end.

    A class of its own: once a plain KeyboardInterrupt has passed through code made from a string
    (each dataclass is), Python ends the process by SIGINT, even if the exception was caught.
    """


def interrupt(_number: int, frame: FrameType | None) -> None:
    """Handle a signal: raise Interrupt, where kernels are loaded as soon as they are."""
    if is_in_compiler(frame):
        come_again(interrupt)
    else:
        raise Interrupt


def is_in_compiler(frame: FrameType | None) -> bool:
    """Say whether a frame is one of the compiler, or was called by one."""
    while frame is not None:
        if str(frame.f_globals.get('__name__')).partition('.')[0] in COMPILER:
            return True
        frame = frame.f_back
    return False


def come_again(handler: Callable[[int, FrameType | None], None]) -> None:
    """Have a signal's handler called again soon, without a thread: a lock may be held."""
    signal.signal(signal.SIGALRM, handler)
    signal.setitimer(signal.ITIMER_REAL, SOON)


def is_made_by_interrupt(error: BaseException) -> bool:
    """Say whether an interrupt caused an error: an import that it ends raises another one."""
    cause = error.__cause__
    return cause is not None and (
        isinstance(cause, KeyboardInterrupt) or is_made_by_interrupt(cause)
    )


@contextmanager
def noted_interrupts() -> Iterator[None]:
    """Put Ctrl-C off to the end of the block; other threads than the main one never get it.

    For imports: libraries swallow what is raised in them, and the command would go on.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    noted: list[int] = []
    handler = signal.signal(signal.SIGINT, lambda number, _: noted.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
        if noted:
            signal.raise_signal(signal.SIGINT)


@contextmanager
def deferred_interrupts() -> Iterator[None]:
    """Put Ctrl-C off to the end of the block, in the main thread.

    Threads and processes that start in the block never get it.
    """
    resource_tracker.ensure_running()  # it would unblock SIGINT where a process is spawned
    with noted_interrupts():
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)


class Interrupts:
    """Raises Interrupt at the first signal, and at no further one: the end goes on.

    As a context manager it takes the signals over for a while. Python swallows what is raised in a
    finalizer: then it is raised again soon after.

    Parameters
    ----------
    is_process : bool
        Whether the process ends after the first signal: then it stays deaf to others, which would
        change its status on its last way.
    """

    def __init__(self, is_process: bool = False) -> None:
        self._is_process = is_process
        self._before: dict[int, Callable[..., Any] | int | None] = {}
        self._held = 0
        self._waits = self._raised = False
        self._hook = sys.unraisablehook

    def __enter__(self) -> Interrupts:
        """Take the signals over; nohup is obeyed."""
        for number in NUMBERS:
            if number == signal.SIGHUP and signal.getsignal(number) == signal.SIG_IGN:
                continue
            self._before[number] = signal.signal(number, self._on_signal)
        self._hook, sys.unraisablehook = sys.unraisablehook, self._on_swallowed
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Give the signals back; an error that an interrupt made becomes the interrupt again."""
        sys.unraisablehook = self._hook
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, before in self._before.items():
            stays_deaf = self._raised and self._is_process
            signal.signal(number, signal.SIG_IGN if stays_deaf else before)
        if error is not None and is_made_by_interrupt(error):
            raise Interrupt from error

    @contextmanager
    def held(self) -> Iterator[None]:
        """Defer signals during the block, so that its work is completed."""
        self._held += 1
        try:
            yield
        finally:
            self._held -= 1
        if self._waits and not self._held:
            self._interrupt()

    def check(self) -> None:
        """Raise a swallowed interrupt again: not every caller passes an Interrupt on.

        For work that goes on only while there was no signal, not for an end.
        """
        if self._raised and not self._held:
            raise Interrupt

    def _on_signal(self, _number: int, frame: FrameType | None) -> None:
        if self._held:
            self._waits = True
        elif is_in_compiler(frame):
            come_again(self._on_signal)
        else:
            self._interrupt()

    def _on_swallowed(self, swallowed: sys.UnraisableHookArgs) -> None:
        if swallowed.exc_type is not Interrupt:
            self._hook(swallowed)
            return
        self._raised = False
        come_again(self._on_signal)

    def _interrupt(self) -> None:
        self._waits = False
        if not self._raised:
            self._raised = True
            raise Interrupt
