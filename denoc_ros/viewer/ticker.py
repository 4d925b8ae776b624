"""A thread that calls a function at a steady rate while it is needed."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable


class Ticker:
    """Calls back at a period, less often when a call takes longer than that.

    Parameters
    ----------
    period : float [s]
    tick : callable
        Takes the time since the last call [s].
    """

    def __init__(self, period: float, tick: Callable[[float], None]) -> None:
        self._period, self._tick = period, tick
        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None
        self._guard = threading.Lock()

    @property
    def running(self) -> bool:
        """Whether it ticks."""
        return self._thread is not None and not self._stopped.is_set()

    def start(self) -> None:
        """Start ticking; nothing if it does already."""
        with self._guard:
            if not self.running:
                self._stopped = threading.Event()
                arguments = (self._stopped,)
                self._thread = threading.Thread(target=self._run, args=arguments, daemon=True)
                self._thread.start()

    def stop(self) -> None:
        """Stop ticking; a call under way is not waited for."""
        self._stopped.set()

    def _run(self, stopped: threading.Event) -> None:
        last = time.monotonic()
        while not stopped.wait(max(0.0, last + self._period - time.monotonic())):
            now = time.monotonic()
            self._tick(now - last)
            last = now
