"""Arguments that verbs share: files, gravity, NAME=VALUE."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from denoc_ros.cli.config import find_file
from denoc_ros.errors import ConfigError
from denoc_ros.reports.run_files import EARTH
from denoc_ros.settings import Parameter

Value = TypeVar('Value')


def add_gravity(
    parser: Any, default: tuple[float, float, float] | None = EARTH, said: str = '0 0 -9.81'
) -> None:
    """Declare `--gravity`.

    Parameters
    ----------
    parser : argument parser or group
        What gets it.
    default : tuple of float or None
        (3,) base frame [m/s^2].
    said : str
        The default in words.
    """
    parser.add_argument(
        '--gravity',
        nargs=3,
        type=float,
        default=default,
        metavar=('X', 'Y', 'Z'),
        help=f'gravity in the base frame [m/s^2], default {said}',
    )


def add_setting(group: Any, row: Parameter) -> None:
    """Declare the option of a setting that is a number; None where it is not given."""
    unit = f' [{row.unit}]' if row.unit else ''
    text = f'{row.text}{unit}; default: {row.default:g}'.replace('%', '%%')
    group.add_argument(f'--{row.name.replace("_", "-")}', type=float, metavar='X', help=text)


def add_times(group: Any) -> None:
    """Declare how the times of a table are read."""
    group.add_argument(
        '--time', metavar='COLUMN', default='', help='column with the times of a table'
    )
    group.add_argument(
        '--time-unit',
        choices=('s', 'ms', 'us', 'ns'),
        default='',
        help=(
            "unit of a table's times; default: from the column's name (time_ms, t [us]), else s"
        ),
    )
    group.add_argument(
        '--rate',
        metavar='HZ',
        type=float,
        default=0.0,
        help='sample rate of a table without times',
    )


def times_findings(args: Any) -> list[str]:
    """Findings on the options that read the times of a table."""
    if math.isfinite(args.rate) and args.rate >= 0.0:
        return []
    return [f'--rate must be > 0 Hz, got {args.rate}']


def add_stamp(parser: Any) -> None:
    """Declare `--stamp` for a parser or a group."""
    parser.add_argument(
        '--stamp',
        choices=('header', 'log'),
        default='header',
        help='times of a bag: header stamps (default) or times of recording',
    )


def unused(path: Path) -> Path:
    """Return a path at which nothing is yet: itself, or with _2, _3, … before its suffix."""
    end = path.suffix if path.suffix in ('.html', '.mcap') else ''
    start, number, free = path.name[: len(path.name) - len(end)], 2, path
    while free.exists():
        free = path.with_name(f'{start}_{number}{end}')
        number += 1
    return free


def given_file(path: str, whose: str) -> Path:
    """Return a file that is here or where the package is installed; ConfigError without one."""
    found = find_file(Path(path), Path())
    if found is None:
        raise ConfigError(path, [f'the {whose} must be a file, got none of this name'])
    return found


def named_values(
    option: str,
    texts: Sequence[str],
    form: str,
    read: Callable[[str], Value],
    findings: list[str],
) -> dict[str, Value]:
    """Return NAME=VALUE texts as a mapping.

    Parameters
    ----------
    option : str
        Whose they are.
    texts : sequence of str
        As given on the command line.
    form : str
        What each must be, such as `JOINT=VALUE`.
    read : callable
        Returns a value from its text, ValueError for what is none.
    findings : list of str
        What each that is not of the form is added to.
    """
    values = {}
    for text in texts:
        name, equals, value = text.partition('=')
        try:
            if not (name and equals):
                raise ValueError(text)
            values[name] = read(value)
        except ValueError:
            findings.append(f'{option} must be {form}, got {text!r}')
    return values


def require(findings: Sequence[str]) -> None:
    """Raise ConfigError with the findings on the command line, if any."""
    ConfigError.raise_any('command line', findings)


def number_range(text: str) -> tuple[float, float]:
    """Parse LOW:HIGH; ValueError for anything that is no range."""
    low, high = (float(end) for end in text.split(':'))
    if not (math.isfinite(low) and math.isfinite(high) and low <= high):
        raise ValueError(text)
    return low, high
