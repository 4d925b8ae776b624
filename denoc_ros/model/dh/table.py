"""Read the entries of a YAML table; each violated condition becomes a finding."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from denoc_ros.model.findings import Findings, finite


class Table:
    """Reads the entries of a mapping; each violated condition becomes a finding."""

    def __init__(self, table: Mapping[str, Any], whose: str, findings: Findings) -> None:
        self.table = table
        self.whose = whose
        self.findings = findings

    def fail(self, key: str, rule: str, got: object) -> None:
        """Add a finding."""
        self.findings.add(self.whose, f'{key} must {rule}, got {got!r}')

    def only(self, keys: frozenset[str]) -> None:
        """Find keys that are not known."""
        for key in self.table:
            if key not in keys:
                self.fail('key', f'be one of {", ".join(sorted(keys))}', key)

    def number(
        self,
        key: str,
        unit: str,
        *,
        above: float | None = None,
        least: float | None = None,
        default: float | None = None,
    ) -> float:
        """Return an entry's number, NaN where it is none."""
        if key not in self.table and default is not None:
            return default
        return self.as_number(key, self.table.get(key), unit, above=above, least=least)

    def as_number(
        self,
        key: str,
        value: object,
        unit: str,
        *,
        above: float | None = None,
        least: float | None = None,
    ) -> float:
        """Return a value as a number, NaN where it is none."""
        number = as_finite(value)
        if (
            number is None
            or (above is not None and number <= above)
            or (least is not None and number < least)
        ):
            bound = '' if above is None else f' > {above:g}'
            bound = bound if least is None else f' >= {least:g}'
            self.fail(key, f'be a finite number{bound} {unit}', value)
            return math.nan
        return number

    def list_of(self, key: str, count: int | None, default: object = None) -> list[Any]:
        """Return a list of some length."""
        if key not in self.table and count is not None and default is not None:
            return [default] * count
        value = self.table.get(key)
        if not isinstance(value, list) or not value or (count is not None and len(value) != count):
            self.fail(key, f'be a list of {count or "one or more"} entries', value)
            return [default] * (count or 0)
        return value

    def tables(self, key: str, whose: str) -> list[Table]:
        """Return a list's mappings, named `whose` and their number in findings."""
        found = []
        for index, entry in enumerate(self.list_of(key, None), 1):
            if isinstance(entry, dict):
                found.append(Table(entry, f'{self.whose} {whose} {index}', self.findings))
            else:
                self.fail(f'{whose} {index}', 'be a mapping', entry)
        return found

    def point(self, key: str, least: int) -> tuple[float, ...]:
        """Return the coordinates of a point [m]: `least` of them (the rest is zero) or three."""
        value = self.table.get(key)
        if not isinstance(value, list) or len(value) not in (least, 3):
            rule = '3 numbers' if least == 3 else f'{least} or 3 numbers'
            self.fail(key, f'be {rule} [m]', value)
            return (0.0,) * 3
        given = [self.as_number(key, entry, 'm') for entry in value]
        return (*given, *[0.0] * (3 - len(given)))

    def name(self, key: str) -> str:
        """Return a text that may be left out, then empty."""
        value = self.table.get(key, '')
        if not isinstance(value, str) or (key in self.table and not value.strip()):
            self.fail(key, 'be a text', value)
            return ''
        return value


def as_finite(value: object) -> float | None:
    """Return a number, also one that YAML 1.1 takes for text, such as 1.0e5."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    return finite(str(value))
