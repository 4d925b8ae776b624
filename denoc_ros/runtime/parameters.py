"""One table per node declares, validates and documents its parameters."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

from denoc_ros.errors import ConfigError
from denoc_ros.yaml_text import read_yaml_file

Value = bool | int | float | str | list[str] | list[float]


class Kind(Enum):
    """Type of a parameter's value, by its ROS name."""

    BOOL = 'bool'
    INTEGER = 'integer'
    DOUBLE = 'double'
    STRING = 'string'
    STRINGS = 'string array'
    DOUBLES = 'double array'
    DOUBLE_OR_DOUBLES = 'double or double array'


TEXTS = (Kind.STRING, Kind.STRINGS)
ARRAYS = (Kind.STRINGS, Kind.DOUBLES, Kind.DOUBLE_OR_DOUBLES)
EXPONENTIAL = re.compile(r'[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+|[-+]?inf')


@dataclass(frozen=True)
class Parameter:
    """One row of the table; a name that ends in `.*` is a family of names."""

    name: str
    kind: Kind
    default: Value | None  # None: a family has none
    text: str
    unit: str = ''
    minimum: float = -math.inf
    maximum: float = math.inf
    positive: bool = False  # > 0, not only >= minimum
    choices: tuple[str, ...] = ()
    live: bool = False

    @property
    def is_family(self) -> bool:
        """Whether the row stands for a family of names."""
        return self.name.endswith('.*')

    def matches(self, name: str) -> bool:
        """Say whether the row is the one for `name`."""
        if self.is_family:
            return name.startswith(self.name[:-1]) and len(name) >= len(self.name)
        return name == self.name

    @property
    def range(self) -> str:
        """Admissible values in words; empty if anything goes."""
        if self.choices:
            return ' \\| '.join(f'`{choice}`' for choice in self.choices)
        if self.positive:
            return '> 0' + (f', <= {self.maximum:g}' if self.maximum < math.inf else '')
        bounds = [
            f'>= {self.minimum:g}' if self.minimum > -math.inf else '',
            f'<= {self.maximum:g}' if self.maximum < math.inf else '',
        ]
        return ', '.join(bound for bound in bounds if bound)

    def finding(self, name: str, value: object, requirement: str) -> str:
        """Return the sentence that refuses `value`."""
        unit = f' {self.unit}' if self.unit else ''
        return f"parameter '{name}' must be {requirement}{unit}, got {value!r}"

    def accept(self, name: str, value: object) -> Value:
        """Return `value` as the row's type.

        An integer is taken where a double is meant (`-p x:=5`), one number where an array is, and
        a text that YAML 1.1 does not take for the number it is (`9e4` of `ros2 param set`).
        Nothing is an empty array: so rclpy hands on the `[]` of a parameter file.

        Raises
        ------
        ValueError
            With the sentence that says what must hold.
        """
        kind = self.kind
        if value is None and kind in ARRAYS:
            return []
        if kind not in TEXTS:
            value = _numeric(value)
        if kind is Kind.BOOL and isinstance(value, bool):
            return value
        if kind is Kind.STRING and isinstance(value, str):
            return self._accept_text(name, value)
        if kind is Kind.INTEGER and isinstance(value, int) and not isinstance(value, bool):
            return int(self._accept_number(name, value))
        if kind in (Kind.DOUBLE, Kind.DOUBLE_OR_DOUBLES) and _is_number(value):
            return self._accept_number(name, cast(float, value))
        if kind is Kind.DOUBLES and _is_number(value):
            return [self._accept_number(name, cast(float, value))]
        if kind in (Kind.DOUBLES, Kind.DOUBLE_OR_DOUBLES) and _is_sequence(value):
            return [self._accept_number(name, each) for each in cast(Iterable[float], value)]
        if kind is Kind.STRINGS and _is_sequence(value):
            items = list(cast(Iterable[object], value))
            if all(isinstance(item, str) for item in items):
                return cast(list[str], items)
        raise ValueError(self.finding(name, value, f'{_article(kind)} {kind.value}'))

    def _accept_text(self, name: str, value: str) -> str:
        if self.choices and value not in self.choices:
            raise ValueError(self.finding(name, value, 'one of ' + ', '.join(self.choices)))
        return value

    def _accept_number(self, name: str, value: object) -> float:
        if not _is_number(value):
            raise ValueError(self.finding(name, value, f'{_article(self.kind)} {self.kind.value}'))
        number = float(cast(float, value))
        if math.isnan(number):
            raise ValueError(self.finding(name, value, 'a number'))
        if (self.positive and not number > 0.0) or not self.minimum <= number <= self.maximum:
            raise ValueError(self.finding(name, value, self.range))
        return number


def _article(kind: Kind) -> str:
    return 'an' if kind is Kind.INTEGER else 'a'


def _numeric(value: object) -> object:
    """Return texts that are numbers as these."""
    if isinstance(value, str):
        return float(value) if EXPONENTIAL.fullmatch(value) else value
    if _is_sequence(value):
        return [_numeric(each) for each in cast(Iterable[object], value)]
    return value


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_sequence(value: object) -> bool:
    return isinstance(value, Iterable) and not isinstance(value, str | bytes | Mapping)


class Settings:
    """The accepted values of a node's parameters, each read as the type its row declares."""

    def __init__(self, values: Mapping[str, Value]) -> None:
        self._values = dict(values)

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __getitem__(self, name: str) -> Value:
        return self._values[name]

    def replace(self, changes: Mapping[str, Value]) -> Settings:
        """Return settings with some values changed; those come last."""
        kept = {name: value for name, value in self._values.items() if name not in changes}
        return Settings({**kept, **changes})

    def without(self, *prefixes: str) -> Settings:
        """Return settings without the names that start with one of `prefixes` and a dot."""
        dropped = self.family(*prefixes)
        return Settings({k: v for k, v in self._values.items() if k not in dropped})

    def flag(self, name: str) -> bool:
        """Return a bool."""
        return bool(self._values[name])

    def integer(self, name: str) -> int:
        """Return an integer."""
        return int(cast(int, self._values[name]))

    def number(self, name: str) -> float:
        """Return a double."""
        return float(cast(float, self._values[name]))

    def text(self, name: str) -> str:
        """Return a string."""
        return str(self._values[name])

    def texts(self, name: str) -> list[str]:
        """Return a string array."""
        return list(cast(list[str], self._values[name]))

    def numbers(self, name: str) -> list[float]:
        """Return a double array."""
        return list(cast(list[float], self._values[name]))

    def family(self, *prefixes: str) -> dict[str, float | list[float]]:
        """Return the values whose names start with one of `prefixes` and a dot."""
        starts = tuple(f'{prefix}.' for prefix in prefixes)
        return {
            name: cast('float | list[float]', value)
            for name, value in self._values.items()
            if name.startswith(starts)
        }


class ParameterTable:
    """All parameters of one node."""

    def __init__(self, rows: Iterable[Parameter]) -> None:
        self.rows = tuple(rows)

    def row(self, name: str) -> Parameter | None:
        """Return the row for `name`, None if there is none."""
        exact = [row for row in self.rows if row.name == name]
        return next(iter(exact or [row for row in self.rows if row.matches(name)]), None)

    def accept(self, name: str, value: object) -> Value:
        """Return `value` as its row's type.

        Raises
        ------
        ValueError
            With the sentence that says what must hold.
        """
        row = self.row(name)
        if row is None:
            names = [row.name for row in self.rows]
            close = difflib.get_close_matches(name, names, n=1)
            hint = f"; did you mean '{close[0]}'?" if close else ''
            raise ValueError(f"parameter '{name}' must be one this node has{hint}")
        return row.accept(name, value)

    def unknown(self, names: Iterable[str]) -> list[str]:
        """Return those of the names that the node does not have."""
        return [name for name in names if self.row(name) is None]

    def settings(self, given: Mapping[str, object], where: str) -> Settings:
        """Return defaults overlaid with `given`.

        Raises
        ------
        ConfigError
            With every finding.
        """
        values = {row.name: row.default for row in self.rows if row.default is not None}
        findings = []
        for name, value in given.items():
            try:
                values[name] = self.accept(name, value)
            except ValueError as finding:
                findings.append(str(finding))
        ConfigError.raise_any(where, findings)
        return Settings(values)

    def changes(self, settings: Settings, given: Mapping[str, object]) -> dict[str, Value]:
        """Return the accepted live changes `given` to `settings`.

        Raises
        ------
        ValueError
            With the sentence that says what must hold.
        """
        accepted: dict[str, Value] = {}
        for name, value in given.items():
            new = self.accept(name, value)
            row = self.row(name)
            known = name in list(settings)
            if row is not None and not row.live and not (known and settings[name] == new):
                raise ValueError(
                    f"parameter '{name}' must be set before the node starts (read-only), "
                    f'got {value!r}'
                )
            accepted[name] = new
        return accepted

    def markdown(self) -> str:
        """Return the table as Markdown, as docs/nodes.md shows it."""
        lines = [
            '| parameter | type | default | range | unit | live | what |',
            '|---|---|---|---|---|---|---|',
        ]
        for row in self.rows:
            default = '' if row.default is None else f'`{_shown(row.default)}`'
            live = 'live' if row.live else 'read-only'
            lines.append(
                f'| `{row.name}` | {row.kind.value} | {default} | {row.range} | {row.unit} '
                f'| {live} | {row.text} |'
            )
        return '\n'.join(lines) + '\n'


def _shown(value: Value) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f'{value:g}' if isinstance(value, float) else str(value) or "''"


VALUES = 'ros__parameters'
WILD = ('*', '**')
FLAGS = ('--params-file', '-p', '--param')


def shared_names(arguments: Sequence[str], node: str) -> set[str]:
    """Return the parameters that are given to all nodes alike, and not to this one by its name.

    Parameters
    ----------
    arguments : sequence of str
        A command line, with its `--ros-args`.
    node : str
        Fully qualified name of the node.

    Returns
    -------
    set of str
        Dotted names that stand in sections such as `/**` only.
    """
    shared: set[str] = set()
    own: set[str] = set()
    for flag, value in _ros_arguments(arguments):
        if flag != '--params-file':
            own.add(value.partition(':=')[0].rpartition(':')[2])
            continue
        for pattern, names in _sections(value):
            if _matches(pattern, node):
                (shared if pattern[-1] in WILD else own).update(names)
    return shared - own


def _ros_arguments(arguments: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield the arguments that concern parameters: flag and value."""
    inside = False
    for word, after in pairwise([*arguments, '']):
        inside = word == '--ros-args' or (inside and word != '--')
        if inside and word in FLAGS:
            yield word, after


def _sections(file: str) -> Iterator[tuple[list[str], list[str]]]:
    """Yield each section of a file, its name by parts, with the parameters it has.

    A file that cannot be read has none: rclpy has said what is wrong with it.
    """
    with suppress(ConfigError):
        yield from _below([], read_yaml_file(Path(file)))


def _below(path: list[str], found: Any) -> Iterator[tuple[list[str], list[str]]]:
    if not isinstance(found, Mapping):
        return
    for key, value in found.items():
        if key == VALUES:
            yield path, list(_names(value))
        else:
            yield from _below([*path, *str(key).strip('/').split('/')], value)


def _names(values: Any, prefix: str = '') -> Iterator[str]:
    if not isinstance(values, Mapping):
        return
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _names(value, f'{prefix}{key}.')
        else:
            yield f'{prefix}{key}'


def _matches(pattern: Sequence[str], node: str) -> bool:
    """Say whether a section is for a node, as rcl does."""
    words = {'**': r'(/\w+)*', '*': r'/\w+'}
    return bool(re.fullmatch(''.join(words.get(w, '/' + re.escape(w)) for w in pattern), node))
