"""`denoc identify servo`: bandwidth, damping and delay of position-controlled joints."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from denoc_ros.cli.arguments import add_stamp
from denoc_ros.cli.identify_inputs import add_recording_options
from denoc_ros.errors import ConfigError, IdentificationError
from denoc_ros.reports.text_table import text_table

if TYPE_CHECKING:
    from denoc_ros.bags.series import JointSeries
    from denoc_ros.identification.commands import Commands
    from denoc_ros.identification.servo import ServoFit
    from denoc_ros.reports.pages import ReportPage
    from denoc_ros.types import Array

Document = dict[str, Any]


def add_actions(actions: Any) -> None:
    """Declare the action's arguments."""
    parser = actions.add_parser(
        'servo',
        help='bandwidth, damping and delay of position-controlled joints',
        description=(
            'Fit a second-order lag with a delay to the commanded and the measured positions '
            "of joints. The result is the shaper's `servo.*`."
        ),
    )
    add_recording_options(parser)
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
        '--joint',
        action='append',
        metavar='NAME',
        help='joint to identify; repeatable; default: all commanded joints',
    )
    add_stamp(group)
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
    from denoc_ros.bags.series import read_joint_states
    from denoc_ros.cli.identify_outputs import give_result
    from denoc_ros.identification.commands import read_commands

    if not args.begin < args.end:
        raise ConfigError('identify servo', [f'--begin must be < --end, got {args.begin:g}'])
    commands = read_commands(args.path, args.commanded, args.stamp)
    names = _joints(args, commands)
    measured = read_joint_states(args.path, args.topic, names, args.stamp)
    t, rows = _grid(args, commands, measured)
    told = commands.at(t, names)
    fits, curves = [], []
    for k, name in enumerate(names):
        whole = unbroken(told[:, k])
        fit = _fit(name, t[whole], told[whole, k], rows[whole, k])
        fits.append(fit)
        curves.append((t[whole], told[whole, k], rows[whole, k]))
    document = servo_result(args, fits, t)

    def page() -> ReportPage:
        from denoc_ros.reports.identify_servo import servo_page

        return servo_page(document, fits, curves, args.command)

    return give_result(args, document, as_text(document), page)


def unbroken(values: Array) -> Any:
    """Say which values (k,) are finite, up to the first gap after the first one."""
    import numpy as np

    finite = np.isfinite(values)
    first = int(np.argmax(finite)) if finite.any() else len(values)
    later = np.flatnonzero(~finite[first:])
    last = first + int(later[0]) if len(later) else len(values)
    return slice(first, last)


def _joints(args: argparse.Namespace, commands: Commands) -> list[str]:
    chosen = list(args.joint or commands.names)
    unknown = [name for name in chosen if name not in commands.names]
    if unknown:
        raise ConfigError(
            'identify servo',
            [f'--joint must be of {list(commands.names)} on {args.commanded}, got {unknown}'],
        )
    return chosen


def _grid(
    args: argparse.Namespace, commands: Commands, measured: JointSeries
) -> tuple[Array, Array]:
    """Return times (k,) in equal steps by the commands' clock, and positions (k, joints) then."""
    import numpy as np

    stamps = measured.stamp_ns
    whole = np.isfinite(measured.position).all(axis=1)
    whole &= np.concatenate(([True], stamps[1:] > np.maximum.accumulate(stamps)[:-1]))
    t = 1e-9 * (stamps[whole] - commands.begin_ns)
    first = float(t[0]) if len(t) else 0.0
    low, high = max(0.0, first + args.begin), min(float(t[-1]), first + args.end) if len(t) else 0
    if len(t) < 2 or high <= low:
        raise IdentificationError(
            f'{args.path}: {args.topic} must have positions after the first command on '
            f'{args.commanded}, got none'
        )
    step = float(np.median(np.diff(t)))
    grid = np.arange(low, high, step)
    position = measured.position[whole]
    rows = [np.interp(grid, t, position[:, k]) for k in range(position.shape[1])]
    return grid, np.column_stack(rows)


def _fit(name: str, t: Array, told: Array, was: Array) -> ServoFit | str:
    """Return the fit, or why there is none."""
    from denoc_ros.identification.servo import fit_servo

    try:
        return fit_servo(name, t, told, was)
    except IdentificationError as error:
        return str(error)


def servo_result(args: argparse.Namespace, fits: list[ServoFit | str], t: Array) -> Document:
    """Return all that is kept of an identification of servos."""
    from denoc_ros.bags.digest import file_hash
    from denoc_ros.identification.modes import NOT_IDENTIFIABLE, worst
    from denoc_ros.identification.result import plain
    from denoc_ros.reports.versions import versions

    found = [fit for fit in fits if not isinstance(fit, str)]
    joints = {
        fit.joint: {
            'bandwidth_hz': fit.bandwidth,
            'damping': fit.damping,
            'delay_s': fit.delay,
            'interval': fit.interval,
            'offset': fit.offset,
            'lag_rms': fit.lag,
            'residual_rms': fit.residual,
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
            'file': str(args.path),
            'sha256': file_hash(args.path),
            'topic': args.topic,
            'command': args.commanded,
            'stamp': args.stamp,
            'calibration': {},
        },
        'window': {'begin_s': args.begin, 'end_s': args.end},
        'quality': {'samples': len(t), 'step_s': float(t[1] - t[0]) if len(t) > 1 else 0.0},
        'method': 'second-order lag with a delay, output error, least squares',
        'joints': joints,
        'not_moved': none,
        'verdict': verdict,
        'reasons': reasons,
        'versions': versions(),
    }
    return dict(plain(document))


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
