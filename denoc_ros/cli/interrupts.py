"""Ctrl-C, SIGTERM and SIGHUP for a command that must end other processes in order."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Any

NUMBERS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interrupts:
    """Raises KeyboardInterrupt at the first signal, and at no further one: the end goes on.

    As a context manager it takes the signals over for a while.

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

    def __enter__(self) -> Interrupts:
        """Take the signals over; nohup is obeyed."""
        for number in NUMBERS:
            if number == signal.SIGHUP and signal.getsignal(number) == signal.SIG_IGN:
                continue
            self._before[number] = signal.signal(number, self._on_signal)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Give the signals back."""
        for number, before in self._before.items():
            stays_deaf = self._raised and self._is_process
            signal.signal(number, signal.SIG_IGN if stays_deaf else before)

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
        """Raise a swallowed interrupt again: not every caller passes a KeyboardInterrupt on.

        For work that goes on only while there was no signal, not for an end.
        """
        if self._raised and not self._held:
            raise KeyboardInterrupt

    def _on_signal(self, _number: int, _frame: object) -> None:
        if self._held:
            self._waits = True
        else:
            self._interrupt()

    def _interrupt(self) -> None:
        self._waits = False
        if not self._raised:
            self._raised = True
            raise KeyboardInterrupt
