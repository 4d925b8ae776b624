"""`denoc bench`: check results, then time them beside their peers."""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import Any

from denoc_ros.cli.arguments import add_json, add_option
from denoc_ros.cli.config import find_file
from denoc_ros.studies.benchmarks import derivatives, growth, loading, rigid
from denoc_ros.studies.benchmarks.limits import Account, accounts
from denoc_ros.studies.benchmarks.results import BenchLine
from denoc_ros.studies.benchmarks.timing import FULL, QUICK

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
    """Declare the verb's arguments."""
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
    """Run the verb and return the exit status; errors are raised."""
    # the dense peer on one thread, like everything else; read when numpy is first imported
    os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
    groups = args.only or (GROUPS if not args.quick else [g for g in GROUPS if g != 'load'])
    show = _silent if args.json else _print
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
        print(json.dumps(report, indent=2, allow_nan=False))
    wrong = {line.what: line.check for line in lines}
    wrong |= {f'{each.verb}, {each.case}': each.check for each in accounts}
    wrong = {what: check for what, check in wrong.items() if not check.good}
    for what, check in wrong.items():
        print(
            f'denoc bench: {what}: result must agree with {check.against} to '
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
        'load': lambda: loading.load_lines(ssrms, cold=not quick),
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


def _print(text: str) -> None:
    print(text, flush=True)


def _silent(_: str) -> None:
    """Suppress progress: standard output is for JSON."""


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
