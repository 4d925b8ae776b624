"""Signals that ask a process to end, honoured from its first moment on."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
NODES = ('feedforward', 'predictor', 'recorder', 'plant', 'viewer', 'shaper')


class Interrupted(BaseException):
    """A signal came while the node was being built: nothing moves yet, the start is given up."""


class EndSignals:
    """Handling of SIGINT, SIGTERM and SIGHUP: first an end at once, then the wanted one.

    Attributes
    ----------
    received : list of int
        Those kept so far.
    """

    def __init__(self) -> None:
        self.received: list[int] = []
        self._at_once = False
        self._interrupts = False

    def end_at_once(self) -> None:
        """Let a signal end the process with status 0: there is nothing yet to be ended."""
        self._at_once = True
        self._install()

    def keep(self) -> None:
        """Only note signals from here on."""
        self._at_once = False
        self._install()

    @contextmanager
    def interrupting(self) -> Iterator[None]:
        """Raise Interrupted inside this block at the first signal, or for one that was kept."""
        self._interrupts = True
        try:
            if self.received:  # looked at last: one that comes meanwhile raises by itself
                raise Interrupted
            yield
        finally:
            self._interrupts = False

    def _install(self) -> None:
        for number in ENDING:
            # nohup is to be obeyed; what a script starts in the background is deaf to SIGINT,
            # and must not be
            deaf = number == signal.SIGHUP and signal.getsignal(number) == signal.SIG_IGN
            if not deaf:
                signal.signal(number, self._on_signal)

    def _on_signal(self, number: int, _frame: FrameType | None) -> None:
        if self._at_once:
            os._exit(0)
        self.received.append(number)
        if self._interrupts:
            self._interrupts = False  # once: the end that follows must not be interrupted
            raise Interrupted


SIGNALS = EndSignals()


def begin() -> None:
    """Honour signals, with a message, while a node's process imports its modules.

    Does nothing where the process is no node's.
    """
    name = started_node()
    if name:
        SIGNALS.end_at_once()
        with suppress(OSError, ValueError):
            print(f'{name}: starting', flush=True)


def started_node() -> str:
    """Return which node this process was started as, '' for none."""
    command = sys.argv[0] if sys.argv else ''
    if command == '-m':  # while the package is imported for `python -m denoc_ros.nodes.<name>`
        package, _, name = sys.orig_argv[sys.orig_argv.index('-m') + 1].rpartition('.')
        return name if package == 'denoc_ros.nodes' and name in NODES else ''
    name = Path(command).name.removeprefix('denoc-')
    installed = Path(command).name != name or Path(command).parent.name == 'denoc_ros'
    return name if installed and name in NODES else ''
