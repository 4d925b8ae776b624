"""Arguments that verbs share: files, gravity, NAME=VALUE, `--set` and `--payload`."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from denoc_ros.cli.config import find_file, parse_setting
from denoc_ros.errors import ConfigError
from denoc_ros.reports.run_files import EARTH
from denoc_ros.settings import Parameter

Value = TypeVar('Value')


def add_json(parser: Any) -> None:
    """Declare `--json`."""
    parser.add_argument('--json', action='store_true', help='print JSON for machines')


def add_repeated(parser: Any, *options: tuple[str, str]) -> None:
    """Declare options that may be given several times: a list of texts, empty by default.

    Parameters
    ----------
    parser : argument parser or group
        What gets them.
    options : (str, str)
        Option with the form of its value, `--rename OLD=NEW`, and its help.
    """
    for option, text in options:
        name, _, form = option.partition(' ')
        parser.add_argument(name, metavar=form or None, action='append', default=[], help=text)


def add_numbers(parser: Any, *options: tuple[str, float | None, str]) -> None:
    """Declare options whose value is a number.

    Parameters
    ----------
    parser : argument parser or group
        What gets them.
    options : (str, float or int or None, str)
        Option with the unit of its value, `--begin S`, its default, and its help. The number is
        an integer where the default is one.
    """
    for option, default, text in options:
        name, _, unit = option.partition(' ')
        kind = int if isinstance(default, int) else float
        parser.add_argument(name, metavar=unit or None, type=kind, default=default, help=text)


def add_output(parser: Any, form: str, text: str, required: bool = False) -> None:
    """Declare `-o` and `--output`, a path that the help shows as `form`."""
    parser.add_argument(
        '-o', '--output', metavar=form or None, type=Path, required=required, help=text
    )


def add_window(group: Any, of: str) -> None:
    """Declare `--begin` and `--end`, counted from the first of something."""
    since = f'since the first {of} [s]'
    add_numbers(group, ('--begin S', 0.0, since), ('--end S', math.inf, since))


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
    add_numbers(group, ('--rate HZ', 0.0, 'sample rate of a table without times'))


def times_findings(rate: float) -> list[str]:
    """Findings on `--rate`, the sample rate of a table [Hz]."""
    return [] if math.isfinite(rate) and rate >= 0.0 else [f'--rate must be > 0 Hz, got {rate}']


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


def add_overrides(parser: argparse.ArgumentParser) -> None:
    """Declare `--set` and `--payload`."""
    add_repeated(
        parser,
        (
            '--set PATH=VALUE',
            'change a number of the model, such as beam.upper_arm.y.ei=9e4; repeatable',
        ),
        (
            '--payload LINK=MASS[,X,Y,Z]',
            'add a mass [kg] to a link, with its centre in the link frame [m]; repeatable',
        ),
    )


def overrides_of(settings: Sequence[str], payloads: Sequence[str]) -> dict[str, Any]:
    """Return overrides by dotted path.

    Parameters
    ----------
    settings : sequence of str
        `path=value` each.
    payloads : sequence of str
        `link=mass` or `link=mass,x,y,z` each.

    Raises
    ------
    ConfigError
        With every text that is neither.
    """
    findings: list[str] = []
    overrides: dict[str, Any] = {}
    for setting in settings:
        if (parsed := parse_setting(setting, findings)) is not None:
            overrides['.'.join(parsed[0])] = parsed[1]
    form = 'LINK=MASS or LINK=MASS,X,Y,Z'
    hung = named_values('--payload', payloads, form, _mass_and_centre, findings)
    require(findings)
    for link, (mass, *centre) in hung.items():
        overrides[f'payload.{link}.mass'] = mass
        if centre:
            overrides[f'payload.{link}.com'] = centre
    return overrides


def _mass_and_centre(text: str) -> list[float]:
    """Return MASS or MASS,X,Y,Z as numbers; ValueError for another text."""
    values = [float(number) for number in text.split(',')]
    if len(values) not in (1, 4):
        raise ValueError(text)
    return values
