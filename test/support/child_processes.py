"""Processes that a test starts: none outlives the test, and none is waited for without end."""

from __future__ import annotations

import subprocess
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

LIFETIME = 600.0  # s: minutes longer than any of them needs on a machine four times slower


@contextmanager
def child(
    command: Sequence[str], lifetime: float = LIFETIME, **options: Any
) -> Iterator[subprocess.Popen[str]]:
    """Run a process with text streams, killed when the block ends or its lifetime [s] is over.

    A read of what it prints has an end, too, then: no process of the test holds the pipe.
    """
    with subprocess.Popen(command, text=True, **options) as process:
        timer = threading.Timer(lifetime, process.kill)
        timer.daemon = True
        timer.start()
        try:
            yield process
        finally:
            timer.cancel()
            process.kill()
