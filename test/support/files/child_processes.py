"""Processes that a test starts: none outlives the test, and none is waited for without end."""

from __future__ import annotations

import subprocess
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
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


def children(pid: int) -> list[int]:
    """Return the processes that one has started and that have not been waited for."""
    found: list[int] = []
    for task in Path(f'/proc/{pid}/task').glob('*/children'):
        found += map(int, task.read_text().split())
    return found


def gone(pid: int) -> bool:
    """Say whether there is no such process, or nothing is left but its status."""
    try:
        stat = Path(f'/proc/{pid}/stat').read_bytes()
    except OSError:
        return True
    return stat.rpartition(b')')[2].split()[0] == b'Z'
