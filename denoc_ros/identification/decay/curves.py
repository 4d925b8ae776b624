"""Damping of one mode over windows along its decay, and whether it changes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.special import chdtrc

from denoc_ros.identification.decay.damped import Damped, fit_damped
from denoc_ros.identification.decay.modes import AmplitudeCurve
from denoc_ros.identification.decay.records import Mask
from denoc_ros.types import Array

MOST_WINDOWS = 6
NORMAL_95 = 1.959964
CYCLES = 1.5  # of the mode in one window
SAMPLES = 16
LOWEST = 3.0  # envelope in standard deviations of the noise where the last window ends
CHANCE = 1e-4  # of calling noise a change
UNLIKELY = 0.01  # of calling noise a spread of the frequency
SMALLEST_CHANGE = 0.03  # of the damping ratio, between windows


def zeta_and_rate(sigma: float, omega: float) -> tuple[float, float]:
    """Return damping ratio and undamped angular frequency [rad/s] of a pole."""
    rate = float(np.hypot(sigma, omega))
    return sigma / rate, rate


def pole_zeta_deviation(pole: Array, covariance: Array, k: int) -> float:
    """Return the standard deviation of the damping ratio of pole k of a covariance."""
    sigma, omega = pole
    slope = np.array([omega**2, -sigma * omega]) / np.hypot(sigma, omega) ** 3
    return along(slope, covariance, k)


def along(slope: Array, covariance: Array, k: int) -> float:
    """Standard deviation of a function of pole k with this slope, from the poles' covariance."""
    block = covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2]
    return float(np.sqrt(max(float(slope @ block @ slope), 0.0)))


def zeta_deviation(fit: Damped, k: int) -> float:
    """Return the standard deviation of mode k's damping ratio from a fit's covariance."""
    return pole_zeta_deviation(fit.poles[k], fit.covariance(), k)


def amplitude_curve(
    t: Array, own: Array, sigma: float, omega: float, noise: float
) -> AmplitudeCurve | None:
    """Return the damping ratio over windows; None where there is room for one window only.

    Parameters
    ----------
    t, own : ndarray, shape (k,)
        Times from the release [s]; the record without its other components [unit].
    sigma, omega : float
        The mode's decay rate [1/s] and damped angular frequency [rad/s].
    noise : float
        Standard deviation [unit].
    """
    rows = []
    for inside in _windows(t, own, omega, noise):
        middle = 0.5 * (t[inside][0] + t[inside][-1])
        start = t[inside][0]
        fit = fit_damped(t[inside] - start, own[inside], np.array([[sigma, omega]]), base=False)
        if not 0.5 * omega < fit.poles[0, 1] < 2.0 * omega:
            continue
        zeta, rate = zeta_and_rate(*fit.poles[0])
        envelope = abs(fit.complex_amplitudes[0]) * np.exp(-fit.poles[0, 0] * (middle - start))
        rows.append((middle, envelope, rate / (2.0 * np.pi), zeta, zeta_deviation(fit, 0)))
    if len(rows) < 2:
        return None
    time, level, frequency, zetas, deviation = np.array(rows).T
    deviation = np.maximum(deviation, 1e-12)
    trend, dependent = _change(level, zetas, deviation)
    return AmplitudeCurve(time, level, frequency, zetas, deviation, trend, dependent)


def window_interval(curve: AmplitudeCurve, zeta: float, deviation: float) -> Array:
    """Return the 95 % interval of the damping ratio that the windows give, shape (2,).

    The fit's variance and the variance between windows, noise taken off; where the damping ratio
    changes along the decay: what it ranges over.

    Notes
    -----
    DerSimonian and Laird's moment estimate, Controlled Clinical Trials 7, 1986.
    """
    spread = _between(curve.damping_ratio, curve.deviation)
    half = NORMAL_95 * np.sqrt(deviation**2 + spread)
    low, high = zeta - half, zeta + half
    if spread and not (low < curve.damping_ratio).any() & (curve.damping_ratio < high).any():
        # none of the windows has what the whole record has: two cosines of one mode, say
        low = min(low, curve.damping_ratio.min())
        high = max(high, curve.damping_ratio.max())
    if curve.dependent:
        sharp = curve.deviation <= max(0.25 * abs(zeta), np.sort(curve.deviation)[1])
        low = min(curve.damping_ratio[sharp].min(), zeta - NORMAL_95 * deviation)
        high = max(curve.damping_ratio[sharp].max(), zeta + NORMAL_95 * deviation)
    return np.array([low, high])


def frequency_spread(curve: AmplitudeCurve) -> float:
    """Return the standard deviation of the frequency between windows, noise taken off [Hz].

    0 where noise alone explains the differences. Noise moves decay rate and frequency alike, so
    a window's deviation of the frequency is the frequency times that of the damping ratio.
    """
    noise = curve.frequency * curve.deviation
    weight = 1.0 / noise**2
    mean = weight @ curve.frequency / weight.sum()
    scatter = float(weight @ (curve.frequency - mean) ** 2)
    if chdtrc(weight.size - 1, scatter) > UNLIKELY:
        return 0.0
    return float(np.sqrt(_between(curve.frequency, noise)))


def _between(values: Array, deviation: Array) -> float:
    """Return the variance between windows by DerSimonian and Laird's moment estimate."""
    weight = 1.0 / deviation**2
    mean = weight @ values / weight.sum()
    excess = weight @ (values - mean) ** 2 - (weight.size - 1)
    return float(max(0.0, excess / (weight.sum() - weight @ weight / weight.sum())))


def _windows(t: Array, own: Array, omega: float, noise: float) -> list[Mask]:
    cycle = max(int(2.0 * np.pi / omega / np.median(np.diff(t))), 1)
    envelope = np.sqrt(2.0 * uniform_filter1d(own**2, cycle))
    loud = np.flatnonzero(envelope > LOWEST * noise)
    end = float(t[loud[-1]]) if loud.size else 0.0
    count = int(min(MOST_WINDOWS, end * omega / (2.0 * np.pi * CYCLES)))
    if count < 2:
        return []
    edges = np.linspace(0.0, end, count + 1)
    windows = [(t >= low) & (t <= high) for low, high in pairwise(edges)]
    return [inside for inside in windows if np.count_nonzero(inside) >= SAMPLES]


def _change(level: Array, zetas: Array, deviation: Array) -> tuple[float, bool]:
    """Return the slope over the log of the amplitude, and whether the windows differ."""
    weight = 1.0 / deviation**2
    mean = weight @ zetas / weight.sum()
    away = np.log(level) - weight @ np.log(level) / weight.sum()
    trend = float(weight @ (away * (zetas - mean)) / max(weight @ away**2, 1e-300))
    scatter = float(weight @ (zetas - mean) ** 2)
    surprising = chdtrc(zetas.size - 1, scatter) < CHANCE
    large = float(np.sqrt(np.average((zetas - mean) ** 2, weights=weight)))
    return trend, bool(surprising and large > SMALLEST_CHANGE * abs(mean))
