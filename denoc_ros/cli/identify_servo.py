"""`denoc identify servo`: bandwidth, damping, delay and gain of position-controlled joints."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from denoc_ros.bags.digest import file_hash
from denoc_ros.bags.joint_table import TableTimes, joint_columns, joints_with, table_times
from denoc_ros.bags.series import JointSeries, read_joint_states
from denoc_ros.bags.tables import is_table, read_table
from denoc_ros.cli.arguments import add_stamp, add_times, named_values, times_findings
from denoc_ros.cli.identify_inputs import add_recording_options
from denoc_ros.cli.identify_outputs import give_result
from denoc_ros.cli.verbs import ACTIONS
from denoc_ros.errors import BagError, ConfigError, IdentificationError
from denoc_ros.identification.commands import Commands, read_commands
from denoc_ros.identification.modes import NOT_IDENTIFIABLE, worst
from denoc_ros.identification.result import plain
from denoc_ros.identification.servo import Run, ServoFit, fit_servo_runs
from denoc_ros.reports.identify_servo import servo_page
from denoc_ros.reports.pages import ReportPage
from denoc_ros.reports.text_table import text_table
from denoc_ros.reports.versions import versions
from denoc_ros.types import Array

Document = dict[str, Any]

FIELDS = ('position', 'command')  # of a joint, in a table


def add_actions(actions: Any) -> None:
    """Declare the action's arguments."""
    parser = actions.add_parser(
        'servo',
        help=ACTIONS['servo'],
        description=(
            'Fit a second-order lag with a delay and a static gain to the commanded and the '
            'measured positions of joints; several recordings are fitted together. The result is '
            "the shaper's `servo.*`."
        ),
    )
    add_recording_options(parser, several=True)
    group = parser.add_argument_group('the signals')
    group.add_argument(
        '--command',
        dest='commanded',
        metavar='TOPIC',
        default='/reference',
        help=(
            'topic of the commands: JointTrajectory, whole or streamed, or JointState; '
            'default: /reference'
        ),
    )
    group.add_argument(
        '--topic',
        default='/joint_states',
        help='topic of the measured JointState; default: /joint_states',
    )
    group.add_argument(
        '--column',
        action='append',
        default=[],
        metavar='JOINT.FIELD=COLUMN',
        help='column of a table with what a joint is told (FIELD command) or its position; '
        'default: columns such as elbow/command and elbow/position; repeatable',
    )
    group.add_argument(
        '--joint',
        action='append',
        metavar='NAME',
        help='joint to identify; repeatable; default: all commanded joints',
    )
    add_stamp(group)
    add_times(group)
    group.add_argument(
        '--begin', metavar='S', type=float, default=0.0, help='since the first measurement [s]'
    )
    group.add_argument(
        '--end',
        metavar='S',
        type=float,
        default=float('inf'),
        help='since the first measurement [s]',
    )
    parser.set_defaults(act=run_servo)


def run_servo(args: argparse.Namespace) -> int:
    """Identify; exit status 0 good, 2 doubtful, 3 not identifiable."""
    findings = times_findings(args)
    if not args.begin < args.end:
        findings.append(f'--begin must be < --end, got {args.begin:g}')
    columns = named_values('--column', args.column, 'JOINT.FIELD=COLUMN', str, findings)
    ConfigError.raise_any('identify servo', findings)
    read = [_runs(path, args, columns) for path in args.path]
    names = list(dict.fromkeys(name for runs in read for name in runs))
    fits, curves = [], []
    for name in names:
        own = [runs[name] for runs in read if name in runs]
        fit = _fit(name, own)
        fits.append(fit)
        curves.append(_behind_each_other(own))
    document = servo_result(args, fits, [run for runs in read for run in runs.values()])

    def page() -> ReportPage:
        return servo_page(document, fits, curves, args.command)

    return give_result(args, document, as_text(document), page)


def _runs(path: Path, args: argparse.Namespace, columns: dict[str, str]) -> dict[str, Run]:
    """Return times, commands and positions of each joint of a bag or a table."""
    if is_table(path):
        return _of_table(path, args, columns)
    if columns:
        raise BagError(f'{path}: --column must come with a table, got a bag')
    return _of_bag(path, args)


def _of_bag(path: Path, args: argparse.Namespace) -> dict[str, Run]:
    commands = read_commands(path, args.commanded, args.stamp)
    names = _joints(args, commands.names, args.commanded)
    measured = read_joint_states(path, args.topic, names, args.stamp)
    t, rows = _grid(path, args, commands, measured)
    told = commands.at(t, names)
    found = {}
    for k, name in enumerate(names):
        whole = unbroken(told[:, k])
        found[name] = (t[whole], told[whole, k], rows[whole, k])
    return found


def _of_table(path: Path, args: argparse.Namespace, columns: dict[str, str]) -> dict[str, Run]:
    given = read_table(path)
    told = [name.rpartition('.')[0] for name in columns]
    known = list(dict.fromkeys([*told, *joints_with(given, FIELDS)]))
    if not known:
        raise BagError(
            f'{path}: table must have what a joint is told and its position (columns such as '
            f'elbow/command and elbow/position, or --column elbow.command=COLUMN and '
            f'elbow.position=COLUMN), got {", ".join(list(given)[:20])}'
        )
    names = _joints(args, known, f'the columns of {path}')
    found = joint_columns(path, given, names, _only(columns, names), FIELDS)
    runs = {}
    for name in names:
        if missing := [field for field in FIELDS if (name, field) not in found]:
            raise BagError(
                f'{path}: {name} must have a column of its {missing[0]}, got '
                f'{", ".join(list(given)[:20])}: --column {name}.{missing[0]}=COLUMN'
            )
        command, position = (given[found[name, field]] for field in ('command', 'position'))
        times = TableTimes(args.time, args.time_unit, args.rate)
        _, _, t = table_times(path, given, times, len(position))
        if not len(command) == len(position) == len(t):
            raise BagError(
                f'{path}: columns of {name} must be as long as the times ({len(t)}), got '
                f'{len(command)} and {len(position)}'
            )
        whole = np.isfinite(t) & np.isfinite(command) & np.isfinite(position)
        t, command, position = t[whole], command[whole], position[whole]
        later = np.concatenate(([True], np.diff(np.maximum.accumulate(t)) > 0.0))[: len(t)]
        t, command, position = t[later], command[later], position[later]
        if len(t) < 2:
            raise BagError(f'{path}: {name} must have two rows with times, got {len(t)}')
        grid = np.arange(
            t[0] + max(args.begin, 0.0),
            min(t[-1], t[0] + args.end) + 1e-9,
            float(np.median(np.diff(t))),
        )
        runs[name] = (grid, np.interp(grid, t, command), np.interp(grid, t, position))
    return runs


def _only(columns: dict[str, str], names: Sequence[str]) -> dict[str, str]:
    return {what: one for what, one in columns.items() if what.rpartition('.')[0] in names}


def _behind_each_other(runs: Sequence[Run]) -> Run:
    """Return times, commands and positions of runs, one behind the other on one clock."""
    start, times = 0.0, []
    for t, _, _ in runs:
        times.append(t - t[0] + start if len(t) else t)
        start += float(t[-1] - t[0]) + float(t[1] - t[0]) if len(t) > 1 else 0.0
    first, told, was = zip(*runs, strict=True)
    if len(runs) == 1:
        return first[0], told[0], was[0]
    return np.concatenate(times), np.concatenate(told), np.concatenate(was)


def unbroken(values: Array) -> Any:
    """Say which values (k,) are finite, up to the first gap after the first one."""
    finite = np.isfinite(values)
    first = int(np.argmax(finite)) if finite.any() else len(values)
    later = np.flatnonzero(~finite[first:])
    last = first + int(later[0]) if len(later) else len(values)
    return slice(first, last)


def _joints(args: argparse.Namespace, names: Sequence[str], where: str) -> list[str]:
    chosen = list(args.joint or names)
    unknown = [name for name in chosen if name not in names]
    if unknown:
        raise ConfigError(
            'identify servo', [f'--joint must be of {list(names)} on {where}, got {unknown}']
        )
    return chosen


def _grid(
    path: Path, args: argparse.Namespace, commands: Commands, measured: JointSeries
) -> tuple[Array, Array]:
    """Return times (k,) in equal steps by the commands' clock, and positions (k, joints) then."""
    whole = measured.since(commands.begin_ns).rising().complete()
    t = whole.t
    first = float(t[0]) if len(t) else 0.0
    low, high = max(0.0, first + args.begin), min(float(t[-1]), first + args.end) if len(t) else 0
    if len(t) < 2 or high <= low:
        raise IdentificationError(
            f'{path}: {args.topic} must have positions after the first command on '
            f'{args.commanded}, got none'
        )
    step = float(np.median(np.diff(t)))
    grid = np.arange(low, high, step)
    rows = [np.interp(grid, t, column) for column in whole.position.T]
    return grid, np.column_stack(rows)


def _fit(name: str, runs: Sequence[Run]) -> ServoFit | str:
    """Return the fit, or why there is none."""
    try:
        return fit_servo_runs(name, runs)
    except IdentificationError as error:
        return str(error)


def servo_result(
    args: argparse.Namespace, fits: list[ServoFit | str], runs: Sequence[Run]
) -> Document:
    """Return all that is kept of an identification of servos."""
    found = [fit for fit in fits if not isinstance(fit, str)]
    joints = {
        fit.joint: {
            'bandwidth_hz': fit.bandwidth,
            'damping': fit.damping,
            'delay_s': fit.delay,
            'gain': fit.gain,
            'lag_s': fit.lag,
            'interval': fit.interval,
            'offset': fit.offset,
            'lag_rms': fit.distance,
            'residual_rms': fit.residual,
            'runs': fit.runs,
            'verdict': fit.verdict,
            'reasons': fit.reasons,
        }
        for fit in found
    }
    none = [fit for fit in fits if isinstance(fit, str)]
    reasons = [f'{fit.joint}: {reason}' for fit in found for reason in fit.reasons]
    verdict = worst(tuple(fit.verdict for fit in found)) if found else NOT_IDENTIFIABLE
    document = {
        'kind': 'servo',
        'source': {
            'file': _named(args.path),
            'sha256': ', '.join(file_hash(path) for path in args.path),
            'topic': args.topic,
            'command': args.commanded,
            'stamp': args.stamp,
            'calibration': {},
        },
        'window': {'begin_s': args.begin, 'end_s': args.end},
        'quality': {
            'samples': max((len(t) for t, _, _ in runs), default=0),
            'step_s': max((float(t[1] - t[0]) for t, _, _ in runs if len(t) > 1), default=0.0),
        },
        'method': 'second-order lag with a delay and a gain, output error, least squares',
        'joints': joints,
        'not_moved': none,
        'verdict': verdict,
        'reasons': reasons,
        'versions': versions(),
    }
    return dict(plain(document))


def _named(paths: Sequence[Path]) -> str:
    others = f' and {len(paths) - 1} more' if len(paths) > 1 else ''
    return f'{paths[0]}{others}'


def as_text(document: Document) -> str:
    """Return a result's lines for a terminal, with the shaper's parameters."""
    source = document['source']
    joints = document['joints']
    rows = [
        {
            'joint': name,
            'bandwidth [Hz]': one['bandwidth_hz'],
            'bandwidth 95 %': one['interval']['bandwidth'],
            'damping': one['damping'],
            'damping 95 %': one['interval']['damping'],
            'delay [s]': one['delay_s'],
            'delay 95 %': one['interval']['delay'],
            'gain': one['gain'],
            'gain 95 %': one['interval']['gain'],
            'lag [s]': one['lag_s'],
            'verdict': one['verdict'],
        }
        for name, one in joints.items()
    ]
    lines = [f'{source["file"]}: {source["topic"]} after {source["command"]}']
    lines += [text_table(rows)] if rows else []
    lines += [f'  {reason}' for reason in (*document['not_moved'], *document['reasons'])]
    for name, key in (('bandwidth', 'bandwidth_hz'), ('damping', 'damping'), ('delay', 'delay_s')):
        if joints and not document['not_moved']:
            values = ', '.join(f'{one[key]:.4g}' for one in joints.values())
            lines.append(f'servo.{name}: [{values}]')
    return '\n'.join([*lines, f'verdict: {document["verdict"]}'])
