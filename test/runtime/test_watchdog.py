"""The watchdog ends what hangs, and not what was stopped."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pytest
from child_processes import child

# an executor that turns, or hangs, for a while
CODE = """
import sys, threading, time
from denoc_ros.kernels.jit import compiling
from denoc_ros.runtime.loop.ending import Watchdog

watchdog = Watchdog(1.0, compiling.at_work)
watchdog.begin('node', lambda: print('saved', flush=True))
print('begun', flush=True)
if 'compiles' in sys.argv[1]:
    compiling._in_thread(lambda: time.sleep(3.0), None)
    print('compiled', flush=True)
    if sys.argv[1] == 'compiles':
        sys.exit()
for _ in range(60 if sys.argv[1] == 'turns' else 400):
    if sys.argv[1] == 'turns':
        watchdog.beat()
    time.sleep(0.05)
watchdog.stop()
"""


@pytest.mark.long_cases(
    'turns-0-', 'compiles-0-compiled\\n', 'compiles and hangs-1-compiled\\nsaved\\n'
)
@pytest.mark.parametrize(
    ('does', 'status', 'said'),
    [
        ('turns', 0, ''),
        ('hangs', 1, 'saved\n'),
        ('compiles', 0, 'compiled\n'),
        ('compiles and hangs', 1, 'compiled\nsaved\n'),
    ],
)
def test_a_process_that_was_stopped_or_compiles_does_not_count_as_hung(
    does: str, status: int, said: str
) -> None:
    command = [sys.executable, '-c', CODE, does]
    with child(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as it:
        assert it.stdout is not None
        assert it.stdout.readline() == 'begun\n'
        if does == 'turns':
            it.send_signal(signal.SIGSTOP)
            time.sleep(1.7)  # more than the patience, less than twice
            it.send_signal(signal.SIGCONT)
        assert it.wait(60.0) == status
        assert it.stdout.read() == said
