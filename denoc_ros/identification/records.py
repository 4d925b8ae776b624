"""One measured signal with its stamps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from denoc_ros.bags.tables import UNITS
from denoc_ros.errors import IdentificationError
from denoc_ros.types import Array

FEWEST_SAMPLES = 8
SLOWEST, FASTEST = 4.0, 2e6  # Hz: no mechanical record is sampled slower or faster


@dataclass(frozen=True, eq=False)
class Record:
    """A signal and its stamps, as they were measured: uneven stamps stay uneven.

    Samples that repeat a stamp are left out (the first stays).

    Parameters
    ----------
    t : array_like, shape (k,)
        Stamps [s], increasing.
    y : array_like, shape (k,)
        Values [unit].
    name, unit : str
        What messages and reports call it.

    Raises
    ------
    IdentificationError
        Shapes differ, a number is not finite, stamps go back, or fewer than 8 samples are left.
    """

    t: Array
    y: Array
    name: str = 'record'
    unit: str = ''

    def __post_init__(self) -> None:
        t, y = _one_dimensional(self.name, 't', self.t), _one_dimensional(self.name, 'y', self.y)
        if t.shape != y.shape:
            raise IdentificationError(
                f'{self.name}: t and y must have the same length, got {t.size} and {y.size}'
            )
        steps = np.diff(t)
        if np.any(steps < 0.0):
            k = int(np.argmax(steps < 0.0))
            raise IdentificationError(
                f'{self.name}: stamps must increase, got {t[k + 1]:.9g} s after {t[k]:.9g} s'
            )
        first = np.append(np.ones(min(t.size, 1), bool), steps > 0.0)
        t, y = t[first], y[first]
        if t.size < FEWEST_SAMPLES:
            raise IdentificationError(
                f'{self.name}: must have at least {FEWEST_SAMPLES} samples with stamps of their '
                f'own, got {t.size}'
            )
        for field, values in (('t', t), ('y', y)):
            values.flags.writeable = False
            object.__setattr__(self, field, values)

    @property
    def duration(self) -> float:
        """Time from the first stamp to the last [s]."""
        return float(self.t[-1] - self.t[0])

    @property
    def step(self) -> float:
        """Typical time between samples [s]: the median."""
        return float(np.median(np.diff(self.t)))

    def part(self, start: float, stop: float) -> Record:
        """Return the samples with start <= t <= stop [s].

        Raises
        ------
        IdentificationError
            Fewer than 8 samples lie there.
        """
        inside = (self.t >= start) & (self.t <= stop)
        return Record(self.t[inside], self.y[inside], self.name, self.unit)


def _one_dimensional(name: str, field: str, values: ArrayLike | Sequence[float]) -> Array:
    array = np.array(values, dtype=float)
    if array.ndim != 1:
        raise IdentificationError(
            f'{name}: {field} must have one dimension, got shape {array.shape}'
        )
    bad = np.count_nonzero(~np.isfinite(array))
    if bad:
        k = int(np.argmax(~np.isfinite(array)))
        raise IdentificationError(
            f'{name}: {field} must be finite, got {bad} values that are not, the first at '
            f'sample {k}'
        )
    return array


def doubtful_rate(record: Record) -> str:
    """Return why a record's sample rate is doubted; '' where it can be one."""
    rate = 1.0 / record.step
    if SLOWEST <= rate <= FASTEST:
        return ''
    likely = [unit for unit, size in UNITS.items() if 10.0 <= rate / size <= 1e5]
    hint = f': times may be in {likely[0]}, --time-unit {likely[0]}' if likely else ''
    return f'sampled at {rate:.3g} Hz, as no mechanical record is{hint}'
