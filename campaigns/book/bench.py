"""Benchmark: check results, then time them beside their peers."""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from book.benchmarks import derivatives, growth, rigid
from book.benchmarks.limits import Account, accounts
from book.benchmarks.peers import flexible_chain, rigid_chain
from book.benchmarks.results import BenchCheck, BenchLine, Reach, relative_error
from book.benchmarks.rigid import TOLERANCE
from book.benchmarks.timing import FULL, QUICK, Spread, Times

from denoc_ros.cli.arguments import add_json, add_option
from denoc_ros.cli.session.session_config import find_file
from denoc_ros.dynamics.robot import load_robot
from denoc_ros.errors import DenocError
from denoc_ros.python_start import code_words
from denoc_ros.terminal_text import say

GROUPS = (
    'inverse', 'forward', 'inertia', 'derivatives', 'ssrms', 'springs', 'loops', 'growth', 'dense',
    'batch', 'load', 'operations',
)  # fmt: skip
SSRMS = 'config/robots/ssrms.urdf'
WRONG = 2
LARGEST = 5  # kernels that are named with their share of the operations
DESCRIPTION = (
    'Check the results of the dynamics against Pinocchio and dense solutions, then time both in '
    'turn in this process. The result is their ratios. Exit status 2 if a result is wrong; '
    'speed never changes it.'
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_option(
        parser, '--only NAME', f'groups to run, of {", ".join(GROUPS)}', nargs='+', choices=GROUPS
    )
    add_option(
        parser,
        '--quick',
        'check everything with less work, in seconds; times and limits then mean nothing',
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Run the groups and return the exit status; errors are raised."""
    groups = args.only or (GROUPS if not args.quick else [g for g in GROUPS if g != 'load'])
    # standard output is for JSON
    show: Callable[[str], object] = str if args.json else partial(print, flush=True)
    show(_heading())
    lines, accounts = [], []
    for line in measured_lines(groups, args.quick):
        lines.append(line)
        show(line_text(line))
    for account in counted_operations(groups, args.quick):
        accounts.append(account)
        show(_account_text(account))
    if args.json:
        report = {
            'machine': machine(),
            'lines': [line.record() for line in lines],
            'operations': [account.record() for account in accounts],
        }
        say(json.dumps(report, indent=2, allow_nan=False))
    wrong = {line.what: line.check for line in lines}
    wrong |= {f'{each.verb}, {each.case}': each.check for each in accounts}
    wrong = {what: check for what, check in wrong.items() if not check.good}
    for what, check in wrong.items():
        say(
            f'bench: {what}: result must agree with {check.against} to '
            f'{check.tolerance:.3g}, got {check.error:.3g}',
            file=sys.stderr,
        )
    return WRONG if wrong else 0


def machine() -> dict[str, Any]:
    """Return the machine of the measurement: processors, load, versions."""
    found: dict[str, Any] = {
        'processor': _processor(),
        'cores': os.cpu_count(),
        'load_average': [round(load, 2) for load in os.getloadavg()],
        'python': platform.python_version(),
    }
    for package in ('denoc_ros', 'numba', 'numpy', 'scipy', 'pin'):
        try:
            found[package] = version(package)
        except ImportError:
            found[package] = None
    return found


def measured_lines(groups: Collection[str], quick: bool) -> Iterator[BenchLine]:
    """Yield the lines of the groups as they are found.

    Parameters
    ----------
    quick : bool
        Check on less, and call only a few times: no line has a reach then.
    """
    effort = QUICK if quick else FULL
    ssrms = find_file(Path(SSRMS), Path()) or Path(SSRMS)
    parts: dict[str, Callable[[], Iterator[BenchLine]]] = {
        'inverse': lambda: rigid.inverse_lines(effort),
        'forward': lambda: rigid.forward_lines(effort),
        'inertia': lambda: rigid.inertia_lines(effort),
        'derivatives': lambda: derivatives.derivative_lines(ssrms, effort, quick),
        'ssrms': lambda: rigid.ssrms_lines(ssrms, effort),
        'springs': lambda: growth.spring_lines(ssrms.parent / 'ur10.urdf', effort),
        'loops': lambda: rigid.loop_lines(ssrms.parent, effort),
        'growth': lambda: chain(growth.growth_lines(effort, quick), growth.segment_lines(effort)),
        'dense': lambda: growth.dense_lines(effort, quick),
        'batch': lambda: rigid.batch_lines(effort, quick),
        'load': lambda: load_lines(ssrms, cold=not quick),
    }
    for name, lines in parts.items():
        if name in groups:
            for line in lines():
                yield replace(line, reach=None) if quick else line


def counted_operations(groups: Collection[str], quick: bool) -> Iterator[Account]:
    """Yield the operations per call where 'operations' is among the groups."""
    if 'operations' not in groups:
        return
    yield from accounts(QUICK if quick else FULL, quick)


def _heading() -> str:
    told = ', '.join(f'{name} {value}' for name, value in machine().items())
    columns = (
        'value [quartiles over blocks] (reach) | ours median / p99 | peer median / p99 | '
        'largest error of the check'
    )
    return f'{told}\n{columns}\n'


def line_text(line: BenchLine) -> str:
    """Return a line of the table for a terminal."""
    checked = f'error {line.check.error:.1e} of {line.check.tolerance:.1e} ({line.check.against})'
    head = f'{line.what}  |  {line.against}'
    if line.value is None:
        return f'{head}\n    {line.verdict or "checked"}: {checked}'
    value = f'{line.value.value:.3g} [{line.value.low:.3g}, {line.value.high:.3g}]'
    if line.unit != 'ratio':
        value += f' {line.unit}'
    if line.reach is not None:
        value += f' ({line.reach.sense} {line.reach.value:g}: {line.verdict})'
    times = [
        f'{name} {_time(each.median)} / {_time(each.p99)}'
        for name, each in (('ours', line.ours), ('peer', line.peer))
        if each is not None
    ]
    note = f'\n    {line.note}' if line.note else ''
    return f'{head}\n    {" | ".join([value, *times, checked])}{note}'


def _account_text(account: Account) -> str:
    """Return operations and where the time goes for a terminal."""
    count = account.operations
    text = (
        f'{account.verb}, {account.case}, {account.coordinates} coordinates\n'
        f'    {count.multiplications} M, {count.additions} A, {count.divisions} divisions, '
        f'{count.roots} roots, {count.trigonometric} T'
    )
    most = list(account.shares.items())[:LARGEST]
    text += f'\n    most of it: {", ".join(f"{kernel} {number}" for kernel, number in most)}'
    printed = '; '.join(f'{who} {m} M, {a} A' for who, (m, a) in account.printed.items())
    if printed:
        text += f'\n    printed: {printed}'
    budget = account.budget
    if budget is not None:
        parts = ', '.join(f'{name} {_time(each)}' for name, each in budget.parts.items())
        text += (
            f'\n    call {_time(budget.call)} = {budget.call / budget.ideal:.1f} x the ideal '
            f'machine, kernel {budget.kernel / budget.ideal:.1f} x: {parts}'
        )
    return text


def _time(seconds: float) -> str:
    if abs(seconds) < 1e-3:
        return f'{1e6 * seconds:.2f} us'
    return f'{1e3 * seconds:.2f} ms' if seconds < 1.0 else f'{seconds:.2f} s'


def _processor() -> str:
    try:
        for row in Path('/proc/cpuinfo').read_text().splitlines():
            if row.startswith('model name'):
                return row.partition(':')[2].strip()
    except OSError:
        pass
    return 'unknown'


# from starting a process to the first torque, and loading of large files -------------------------

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
    limit = Reach(reach)
    return BenchLine('load', what, against, check, 's', Spread.of(each), limit, times, note=note)


def _first_torque(file: Path, environment: dict[str, str]) -> dict[str, Any]:
    """Run the first torque in a fresh process; return its times, torque and output."""
    start = time.monotonic()
    run = subprocess.run(
        [sys.executable, *code_words(FIRST_TORQUE, str(file))],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=COLD_PATIENCE,
    )
    if run.returncode != 0:
        raise DenocError(f'a fresh process must give a torque, it said: {run.stderr[-500:]}')
    found: dict[str, Any] = json.loads(run.stdout.splitlines()[-1])
    return {**found, 'start': start, 'said': run.stderr}
