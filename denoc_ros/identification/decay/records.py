"""Records of a signal, and their quality: rate, gaps, jitter, clipping, noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from denoc_ros.errors import IdentificationError
from denoc_ros.identification.tables.time_columns import UNITS
from denoc_ros.types import Array

FEWEST_SAMPLES = 8
SLOWEST, FASTEST = 4.0, 2e6  # Hz: no mechanical record is sampled slower or faster

Mask = NDArray[np.bool_]

GAP = 1.5  # typical steps
LONGEST_CLIPPED_RUN = 0.1  # of the record: longer at one value is rest
FEWEST_CLIPPED = 3
PILED_UP = 2.6  # times as many as one level further in; a sine's crest has up to 2.4 times
GAUSSIAN_MAD = 1.4826
THIRD_DIFFERENCE = np.sqrt(20.0)  # norm of 1, -3, 3, -1
FEWEST_REPEATS = 4  # samples per value from which on the values are levels


@dataclass(frozen=True, eq=False)
class Record:
    """A signal and its stamps, as they were measured: uneven stamps stay uneven.

    Samples that repeat a stamp are left out (the first stays).

    Raises
    ------
    IdentificationError
        Shapes differ, a number is not finite, stamps go back, or fewer than 8 samples are left.
    """

    t: Array  # (k,) stamps [s], increasing
    y: Array  # (k,) values [unit]
    # what messages and reports call it
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


@dataclass(frozen=True, eq=False)
class Quality:
    """Quality of a record."""

    samples: int
    # [s], [Hz]: of an unbroken record
    duration: float
    rate: float
    # steps longer than 1.5 typical ones, and the longest step [s]
    gaps: int
    longest_gap: float
    lost: float  # part of the samples that an unbroken record would have and this one has not
    jitter: float  # standard deviation of the steps that are no gaps, in typical steps
    clipped: Mask  # (k,) samples at a limit of the sensor's range
    resolution: float  # distance between the levels of the values [unit]; 0 where there are none
    noise: float  # standard deviation of what changes from sample to sample [unit]
    snr_db: float  # half the range of the values against the noise [dB]


def assess(record: Record) -> Quality:
    """Return the quality of a record."""
    steps = np.diff(record.t)
    typical = record.step
    regular = steps[steps <= GAP * typical]
    count = float(np.sum(np.maximum(np.round(steps / typical), 1.0)))
    resolution = level_distance(record.y)
    noise = max(sample_noise(record.y), resolution / np.sqrt(12.0))
    half_range = 0.5 * float(np.ptp(record.y))
    snr = 20.0 * np.log10(half_range / noise) if noise > 0.0 and half_range > 0.0 else np.inf
    return Quality(
        samples=record.t.size,
        duration=record.duration,
        rate=count / record.duration,
        gaps=int(np.count_nonzero(steps > GAP * typical)),
        longest_gap=float(steps.max()),
        lost=1.0 - record.t.size / (count + 1.0),
        jitter=float(regular.std() / typical) if regular.size else 0.0,
        clipped=clipped_samples(record.y, resolution),
        resolution=resolution,
        noise=noise,
        snr_db=float(snr) if half_range > 0.0 else 0.0,
    )


def sample_noise(y: Array) -> float:
    """Return the standard deviation of white noise on a signal smooth at the sample rate."""
    return float(GAUSSIAN_MAD * np.median(np.abs(np.diff(y, 3))) / THIRD_DIFFERENCE)


def level_distance(y: Array) -> float:
    """Return the distance between the levels of quantized values; 0 where there are none."""
    levels = np.unique(y)
    if levels.size < 2 or y.size < FEWEST_REPEATS * levels.size:
        return _fine_level_distance(y, levels)
    return float(np.diff(levels).min())


def _fine_level_distance(y: Array, levels: Array) -> float:
    """Levels that are many: all distances must be whole multiples of the smallest."""
    if levels.size < 3 or levels.size > 0.9 * y.size:
        return 0.0
    distances = np.diff(levels)
    smallest = float(distances.min())
    parts = distances / smallest
    off = np.abs(parts - np.round(parts))
    return smallest if float(np.max(off / np.maximum(parts, 1.0))) < 1e-3 else 0.0


def clipped_samples(y: Array, resolution: float) -> Mask:
    """Return which samples are at a limit of the sensor's range, shape (k,).

    A limit shows as a pile of samples at the largest or the smallest value that is much higher
    than the pile one level further in, in runs too short for a rest.
    """
    clipped = np.zeros(y.size, bool)
    width = resolution or 0.005 * float(np.ptp(y))
    slack = 1e-9 * float(np.ptp(y))
    for side in (1.0, -1.0):
        height = side * y
        top = float(height.max())
        at_top = height >= top - slack
        next_in = np.count_nonzero((height < top - slack) & (height >= top - 1.5 * width))
        count = np.count_nonzero(at_top)
        if count < FEWEST_CLIPPED + PILED_UP * next_in:
            continue
        longest = max((last - first + 1 for first, last in runs(at_top)), default=0)
        if longest <= LONGEST_CLIPPED_RUN * y.size:
            clipped |= at_top
    return clipped


def runs(mask: Mask) -> list[tuple[int, int]]:
    """Return first and last index of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], mask.astype(int), [0]))))
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def doubtful_rate(record: Record) -> str:
    """Return why a record's sample rate is doubted; '' where it can be one."""
    rate = 1.0 / record.step
    if SLOWEST <= rate <= FASTEST:
        return ''
    likely = [unit for unit, size in UNITS.items() if 10.0 <= rate / size <= 1e5]
    hint = f': times may be in {likely[0]}, --time-unit {likely[0]}' if likely else ''
    return f'sampled at {rate:.3g} Hz, as no mechanical record is{hint}'
