"""Settings and parameters, each declared once: type, default, unit, range and text.

A class of settings declares its fields by :func:`setting`; its check, a node's rows and the
options of a command follow from them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from enum import Enum
from numbers import Real
from typing import Any, TypeVar, cast

from denoc_ros.errors import StateError

Value = bool | int | float | str | list[str] | list[float]
Settings = TypeVar('Settings')


class Kind(Enum):
    """Type of a parameter's value, by its ROS name."""

    BOOL = 'bool'
    INTEGER = 'integer'
    DOUBLE = 'double'
    STRING = 'string'
    STRINGS = 'string array'
    DOUBLES = 'double array'
    DOUBLE_OR_DOUBLES = 'double or double array'

    @property
    def noun(self) -> str:
        """The name with its article."""
        return f'{"an" if self is Kind.INTEGER else "a"} {self.value}'


KINDS = {bool: Kind.BOOL, int: Kind.INTEGER, float: Kind.DOUBLE, str: Kind.STRING}
ROW = 'row'  # of a field's metadata
TEXTS = (Kind.STRING, Kind.STRINGS)
ARRAYS = (Kind.STRINGS, Kind.DOUBLES, Kind.DOUBLE_OR_DOUBLES)
EXPONENTIAL = re.compile(r'[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+|[-+]?inf')


@dataclass(frozen=True)
class Parameter:
    """Type, range and text of a parameter; a name that ends in `.*` is a family of names."""

    name: str
    kind: Kind
    default: Value | None  # None: a family has none
    text: str
    unit: str = ''
    minimum: float = -math.inf
    maximum: float = math.inf
    positive: bool = False  # > 0, not only >= minimum
    below: float = math.inf  # < this, not only <= maximum
    choices: tuple[str, ...] = ()
    live: bool = False
    finite: bool = False

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
        if self.below < math.inf:
            return f'>= {self.minimum:g} and < {self.below:g}'
        bounds = [
            f'>= {self.minimum:g}' if self.minimum > -math.inf else '',
            f'<= {self.maximum:g}' if self.maximum < math.inf else '',
        ]
        return ', '.join(bound for bound in bounds if bound)

    @property
    def help(self) -> str:
        """Text, unit and default on a command line; a default that is no value is not shown."""
        head, mark, rest = self.text.partition(';')
        told = f'{head} [{self.unit}]{mark}{rest}' if self.unit else self.text
        try:
            value = self.accept('', self.default)
        except ValueError:
            return told
        if _is_number(value):
            return f'{told}; default: {value:g}' if math.isfinite(cast(float, value)) else told
        return f'{told}; default: {value}' if value and self.kind is Kind.STRING else told

    def within(self, lowest: float | None = None, highest: float | None = None) -> Parameter:
        """Return the row with narrower bounds."""
        if lowest is None or highest is None:
            return self
        positive = self.positive and lowest <= 0.0
        return replace(self, minimum=lowest, maximum=highest, positive=positive, below=math.inf)

    def finding(self, subject: str, value: object, requirement: str) -> str:
        """Return the sentence that refuses `value`."""
        unit = f' {self.unit}' if self.unit else ''
        return f'{subject} must be {requirement}{unit}, got {value!r}'

    def accept(self, subject: str, value: object) -> Value:
        """Return `value` as the row's type; `subject` is whose value it is.

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
            return self._accept_text(subject, value)
        if kind is Kind.INTEGER and isinstance(value, int) and not isinstance(value, bool):
            return int(self._accept_number(subject, value))
        if kind in (Kind.DOUBLE, Kind.DOUBLE_OR_DOUBLES) and _is_number(value):
            return self._accept_number(subject, cast(float, value))
        if kind is Kind.DOUBLES and _is_number(value):
            return [self._accept_number(subject, cast(float, value))]
        if kind in (Kind.DOUBLES, Kind.DOUBLE_OR_DOUBLES) and _is_sequence(value):
            return [self._accept_number(subject, each) for each in cast(Iterable[float], value)]
        if kind is Kind.STRINGS and _is_sequence(value):
            items = list(cast(Iterable[object], value))
            if all(isinstance(item, str) for item in items):
                return cast(list[str], items)
        raise ValueError(self.finding(subject, value, kind.noun))

    def _accept_text(self, subject: str, value: str) -> str:
        if self.choices and value not in self.choices:
            raise ValueError(self.finding(subject, value, 'one of ' + ', '.join(self.choices)))
        return value

    def _accept_number(self, subject: str, value: object) -> float:
        if not _is_number(value):
            raise ValueError(self.finding(subject, value, self.kind.noun))
        number = float(cast(float, value))
        if math.isnan(number) or (self.finite and math.isinf(number)):
            raise ValueError(self.finding(subject, value, f'a number {self.range}'.rstrip()))
        inside = self.minimum <= number <= self.maximum and not number >= self.below < math.inf
        if not inside or (self.positive and not number > 0.0):
            raise ValueError(self.finding(subject, value, self.range))
        return number


def _numeric(value: object) -> object:
    """Return texts that are numbers as these."""
    if isinstance(value, str):
        return float(value) if EXPONENTIAL.fullmatch(value) else value
    if _is_sequence(value):
        return [_numeric(each) for each in cast(Iterable[object], value)]
    return value


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _is_sequence(value: object) -> bool:
    return isinstance(value, Iterable) and not isinstance(value, str | bytes | Mapping)


def parameter(
    name: str,
    default: Any,
    text: str,
    unit: str = '',
    minimum: float = -math.inf,
    maximum: float = math.inf,
    **more: Any,
) -> Parameter:
    """Return a row; the kind of a single value is that of its default.

    Parameters
    ----------
    name, text, unit, minimum, maximum, **more
        Of :class:`Parameter`.
    default : value, type or Kind
        A type where there is no default; a kind of array where it is empty.
    """
    if isinstance(default, Kind):
        return Parameter(name, default, [], text, unit, minimum, maximum, **more)
    is_needed = isinstance(default, type)
    kind = more.pop('kind', None) or KINDS[default if is_needed else type(default)]
    known = None if is_needed else default
    return Parameter(name, kind, known, text, unit, minimum, maximum, **more)


def setting(default: Any, *given: Any, **more: Any) -> Any:
    """Declare a field of a class of settings, by the arguments of :func:`parameter` or a row."""
    row = default if isinstance(default, Parameter) else parameter('', default, *given, **more)
    return field(default=MISSING if row.default is None else row.default, metadata={ROW: row})


def positive(default: Any, *given: Any, **more: Any) -> Any:
    """Declare a field whose value must be > 0 and finite."""
    return setting(default, *given, positive=True, finite=True, **more)


def optional(kind: type, *given: Any, **more: Any) -> Any:
    """Declare a field that is None where it is not given."""
    return field(default=None, metadata={ROW: parameter('', kind, *given, **more)})


def declared(kind: type) -> dict[str, Parameter]:
    """Return the declared settings of a class by field."""
    return {each.name: each.metadata[ROW] for each in fields(kind) if ROW in each.metadata}


def documented(kind: type[Settings]) -> type[Settings]:
    """Write the declared settings of a class into its docstring, as its attributes."""
    types = {kind: type.__name__ for type, kind in KINDS.items()}
    lines = []
    for name, row in declared(kind).items():
        unit = f' [{row.unit}]' if row.unit else ''
        told = ', '.join(filter(None, (row.text + unit, row.range)))
        lines.append(f'    {name} : {types[row.kind]}\n        {told}\n')
    text, heading = kind.__doc__ or '', '    Attributes\n    ----------\n'
    if heading not in text:
        text = text.replace('    Raises\n', f'{heading}\n    Raises\n', 1)
    kind.__doc__ = text.replace(heading, heading + ''.join(lines), 1)
    return kind


def declared_findings(settings: Any, whose: str = '') -> list[str]:
    """Return the findings on settings out of their range; their names stand behind `whose`."""
    findings = []
    may_be_none = {each.name for each in fields(settings) if each.default is None}
    for name, row in declared(type(settings)).items():
        value = getattr(settings, name)
        if value is None and name in may_be_none:
            continue
        try:
            row.accept(f'{whose}{name}', value)
        except ValueError as finding:
            findings.append(str(finding))
    return findings


def require_declared(settings: Any, where: str) -> None:
    """Raise StateError with the first of the settings that is out of its range."""
    for finding in declared_findings(settings, f'{where}: '):
        raise StateError(finding)
