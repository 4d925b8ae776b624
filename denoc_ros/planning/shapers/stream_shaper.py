"""A stream of joint samples through input shapers whose modes may change meanwhile."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from denoc_ros.errors import StateError
from denoc_ros.planning.shapers.impulses import impulse_weights
from denoc_ros.types import Array

SMOOTHING = 0.02  # s in which new frequencies take over, so that accelerations do not jump
SLOWEST = 0.5  # of the first frequencies: how slow modes may become


class StreamShaper:
    """Takes a sample of the joints each period and gives a shaped one; its memory does not grow.

    Causal: what it gives now is made of this sample and of earlier ones. Modes follow each other,
    one delay line each.

    Parameters
    ----------
    method : str
        ``zv``, ``zvd`` or ``ei``.
    frequencies, ratios : (k,) arrays
        Damped frequencies [Hz] and damping ratios of the modes; the ratios stay.
    start : (joints,) array
        Where the joints stand [rad, m].
    period : float
        s between samples.

    Raises
    ------
    StateError
        Another method, or numbers that are not > 0.
    """

    def __init__(
        self, method: str, frequencies: ArrayLike, ratios: ArrayLike, start: Array, period: float
    ) -> None:
        wanted = np.array(frequencies, dtype=np.float64, ndmin=1)
        if not (np.isfinite(period) and period > 0.0):
            raise StateError(f'shaper: period must be > 0 s, got {period}')
        self._require_positive(wanted)
        self._period = float(period)
        self._wanted, self._frequency = wanted, wanted.copy()
        self._slope = np.zeros(len(wanted))
        self._lines = [
            _DelayLine(impulse_weights(method, float(ratio)), SLOWEST * frequency, period, start)
            for frequency, ratio in zip(wanted, np.atleast_1d(ratios), strict=True)
        ]
        self._slowest = SLOWEST * wanted
        self._turns = len(self._lines[0].weights) - 1
        self.reset(start)

    @property
    def delay(self) -> float:
        """How much later a motion ends with the modes of now [s]."""
        return float((0.5 * self._turns / self._frequency).sum())

    def reset(self, start: Array) -> None:
        """Discard all samples: the joints rest at `start` (joints,)."""
        for line, frequency in zip(self._lines, self._frequency, strict=True):
            line.reset(np.asarray(start, dtype=np.float64), float(frequency))

    def retune(self, frequencies: ArrayLike) -> None:
        """Take other damped frequencies (k,) [Hz], of the posture and payload of now.

        They take over smoothly within some `SMOOTHING` s; slower ones than half of the first ones
        count as those.

        Raises
        ------
        StateError
            Of another number, or not > 0.
        """
        wanted = np.asarray(frequencies, dtype=np.float64)
        if wanted.shape != self._wanted.shape:
            raise StateError(
                f'shaper: there must be {len(self._wanted)} frequencies, got {wanted.shape}'
            )
        self._require_positive(wanted)
        self._wanted = np.maximum(wanted, self._slowest)

    @staticmethod
    def _require_positive(frequencies: Array) -> None:
        if not (np.isfinite(frequencies).all() and (frequencies > 0.0).all()):
            raise StateError(f'shaper: frequencies must be > 0 Hz, got {frequencies.tolist()}')

    def step(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Take a sample, each (joints,); return the shaped one (3, joints): q, qd, qdd.

        Rates and accelerations of the result are those of its positions, whatever the modes do.
        """
        self._follow()
        sample = np.stack((q, qd, qdd))
        for k in reversed(range(len(self._lines))):  # last the slowest: at the present phase
            frequency, slope = float(self._frequency[k]), float(self._slope[k])
            sample = self._lines[k].step(sample, frequency, slope)
        return sample

    def _follow(self) -> None:
        """Take the frequencies one period on: a critically damped second-order lag."""
        rate = 1.0 / SMOOTHING
        h = self._period
        off = self._frequency - self._wanted
        lead = self._slope + rate * off
        fall = math.exp(-rate * h)
        self._frequency = self._wanted + (off + lead * h) * fall
        self._slope = (self._slope - rate * lead * h) * fall


class _DelayLine:
    """The samples of one mode's shaper, and half turns of the mode's phase when they came."""

    def __init__(self, weights: Array, slowest: float, period: float, start: Array) -> None:
        self.weights = weights
        self._turns = np.arange(1.0, len(weights))
        self._period = period
        depth = math.ceil(0.5 * len(self._turns) / (slowest * period)) + 4
        self._samples = np.zeros((depth, 3, len(start)))
        self._phase, self._frequency, self._slope = np.zeros((3, depth))
        self._newest = 0
        self._left = np.zeros(len(self._turns), dtype=np.int64)  # before the impulses' moments

    def reset(self, start: Array, frequency: float) -> None:
        """Fill the line with rest at `start` and one frequency [Hz]."""
        depth = len(self._samples)
        self._samples[:] = 0.0
        self._samples[:, 0] = start
        self._phase[:] = 2.0 * frequency * self._period * (np.arange(depth) - (depth - 1))
        self._frequency[:] = frequency
        self._slope[:] = 0.0
        self._newest = depth - 1
        self._left[:] = 0

    def step(self, sample: Array, frequency: float, slope: float) -> Array:
        """Take a sample (3, joints), the frequency [Hz] and its rate; return the shaped sample."""
        depth, h = len(self._samples), self._period
        before = self._newest % depth
        self._newest += 1
        now = self._newest % depth
        self._samples[now] = sample
        self._frequency[now], self._slope[now] = frequency, slope
        self._phase[now] = self._phase[before] + h * (self._frequency[before] + frequency)
        result = np.asarray(self.weights[0] * sample)
        for k, turns in enumerate(self._turns):
            moment = self._phase[now] - turns
            result += self.weights[k + 1] * self._at(k, moment, frequency, slope)
        return result

    def _at(self, k: int, phase: float, frequency: float, slope: float) -> Array:
        """Return the sample (3, joints) when the mode had a phase, with rates by time now."""
        depth, h = len(self._samples), self._period
        left = max(int(self._left[k]), self._newest - depth + 1)
        while left < self._newest - 1 and self._phase[(left + 1) % depth] <= phase:
            left += 1
        self._left[k] = left
        a, b = left % depth, (left + 1) % depth
        first, more = self._frequency[a], self._frequency[b] - self._frequency[a]
        # the frequency is linear from a to b, so the phase is a parabola
        way = max(0.0, (phase - self._phase[a]) / (2.0 * h))
        share = 2.0 * way / (first + math.sqrt(max(0.0, first * first + 2.0 * more * way)))
        then = first + share * more
        then_slope = self._slope[a] + share * (self._slope[b] - self._slope[a])
        pace = frequency / then  # how fast that moment moves
        change = (slope - then_slope * pace * pace) / then
        q, qd, qdd = between(self._samples[a], self._samples[b], share, h)
        return np.stack((q, qd * pace, qdd * pace * pace + qd * change))


def between(first: Array, last: Array, share: float, step: float) -> tuple[Array, Array, Array]:
    """Return q, qd, qdd at a share of the way between two samples (3, joints), `step` s apart.

    Cubics through positions and rates, and through rates and accelerations.
    """
    s, rest = share, 1.0 - share
    start, end = rest * rest * (1.0 + 2.0 * s), s * s * (1.0 + 2.0 * rest)
    leaving, coming = step * s * rest * rest, -step * s * s * rest
    q = start * first[0] + end * last[0] + leaving * first[1] + coming * last[1]
    qd = start * first[1] + end * last[1] + leaving * first[2] + coming * last[2]
    return q, qd, rest * first[2] + s * last[2]
