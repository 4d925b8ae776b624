"""One table per node declares, validates and documents its parameters."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

from denoc_ros.errors import ConfigError
from denoc_ros.settings import Parameter, Value, declared
from denoc_ros.yaml_text import read_yaml_file

T = TypeVar('T')
VALUES = 'ros__parameters'
WILDCARDS = ('*', '**')
FLAGS = ('--params-file', '-p', '--param')


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


class SettingsParameters(Generic[T]):
    """Parameters of a node that are fields of a class of settings.

    Parameters
    ----------
    kind : type
        The class, its fields declared by :func:`denoc_ros.settings.setting`.
    names : mapping of str to str
        Name of the parameter by field, in the table's order.
    bounds : mapping of str to pair of float
        Lowest and highest value by field, where a running node may have less than the class.
    """

    def __init__(
        self,
        kind: type[T],
        names: Mapping[str, str],
        bounds: Mapping[str, tuple[float, float]],
        prefix: str = '',
    ) -> None:
        self._kind, self.names = kind, dict(names)
        known = declared(kind)
        self._rows = {
            field: replace(
                known[field].within(*bounds.get(field, ())),
                name=name,
                text=prefix + known[field].text,
                live=True,
            )
            for field, name in names.items()
        }

    def rows(self, *fields: str) -> Iterator[Parameter]:
        """Yield live rows of the table, by default of all fields."""
        return (self._rows[field] for field in fields or self._rows)

    def __contains__(self, name: object) -> bool:
        return name in self.names.values()

    def read(self, settings: Settings, **others: Any) -> T:
        """Return the class's settings by parameters, and other fields as given."""
        return self._kind(**{f: settings[name] for f, name in self.names.items()}, **others)


class ParameterTable:
    """All parameters of one node."""

    def __init__(self, rows: Iterable[Parameter]) -> None:
        self.rows = tuple(rows)

    def row(self, name: str) -> Parameter | None:
        """Return the row for `name`, None if there is none."""
        exact = [row for row in self.rows if row.name == name]
        return next(iter(exact or [row for row in self.rows if row.matches(name)]), None)

    def accept(self, name: str, value: object) -> Value:
        """Return `value` as its row's type."""
        row = self.row(name)
        if row is None:
            names = [row.name for row in self.rows]
            close = difflib.get_close_matches(name, names, n=1)
            hint = f"; did you mean '{close[0]}'?" if close else ''
            raise ValueError(f"parameter '{name}' must be one this node has{hint}")
        return row.accept(f"parameter '{name}'", value)

    def unknown(self, names: Iterable[str]) -> list[str]:
        """Return those of the names that the node does not have."""
        return [name for name in names if self.row(name) is None]

    def settings(self, given: Mapping[str, object], where: str) -> Settings:
        """Return defaults overlaid with `given`."""
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
        """Return the accepted live changes `given` to `settings`."""
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


def shared_names(arguments: Sequence[str], node: str) -> set[str]:
    """Return the parameters that are given to all nodes alike, and not to this one by its name.

    Parameters
    ----------
    arguments : sequence of str
        A command line, with its `--ros-args`.

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
                (shared if pattern[-1] in WILDCARDS else own).update(names)
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
