"""Arguments that verbs share: files, gravity, NAME=VALUE, `--set` and `--payload`."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from inspect import signature
from pathlib import Path
from typing import Any, TypeVar

from denoc_ros.cli.session.session_config import find_file, parse_setting
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError
from denoc_ros.settings import KINDS, Kind, Parameter, declared, parameter
from denoc_ros.simulation.recorded.run_files import EARTH

Settings = TypeVar('Settings')


def add_json(parser: Any) -> None:
    """Declare `--json`."""
    add_option(parser, '--json', 'print JSON for machines')


def add_option(parser: Any, option: str, text: str, default: Any = None, **more: Any) -> None:
    """Declare an option, or an argument of a verb.

    Parameters
    ----------
    option : str
        Its name, and behind it the form of its value: `--begin S`, `path BAG`. An option of which
        nothing but its help is said is a switch.
    default : Any
        A number: values are numbers of its type. A list: the option may be given several times.
    """
    name, _, form = option.partition(' ')
    if form:
        more['metavar'] = form
    if isinstance(default, int | float):
        more.setdefault('type', type(default))
    elif isinstance(default, list) and 'nargs' not in more:
        more['action'] = 'append'
    elif default is None and not more and name.startswith('-'):
        more['action'], default = 'store_true', False
    parser.add_argument(name, default=default, help=text, **more)


def add_output(
    parser: Any, form: str, text: str, required: bool = False, default: Path | None = None
) -> None:
    """Declare `-o` and `--output`, a path that the help shows as `form`."""
    parser.add_argument(
        '-o', '--output', metavar=form or None, type=Path, required=required, default=default,
        help=text,
    )  # fmt: skip


def add_gravity(
    parser: Any, default: tuple[float, float, float] | None = EARTH, said: str = '0 0 -9.81'
) -> None:
    """Declare `--gravity`.

    Parameters
    ----------
    default : tuple of float or None
        (3,) base frame [m/s^2].
    """
    add_option(
        parser,
        '--gravity',
        f'gravity in the base frame [m/s^2], default {said}',
        default,
        nargs=3,
        type=float,
        metavar=('X', 'Y', 'Z'),
    )


class _Checked(argparse.Action):
    """Takes a value of a row; one that the row refuses becomes a finding."""

    def __init__(self, *args: Any, row: Parameter, **more: Any) -> None:
        super().__init__(*args, **more)
        self._row = row

    def __call__(
        self, parser: Any, namespace: argparse.Namespace, value: Any, option: str | None = None
    ) -> None:
        """Keep the value, right or wrong."""
        setattr(namespace, self.dest, value)
        try:
            self._row.accept(str(option), value)
        except ValueError as finding:
            namespace.findings.append(str(finding))


def add_row(
    group: Any, option: str, row: Parameter, default: Any = None, dest: str | None = None
) -> None:
    """Declare the option of a row: its text, unit, type, range and choices are the row's.

    Parameters
    ----------
    option : str
        Its name, and behind it the form of its value: `--begin S`.
    """
    name, _, form = option.partition(' ')
    if row.kind is Kind.BOOL:
        add_option(group, name, row.text)
        return
    more: dict[str, Any] = {'choices': row.choices} if row.choices else {}
    if dest:
        more['dest'] = dest
    if form:
        more['metavar'] = form
    types = {kind: plain for plain, kind in KINDS.items()}
    group.add_argument(
        name, action=_Checked, row=row, type=types[row.kind], default=default,
        help=row.help.replace('%', '%%'), **more,
    )  # fmt: skip


def add_number(
    group: Any, option: str, default: Any, text: str, unit: str = '', *bounds: float, **more: Any
) -> None:
    """Declare the option of a number by the arguments of `denoc_ros.settings.parameter`.

    Parameters
    ----------
    default : float, int or type
        A type where there is no default: then None stands for what is not given.
    """
    row = parameter('', default, text, unit, *bounds, **more)
    add_row(group, option, row, row.default)


def default_of(function: Callable[..., Any], name: str) -> Any:
    """Return the default of a function's argument."""
    return signature(function).parameters[name].default


def field_of(option: str) -> str:
    """Return the field that an option is called like, which may be followed by its form."""
    return option.partition(' ')[0].lstrip('-').replace('-', '_')


def option_of(field: str, row: Parameter) -> str:
    """Return the option of a field of settings, and the form of its value: its unit."""
    form = row.unit.upper().replace(' ', '_').replace('^', '')
    return f'--{field.replace("_", "-")} {form}'.rstrip()


def add_settings(group: Any, kind: type, *options: str, unset: bool = False) -> None:
    """Declare options that are called like the declared fields of a class of settings.

    Parameters
    ----------
    unset : bool
        Whether None stands for what is not given.
    """
    rows = declared(kind)
    for option in options:
        row = rows[field_of(option)]
        add_row(group, option, row, None if unset else row.default)


TIMES = ('--time COLUMN', '--time-unit', '--rate HZ')
WINDOW = ('--stamp', *TIMES, '--begin S', '--end S')  # of `RecordedWindow`, for `add_settings`


def window_findings(args: argparse.Namespace) -> list[str]:
    """Findings on begin and end together."""
    if args.begin < args.end:
        return []
    return [f'--begin must be before --end, got {args.begin} and {args.end} s']


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


class _Pair(argparse.Action):
    """Takes NAME=VALUE into a mapping; a text of another form becomes a finding."""

    def __init__(self, *args: Any, read: Callable[[str], Any], form: str, **more: Any) -> None:
        super().__init__(*args, **more)
        self._read, self._form = read, form

    def __call__(
        self, parser: Any, namespace: argparse.Namespace, text: Any, option: str | None = None
    ) -> None:
        """Add the pair to those before it."""
        name, equals, value = text.partition('=')
        try:
            if not (name and equals):
                raise ValueError(text)
            pairs = {**getattr(namespace, self.dest), name: self._read(value)}
        except ValueError:
            namespace.findings.append(f'{option} must be {self._form}, got {text!r}')
        else:
            setattr(namespace, self.dest, pairs)


def add_pairs(
    parser: Any,
    option: str,
    text: str,
    read: Callable[[str], Any] = str,
    dest: str | None = None,
    form: str = '',
) -> None:
    """Declare an option NAME=VALUE that may be given several times: a mapping, empty by default.

    Parameters
    ----------
    read : callable
        Returns a value from its text, ValueError for one that is none.
    """
    name, _, shown = option.partition(' ')
    parser.add_argument(
        name, metavar=shown, action=_Pair, read=read, form=form or shown, default={}, dest=dest,
        help=f'{text}; repeatable',
    )  # fmt: skip


def settings_of(kind: type[Settings], args: argparse.Namespace, **own: Any) -> Settings:
    """Return a class's settings by the arguments that are called like its fields."""
    names = {field.name for field in fields(kind) if hasattr(args, field.name)}  # type: ignore[arg-type]
    return kind(**{name: getattr(args, name) for name in names - own.keys()}, **own)


def require(findings: Sequence[str]) -> None:
    """Raise ConfigError with the findings on the command line, if any."""
    ConfigError.raise_any('command line', findings)


def number_range(text: str) -> tuple[float, float]:
    """Parse LOW:HIGH; ValueError for anything that is no range."""
    low, high = (float(end) for end in text.split(':'))
    if not (math.isfinite(low) and math.isfinite(high) and low <= high):
        raise ValueError(text)
    return low, high


def add_phase(parser: Any) -> None:
    """Declare `--phase`."""
    add_option(parser, '--phase NAME', 'a phase of the run (default: all); repeatable', [])


def add_overrides(parser: argparse.ArgumentParser) -> None:
    """Declare `--set` and `--payload`."""
    text = 'change a number of the model, such as beam.upper_arm.y.ei=9e4; repeatable'
    add_option(parser, '--set PATH=VALUE', text, [])
    add_pairs(
        parser,
        '--payload LINK=MASS[,X,Y,Z]',
        'add a mass [kg] to a link, with its centre in the link frame [m]',
        _mass_and_centre,
        form='LINK=MASS or LINK=MASS,X,Y,Z',
    )


def overrides_of(
    settings: Sequence[str], payloads: Mapping[str, Sequence[float]]
) -> dict[str, Any]:
    """Return overrides by dotted path.

    Parameters
    ----------
    payloads : mapping of str to sequence of float
        Mass [kg], or mass and centre [m], by link.
    """
    findings: list[str] = []
    overrides: dict[str, Any] = {}
    for setting in settings:
        if (parsed := parse_setting(setting, findings)) is not None:
            overrides['.'.join(parsed[0])] = parsed[1]
    require(findings)
    for link, (mass, *centre) in payloads.items():
        overrides[f'payload.{link}.mass'] = mass
        if centre:
            overrides[f'payload.{link}.com'] = centre
    return overrides


def overridden(robot: Robot, args: argparse.Namespace) -> Robot:
    """Return a robot with the changes of `--set` and `--payload`."""
    overrides = overrides_of(args.set, args.payload)
    return robot.with_overrides(overrides) if overrides else robot


def _mass_and_centre(text: str) -> list[float]:
    """Return MASS or MASS,X,Y,Z as numbers; ValueError for another text."""
    values = [float(number) for number in text.split(',')]
    if len(values) not in (1, 4):
        raise ValueError(text)
    return values
