"""Gather all findings of a file, element by element, instead of stopping at the first."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from denoc_ros.model.reading.poses import pose_of, rotation_rpy
from denoc_ros.types import Array

Element = Any  # lxml's element

# Beyond these a number is an error, and products of a few would not be finite.
LARGEST = 1e40
SMALLEST = 1e-30  # of numbers that must be > 0


class Findings:
    """Findings of one file, in the order they were made."""

    def __init__(self) -> None:
        self.items: list[str] = []

    def add(self, whose: str, what: str) -> None:
        """Note a fault of an element."""
        self.items.append(f'{whose}: {what}')


class Reader:
    """Reads the attributes of one XML element; each violated condition becomes a finding.

    A value that cannot be read comes back as nan (or empty), so that reading goes on.

    Parameters
    ----------
    label : str
        Stands behind the name of an attribute, such as ` (direction y)`.
    """

    def __init__(self, element: Element, whose: str, findings: Findings, label: str = '') -> None:
        self.element = element
        self.whose = whose
        self.findings = findings
        self.label = label

    def fail(self, attribute: str, rule: str, got: object) -> None:
        """Note that an attribute must be something else."""
        if isinstance(got, float):
            shown = f'{got:g}'
        else:
            shown = 'nothing' if got is None else repr(got)
        self.findings.add(self.whose, f'{attribute}{self.label} must {rule}, got {shown}')

    def only(self, attributes: Collection[str], children: Collection[str] = ()) -> None:
        """Note every attribute and child element that is not known."""
        for name in self.element.attrib:
            if name not in attributes:
                known = f'be one of {", ".join(attributes)}' if attributes else 'not occur here'
                self.fail(f'attribute of <{self.element.tag}>', known, name)
        for child in self.element.iterchildren('*'):
            if child.tag not in children:
                known = f'be one of {", ".join(children)}' if children else 'not occur here'
                self.fail(f'element in <{self.element.tag}>', known, str(child.tag))

    def text(self, attribute: str, default: str | None = None) -> str:
        """Return a text, which must not be empty; `default` when it may be left out."""
        value = self.element.get(attribute)
        if value is None and default is not None:
            return default
        if value is None or not value.strip():
            self.fail(attribute, 'be given', None)
            return ''
        return str(value)

    def unique_name(self, names: set[str]) -> None:
        """Note a name that is missing or among those before it; add it to them."""
        self.text('name')
        name = self.element.get('name', '')
        if name in names:
            self.findings.add(self.whose, 'name must be unique, got it twice')
        names.add(name)

    def choice(self, attribute: str, choices: Sequence[str], default: str | None = None) -> str:
        """Return a text out of some; an empty one when it is none of them."""
        value = self.element.get(attribute, default)
        if value not in choices:
            self.fail(attribute, f'be one of {", ".join(choices)}', value)
            return ''
        return str(value)

    def number(
        self,
        attribute: str,
        unit: str = '',
        *,
        above: float | None = None,
        least: float | None = None,
        default: float | None = None,
    ) -> float:
        """Return a finite number above a bound, or at least one; nan when it is not."""
        value = self.element.get(attribute)
        if value is None and default is not None:
            return default
        rule = _rule(unit, above, least)
        if value is None:
            self.fail(attribute, rule, None)
            return math.nan
        number = finite(value)
        if number is None or not _within(number, above, least):
            self.fail(attribute, rule, value if number is None else number)
            return math.nan
        return number

    def numbers(self, attribute: str, unit: str, *, least: float | None = None) -> Array:
        """Return one or more finite numbers, (k,); empty when they are not."""
        value = self.element.get(attribute, '')
        found = [finite(part) for part in value.split()]
        good = [number for number in found if number is not None and _within(number, None, least)]
        if not found or len(good) != len(found):
            self.fail(attribute, f'{_rule(unit, None, least)} (one for all, or one each)', value)
            return np.zeros(0)
        return np.array(good)

    def vector(
        self, attribute: str, default: str | None = None, unit: str = 'm', size: int = 3
    ) -> Array:
        """Return three finite numbers, or `size` of them; nan when they are not."""
        value = self.element.get(attribute, default)
        found = [] if value is None else [finite(part) for part in value.split()]
        if len(found) != size or any(number is None for number in found):
            count = 'three' if size == 3 else size
            self.fail(attribute, f'be {count} finite numbers [{unit}]', value)
            return np.full(size, np.nan)
        return np.array(found, dtype=np.float64)

    def axis(self, attribute: str = 'xyz', default: str | None = None) -> Array:
        """Return a unit vector, (3,), from three numbers that are not all zero."""
        vector = self.vector(attribute, default, '-')
        size = float(np.linalg.norm(vector))
        if size == 0.0:
            self.fail(attribute, 'not be zero', self.element.get(attribute, default))
            return np.full(3, np.nan)
        return np.asarray(vector / size)

    def count(self, attribute: str, most: int, least: int = 0) -> int:
        """Return a whole number from `least` to `most`; `least` when it is not."""
        value = self.element.get(attribute)
        text = '' if value is None else value.strip()
        whole = text.isascii() and text.isdigit() and len(text) <= 9
        if not whole or not least <= int(text) <= most:
            self.fail(attribute, f'be a whole number from {least} to {most}', value)
            return least
        return int(text)

    def pose(self) -> Array:
        """Return the (4, 4) transform of the attributes xyz [m] and rpy [rad]."""
        turn = rotation_rpy(self.vector('rpy', '0 0 0', 'rad'))
        return pose_of(self.vector('xyz', '0 0 0'), turn)


def finite(text: str) -> float | None:
    """Return the number a text says, None if it says none or one beyond `LARGEST`."""
    try:
        number = float(text)
    except ValueError:
        return None
    return number if abs(number) <= LARGEST and '_' not in text else None


def as_text(value: Any) -> str | None:
    """Return a value as an attribute's text, None if it is neither number, text nor numbers."""
    if isinstance(value, str):
        return value
    if isinstance(value, bool) or value is None:
        return None
    if isinstance(value, int | float | np.integer | np.floating):
        return str(value)
    if isinstance(value, Sequence | np.ndarray):
        parts = [as_text(part) for part in np.ravel(np.asarray(value, dtype=object))]
        return None if None in parts else ' '.join(str(part) for part in parts)
    return None


def unknown_path(path: str, known: Sequence[str], findings: Findings) -> None:
    """Note a dotted path that the robot does not have, with those that it has."""
    exist = ', '.join(known) if known else 'none of this kind'
    findings.add(f'path {path!r}', f'must be one that the robot has ({exist}), got another')


def _rule(unit: str, above: float | None, least: float | None) -> str:
    bound = f'> {above:g}' if above is not None else f'>= {least:g}' if least is not None else ''
    return ' '.join(part for part in ('be', bound or 'a finite number', unit) if part)


def _within(number: float, above: float | None, least: float | None) -> bool:
    if above is not None and number < above + SMALLEST:
        return False
    return least is None or number >= least
