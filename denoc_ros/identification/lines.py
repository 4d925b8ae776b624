"""Harmonics, sums and differences among the components of a record."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from denoc_ros.identification.damped import Damped
from denoc_ros.identification.modes import Line
from denoc_ros.identification.residual import coloured
from denoc_ros.types import Array

HIGHEST_HARMONIC = 5
MUCH_WEAKER = 0.1  # than the mode a suspect may be a harmonic of
NEAR = 0.3  # of one over the record's duration, for a suspect
WEAKER = 0.3  # than each of its parents at the release
DEVIATIONS = 3.0
RESOLUTION = 0.1  # of one over the record's duration
WIDTH = 0.5  # of its decay rate, for a line beside a residual that is no white noise
FARTHEST = 0.03  # of the line's frequency, however uncertain it is
FEWEST_CYCLES = 2.0  # of a parent in the record: a slower one is hardly told from the drift
DECAY_MATCH = 0.3  # of the decay rate that the parents give


def find_lines(fit: Damped, span: float) -> dict[int, Line]:
    """Return the components that are no modes, by their number in the fit.

    A product of damped cosines is one whose frequency and decay rate are sums of its parents'
    (the n-th harmonic: n times both; a difference: of the frequencies only), and it is weaker.
    """
    size = np.abs(fit.complex_amplitudes)
    variance = np.diag(fit.covariance()).reshape(-1, 2)
    width = WIDTH if coloured(fit.residual) else 0.0
    found: dict[int, Line] = {}
    for k in np.argsort(size):
        for multiples, origin in _combinations(fit.poles, int(k)):
            parents = np.flatnonzero(multiples)
            if any(p in found for p in parents) or size[k] > WEAKER * size[parents].min():
                continue
            if fit.poles[parents, 1].min() * span < 2.0 * np.pi * FEWEST_CYCLES:
                continue
            if _matches(fit.poles, variance, int(k), multiples, span, width):
                sigma, omega = fit.poles[k]
                frequency = float(omega / (2.0 * np.pi))
                found[int(k)] = Line(frequency, float(sigma), float(size[k]), origin)
                break
    return found


def suspects(fit: Damped, span: float) -> dict[int, str]:
    """Weak components that may be harmonics by their frequencies alone, each with its origin.

    Friction makes harmonics that decay with the parent or more slowly.
    """
    size = np.abs(fit.complex_amplitudes)
    hertz = fit.poles[:, 1] / (2.0 * np.pi)
    found = {}
    for k in range(len(hertz)):
        for i in range(len(hertz)):
            n = round(hertz[k] / hertz[i])
            near = abs(hertz[k] - n * hertz[i]) < min(NEAR / span, FARTHEST * hertz[k])
            near = near and hertz[i] * span > FEWEST_CYCLES
            if 2 <= n <= HIGHEST_HARMONIC and near and size[k] < MUCH_WEAKER * size[i]:
                found[k] = f'{n} x {hertz[i]:.4g} Hz'
    return found


def _combinations(poles: Array, k: int) -> Iterator[tuple[Array, str]]:
    hertz = poles[:, 1] / (2.0 * np.pi)
    others = [i for i in range(len(poles)) if i != k]
    for i in others:
        for n in range(2, HIGHEST_HARMONIC + 1):
            yield _multiples(len(poles), {i: n}), f'{n} x {hertz[i]:.4g} Hz'
    for i in others:
        for j in others:
            if i < j:
                low, high = sorted((i, j), key=lambda one: hertz[one])
                pair = f'{hertz[high]:.4g} {{}} {hertz[low]:.4g} Hz'
                yield _multiples(len(poles), {i: 1, j: 1}), pair.format('+')
                yield _multiples(len(poles), {high: 1, low: -1}), pair.format('-')


def _multiples(count: int, at: dict[int, int]) -> Array:
    multiples = np.zeros(count)
    for index, value in at.items():
        multiples[index] = value
    return multiples


def _matches(
    poles: Array, variance: Array, k: int, multiples: Array, span: float, width: float
) -> bool:
    decay = float(np.abs(multiples) @ poles[:, 0])
    spread = np.sqrt(variance[k] + multiples**2 @ variance)
    off_frequency = abs(poles[k, 1] - abs(float(multiples @ poles[:, 1])))
    off_decay = abs(poles[k, 0] - decay)
    near = max(DEVIATIONS * spread[1], 2.0 * np.pi * RESOLUTION / span)
    near = max(min(near, 2.0 * np.pi / span), width * decay)
    near = min(near, FARTHEST * poles[k, 1])
    uncertain = min(DEVIATIONS * spread[0], abs(decay))
    return bool(off_frequency < near and off_decay < uncertain + DECAY_MATCH * abs(decay))
