"""A process that does jobs of parts: jobs on standard input, answers on standard output.

:class:`denoc_ros.runtime.worker.worker.Planner` starts it. It ends with its input, or with the
process that started it.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
import time
from contextlib import suppress
from functools import cache
from importlib import import_module
from typing import Any, BinaryIO

from denoc_ros.dynamics.driven.measured_side import measured_robot
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import DenocError
from denoc_ros.parts import parts
from denoc_ros.runtime.worker.worker_messages import read_message, write_message
from denoc_ros.types import Array

LOOK = 0.5  # s between looks whether the parent is there
PR_SET_PDEATHSIG = 1  # of <linux/prctl.h>


class Worker:
    """Answers jobs, with the robot of the last one at hand."""

    def __init__(self) -> None:
        self._base: tuple[Any, Robot] | None = None
        self._changed: tuple[Any, Robot] | None = None

    def robot(self, wanted: dict[str, Any]) -> Robot:
        """Return the robot of a job: `source`, `gravity`, `geometric_stiffness`, `overrides`."""
        key = wanted['source'], tuple(wanted['gravity']), wanted['geometric_stiffness']
        if self._base is None or self._base[0] != key:
            self._base = key, measured_robot(load_robot(*key))
            self._changed = None
        overrides = wanted['overrides']
        if self._changed is None or self._changed[0] != overrides:
            base = self._base[1]
            self._changed = overrides, base.with_overrides(overrides) if overrides else base
        return self._changed[1]

    def answer(
        self, header: dict[str, Any], arrays: dict[str, Array]
    ) -> tuple[dict[str, Any], dict[str, Array]]:
        """Return the answer to a job, with `error` where it failed."""
        began = time.perf_counter()
        try:
            robot = self.robot(header['robot'])
            answer, rows = _job_module(header['job']).answer(robot, header, arrays)
        except (DenocError, OSError) as error:
            answer, rows = {'error': str(error)}, {}
        except Exception as error:  # a defect of ours must not end the process
            answer, rows = {'error': f'{type(error).__name__}: {error}'}, {}
        return {**answer, 'id': header['id'], 'took': time.perf_counter() - began}, rows


@cache
def _job_module(job: str) -> Any:
    """Return the module of the part that does a kind of job."""
    known = {name: module for part in parts().values() for name, module in part.jobs.items()}
    return import_module(f'denoc_ros.{known[job]}')


def serve(jobs: BinaryIO, answers: BinaryIO) -> None:
    """Answer jobs until there are no more."""
    worker = Worker()
    while (job := read_message(jobs)) is not None:
        write_message(answers, *worker.answer(*job))


def main() -> None:
    """Serve the process that started this one, and end with it."""
    parent = os.getppid()
    _end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(LOOK)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
    # what anything prints must not get between the answers
    answers = os.fdopen(os.dup(sys.stdout.fileno()), 'wb')
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    try:
        serve(sys.stdin.buffer, answers)
    except BrokenPipeError:
        os._exit(1)


def _end_with_parent() -> None:
    """Have the kernel kill this process when its parent ends, even while it is stopped."""
    with suppress(OSError, AttributeError):  # where there is no Linux, `watch` ends it
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
