"""Watchdog: ends a process whose executor hangs, which no signal can end."""

from __future__ import annotations

import faulthandler
import os
import sys
import threading
import time
from collections.abc import Callable

HUNG = 1  # exit status
LOOKS = 5  # at least, each without a beat, before an executor counts as hung


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
        """Watch from here on.

        Parameters
        ----------
        name : str
            Whose executor it is, for the message.
        save : callable
            Called last, such as to close a file.
        """
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
                print(
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
