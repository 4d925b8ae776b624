"""From starting a process to the first torque, and loading of large files."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from denoc_ros.dynamics.robot import load_robot
from denoc_ros.errors import DenocError
from denoc_ros.studies.benchmarks.peers import flexible_chain, rigid_chain
from denoc_ros.studies.benchmarks.results import (
    AT_MOST,
    BenchCheck,
    BenchLine,
    Reach,
    relative_error,
)
from denoc_ros.studies.benchmarks.rigid import TOLERANCE
from denoc_ros.studies.benchmarks.timing import Spread, Times

REACH_CACHED = 3.0  # s
REACH_COLD = 60.0  # s
REACH_LARGE = 2.0  # s
LARGE = 100  # links
REPEATS = 7
COLD_PATIENCE = 600.0  # s

# what a user's first lines do, in a process of its own; the clock is the machine's
FIRST_TORQUE = """
import json, logging, sys, time
began = time.monotonic()
logging.basicConfig(level=logging.INFO, format='%(message)s')
import denoc_ros, numpy
imported = time.monotonic()
robot = denoc_ros.load_robot(sys.argv[1])
loaded = time.monotonic()
tau = robot.inverse_dynamics(*numpy.full((3, robot.n), 0.01))
print(json.dumps({'began': began, 'imported': imported, 'loaded': loaded,
                  'end': time.monotonic(), 'tau': tau.tolist()}))
"""


def load_lines(file: Path, cold: bool) -> Iterator[BenchLine]:
    """Yield the time to a robot's first torque, kernels cached and cold, and that of 100 links.

    Parameters
    ----------
    cold : bool
        Whether to compile all kernels anew, which takes a minute.
    """
    robot = load_robot(file)
    expected = robot.inverse_dynamics(*np.full((3, robot.n), 0.01))
    runs = [_first_torque(file, {}) for _ in range(REPEATS + 1)][1:]
    parts = {
        'Python': np.median([run['began'] - run['start'] for run in runs]),
        'imports': np.median([run['imported'] - run['began'] for run in runs]),
        'load': np.median([run['loaded'] - run['imported'] for run in runs]),
    }
    yield _line(
        f'process start to first torque, {file.stem}, kernels cached', 'a fresh process each',
        [run['end'] - run['start'] for run in runs],
        _check([run['tau'] for run in runs], expected), REACH_CACHED,
        ', '.join(f'{name} {value:.2f} s' for name, value in parts.items()),
    )  # fmt: skip
    if cold:
        with tempfile.TemporaryDirectory() as folder:
            run = _first_torque(file, {'NUMBA_CACHE_DIR': folder})
        said = run['said'].strip().splitlines()
        yield _line(
            f'process start to first torque, {file.stem}, cold', 'an empty cache',
            [run['end'] - run['start']], _check([run['tau']], expected), REACH_COLD,
            f'progress line: {said[0]!r}' if said else 'no progress line',
        )  # fmt: skip
    for name, text in (
        ('rigid', rigid_chain(LARGE)),
        ('flexible, two modes per plane', flexible_chain(LARGE, 2, 2, 0)),
    ):
        yield _large(name, text)


def _large(name: str, text: str) -> BenchLine:
    took = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        robot = load_robot(text)
        took.append(time.perf_counter() - start)
    joints = len(robot.joint_names)
    check = BenchCheck(f'{LARGE} joints', abs(joints - LARGE), 0.0)
    return _line(
        f'load_robot, {LARGE} links, {name}', 'kernels cached', took, check, REACH_LARGE, ''
    )


def _check(torques: list[Any], expected: Any) -> BenchCheck:
    errors = [relative_error(torque, expected) for torque in torques]
    return BenchCheck('this process', max(errors), TOLERANCE)


def _line(
    what: str, against: str, took: list[float], check: BenchCheck, reach: float, note: str
) -> BenchLine:
    each = np.array(took)
    times = Times(float(np.median(each)), float(np.percentile(each, 99)), each)
    limit = Reach(AT_MOST, reach)
    return BenchLine('load', what, against, check, 's', Spread.of(each), limit, times, note=note)


def _first_torque(file: Path, environment: dict[str, str]) -> dict[str, Any]:
    """Run the first torque in a fresh process; return its times, torque and output."""
    start = time.monotonic()
    run = subprocess.run(
        [sys.executable, '-c', FIRST_TORQUE, str(file)],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=COLD_PATIENCE,
    )
    if run.returncode != 0:
        raise DenocError(f'a fresh process must give a torque, it said: {run.stderr[-500:]}')
    found: dict[str, Any] = json.loads(run.stdout.splitlines()[-1])
    return {**found, 'start': start, 'said': run.stderr}
