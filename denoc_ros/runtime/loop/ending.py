"""How a process ends: signals that ask it to, and the watchdog over an executor that hangs."""

from __future__ import annotations

import faulthandler
import gc
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

from denoc_ros.terminal_text import say

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
NODES = ('feedforward', 'predictor', 'recorder', 'plant', 'viewer', 'shaper')
HUNG = 1  # exit status
LOOKS = 5  # at least, each without a beat, before an executor counts as hung


class Interrupted(BaseException):
    """A signal came while the node was being built: nothing moves yet, the start is given up."""


class EndSignals:
    """Handling of SIGINT, SIGTERM and SIGHUP: first an end at once, then the wanted one."""

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
        gc.disable()  # modules stay: the node collects once a second, when it is there
        with suppress(OSError, ValueError):
            say(f'{name}: starting', flush=True)


def started_node() -> str:
    """Return which node this process was started as, '' for none."""
    command = sys.argv[0] if sys.argv else ''
    # While the package is imported for `python -m denoc_ros.nodes.<name>`, or by `module_words`.
    module = sys.orig_argv[sys.orig_argv.index('-m') + 1] if command == '-m' else command
    package, _, name = module.rpartition('.')
    if package == 'denoc_ros.nodes':
        return name if name in NODES else ''
    file = Path(command)
    # The module of a node of a part is already found when it imports the nodes.
    if file.suffix == '.py' and file.parents[1].name == 'denoc_ros':
        return file.stem if file.stem in NODES else ''
    name = file.name.removeprefix('denoc-')
    installed = file.name != name or file.parent.name == 'denoc_ros'
    return name if installed and name in NODES else ''


class Watchdog:
    """Ends the process unless, once begun, :meth:`beat` is called often enough.

    It prints where every thread stands, then calls `save`, which must not need the main thread.
    Where even this thread gets no turn, because the interpreter's lock is held for good, a thread
    that needs no interpreter prints and ends the process after twice the patience.

    Parameters
    ----------
    patience : float
        s between two beats.
    works : callable, optional
        Whether the process does now what may take longer, such as compiling: a beat.
    """

    def __init__(self, patience: float, works: Callable[[], bool] = lambda: False) -> None:
        self._name, self._patience, self._works = '', patience, works
        self._save: Callable[[], None] = _nothing
        self._last = time.monotonic()
        self._over = threading.Event()

    def begin(self, name: str, save: Callable[[], None]) -> None:
        """Watch from here on."""
        self._name, self._save = name, save
        self.beat()
        self._arm()
        threading.Thread(target=self._watch, name='watchdog', daemon=True).start()

    def beat(self) -> None:
        """Say that the executor turns."""
        self._last = time.monotonic()

    def forget(self) -> None:
        """Have nothing to save any more: it has been closed."""
        self._save = _nothing

    def stop(self) -> None:
        """Watch no longer."""
        self._over.set()
        faulthandler.cancel_dump_traceback_later()

    def _arm(self) -> None:
        faulthandler.dump_traceback_later(2.0 * self._patience, exit=True)

    def _watch(self) -> None:
        seen, looks = self._last, 0
        while not self._over.wait(self._patience / LOOKS):
            self._arm()
            if self._works():
                self.beat()
            # counted: after the whole process or machine stood still both threads are late
            looks = looks + 1 if seen == self._last else 0
            seen = self._last
            still = time.monotonic() - seen
            if still > self._patience and looks >= LOOKS:
                say(
                    f'{self._name}: its executor must turn within {self._patience:g} s, '
                    f'got nothing for {still:.1f} s; the process ends itself',
                    file=sys.stderr,
                )
                faulthandler.dump_traceback(file=sys.stderr)
                sys.stderr.flush()
                try:
                    self._save()
                finally:
                    os._exit(HUNG)
        faulthandler.cancel_dump_traceback_later()  # it may have been set after stop cancelled it


def _nothing() -> None:
    """Save nothing."""
