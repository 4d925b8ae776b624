"""Arguments that the actions of `denoc identify` share: signal, robot, window, calibration."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path

from denoc_ros.bags.reader import read_description
from denoc_ros.bags.tables import is_table
from denoc_ros.cli.arguments import (
    add_gravity,
    add_stamp,
    add_times,
    given_file,
    named_values,
    require,
    times_findings,
)
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import ConfigError
from denoc_ros.identification.channel import Channel


def add_recording_options(parser: argparse.ArgumentParser, several: bool = False) -> None:
    """Declare which recording is identified, or which several, and where the result goes."""
    if several:
        parser.add_argument('path', metavar='BAG', type=Path, nargs='+', help='bags or tables')
    else:
        parser.add_argument('path', metavar='BAG', type=Path, help='a bag or a table')
    parser.add_argument(
        '-o',
        '--output',
        metavar='FOLDER',
        type=Path,
        help='folder for result.yaml and report.html',
    )
    parser.add_argument('--json', action='store_true', help='print machine-readable JSON')


def add_channel_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options that select a signal of a file."""
    group = parser.add_argument_group('the signal')
    group.add_argument(
        '--topic', default='', help='topic of a bag, such as /predictor/tip_deflection'
    )
    group.add_argument(
        '--field',
        default='',
        help='name in a JointState (arm/uy), label of an array, dotted path in another message '
        '(wrench.force.x), or column of a table',
    )
    group.add_argument(
        '--quantity',
        choices=('position', 'velocity', 'effort'),
        default='position',
        help='quantity of a JointState; default: position',
    )
    add_stamp(group)
    add_times(group)
    group.add_argument('--gain', type=float, default=1.0, help='value = gain * raw + offset')
    group.add_argument(
        '--offset',
        type=float,
        default=0.0,
        help='offset in value = gain * raw + offset, in the unit of the value',
    )
    group.add_argument('--unit', default='', help='unit of the value')
    group.add_argument(
        '--begin', metavar='S', type=float, default=0.0, help='since the first sample [s]'
    )
    group.add_argument(
        '--end', metavar='S', type=float, default=math.inf, help='since the first sample [s]'
    )


def add_verdict_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options that select the modes of the verdict."""
    group = parser.add_argument_group('the verdict (default: that of the strongest mode)')
    group.add_argument(
        '--band',
        metavar='LO:HI',
        default='',
        help='exit status by all modes between two frequencies [Hz]',
    )
    group.add_argument(
        '--modes',
        metavar='K',
        type=int,
        help='exit status by the K strongest modes, in the band if one is given',
    )


def asked_of(args: argparse.Namespace) -> tuple[tuple[float, float], int | None]:
    """Return band [Hz] and number of the requested modes; ConfigError with findings."""
    findings, band = [], (0.0, math.inf)
    if args.band:
        try:
            low, high = (float(end) if end else None for end in args.band.split(':'))
            band = (low or 0.0, math.inf if high is None else high)
        except ValueError:
            findings.append(f'--band must be LO:HI in Hz, got {args.band!r}')
        if not 0.0 <= band[0] < band[1]:
            findings.append(f'--band must have 0 <= LO < HI, got {args.band}')
    if args.modes is not None and args.modes < 1:
        findings.append(f'--modes must be at least 1, got {args.modes}')
    ConfigError.raise_any('identify', findings)
    return band, args.modes


def channel_of(args: argparse.Namespace) -> Channel:
    """Return the channel that the options give; ConfigError where they make no sense."""
    findings = [
        f'{name} must be a finite number, got {value}'
        for name, value in (('--gain', args.gain), ('--offset', args.offset))
        if not math.isfinite(value)
    ]
    if args.gain == 0.0:
        findings.append('--gain must not be 0, got 0')
    findings += times_findings(args)
    begin, end = getattr(args, 'begin', 0.0), getattr(args, 'end', math.inf)
    if not begin < end:
        findings.append(f'--begin must be before --end, got {begin} and {end} s')
    ConfigError.raise_any('identify', findings)
    return Channel(
        topic=args.topic,
        field=args.field,
        quantity=args.quantity,
        stamp=args.stamp,
        time=args.time,
        time_unit=args.time_unit,
        rate=args.rate,
        gain=args.gain,
        offset=args.offset,
        unit=args.unit,
        begin=begin,
        end=end,
    )


def add_robot_options(parser: argparse.ArgumentParser, robot: bool = True) -> None:
    """Declare the options that say of which robot, where its joints stood, and whether held."""
    group = parser.add_argument_group('the robot')
    if robot:
        group.add_argument(
            '--robot',
            metavar='URDF',
            default='',
            help='robot for the damping coefficients; default: the one in the bag',
        )
    group.add_argument(
        '--at',
        metavar='JOINT=VALUE',
        action='append',
        default=[],
        help=(
            "position of a joint [rad, m]; default: the bag's /joint_states, else 0; repeatable"
        ),
    )
    group.add_argument(
        '--joints',
        choices=('held', 'free'),
        default='held',
        help='whether the joints were held during the decay; default: held',
    )
    add_gravity(group)


def load_named_robot(path: str, gravity: Sequence[float]) -> Robot:
    """Return the robot of a file; one that is not here is looked for among the installed."""
    return load_robot(given_file(path, 'robot'), gravity=tuple(gravity))


def attached_robot(path: Path, gravity: Sequence[float]) -> Robot | None:
    """Return the robot attached to a bag, None without one."""
    text = '' if is_table(path) else read_description(path)
    if not text:
        return None
    return load_robot(text, gravity=tuple(gravity))


def joint_values(settings: Sequence[str]) -> dict[str, float]:
    """Return JOINT=VALUE settings as a mapping; ConfigError with every finding."""
    findings: list[str] = []
    values = named_values('--at', settings, 'JOINT=VALUE', float, findings)
    require(findings)
    return values
