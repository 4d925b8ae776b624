"""Logarithmic decrement, exact and as printed, and the joint's viscous coefficient from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.signal import find_peaks
from scipy.special import stdtrit

from denoc_ros.errors import IdentificationError
from denoc_ros.identification.decay.records import Record, assess
from denoc_ros.types import Array

Convention = Literal['exact', 'book']

CLOSEST = 0.6  # of a cycle: crests nearer than that are one
SAME_FREQUENCY = 0.1  # that the crests may be off the mode's
PROMINENCE = 10.0  # standard deviations of the noise: its own extremes have up to 7
FEWEST_CRESTS = 2


@dataclass(frozen=True, eq=False)
class Decrement:
    """Damping ratio from the crests of a decay."""

    decrement: float  # logarithm of the ratio of crests one cycle apart
    damping_ratio: float
    # (2,) 95 % interval of the damping ratio from the scatter of the crests; nan for two of them
    interval: Array
    frequency: float  # undamped natural frequency [Hz] (book: the damped one)
    # time, height: (k,) of the extremes used [s], [record's unit]: distances from the level they
    # decay to
    time: Array
    height: Array
    convention: Convention


def damping_ratio(decrement: float, convention: Convention = 'exact') -> float:
    """Return the damping ratio of a logarithmic decrement.

    Notes
    -----
    Exact: delta / sqrt(4 pi^2 + delta^2). Book, eq. 8.4b: delta / (2 pi), right for small ones.
    """
    if convention == 'book':
        return decrement / (2.0 * np.pi)
    return decrement / float(np.hypot(2.0 * np.pi, decrement))


def log_decrement(
    record: Record, convention: Convention = 'exact', frequency: float | None = None
) -> Decrement:
    """Return the damping ratio of a decay of one mode from its extremes.

    Exact: the slope of the logarithm of all distances between neighbouring extremes (half cycles:
    no offset enters), least squares weighted
    by their squares. Book, eq. 8.4b: the first and the last crest above the mean
    of the last cycle.

    Parameters
    ----------
    frequency : float, optional
        Of the mode, damped [Hz], where it is known: what else swings then makes no crests of its
        own.

    Raises
    ------
    IdentificationError
        Fewer than two crests stand out of the noise, or they are not those of the frequency.
    """
    times, values = _extremes(record, frequency)
    if frequency is not None:
        _require_same(record, frequency, 0.5 / float(np.mean(np.diff(times))))
    if convention == 'book':
        return _from_crests(record, times, values)
    heights = np.abs(np.diff(values)) / 2.0
    middle = 0.5 * (times[1:] + times[:-1])
    half = float(np.mean(np.diff(times)))
    cycles = (middle - middle[0]) / (2.0 * half)
    slope, deviation = _slope(cycles, np.log(heights), heights**2)
    zeta = damping_ratio(-slope)
    spread = stdtrit(max(cycles.size - 2, 1), 0.975) * deviation / (2.0 * np.pi)
    frequency = 0.5 / half / np.sqrt(1.0 - zeta**2)
    interval = np.array([zeta - spread, zeta + spread])
    return Decrement(-slope, zeta, interval, float(frequency), middle, heights, convention)


def critical_joint_damping(
    frequency: float,
    inertia: float | None = None,
    mass_per_length: float | None = None,
    length: float | None = None,
    convention: Convention = 'exact',
) -> float:
    """Return the critical damping of a joint with a link that swings on it.

    Exact: 2 I w [N m s/rad], with the inertia I about the joint [kg m^2]. Book, eq. 8.4c:
    4 pi rho a eta = 2 m w [kg/s], of the link's mass per length rho [kg/m], its length a [m] and
    the frequency eta [Hz]; it stands in a torque equation, where a mass has no place.

    Raises
    ------
    IdentificationError
        What the convention asks for is missing.
    """
    if convention == 'book':
        if mass_per_length is None or length is None:
            raise IdentificationError(
                'critical_joint_damping: mass_per_length and length must be given for the '
                f"convention 'book', got {mass_per_length} and {length}"
            )
        return 4.0 * np.pi * mass_per_length * length * frequency
    if inertia is None:
        raise IdentificationError(
            'critical_joint_damping: the inertia about the joint must be given, got None'
        )
    return 2.0 * inertia * 2.0 * np.pi * frequency


def _require_same(record: Record, frequency: float, found: float) -> None:
    if abs(found / frequency - 1.0) > SAME_FREQUENCY:
        raise IdentificationError(
            f'{record.name}: crests must be those of {frequency:.4g} Hz, got some of '
            f'{found:.4g} Hz: another vibration is present'
        )


def _extremes(record: Record, frequency: float | None) -> tuple[Array, Array]:
    """Return times and values of alternating crests and troughs that stand out of the noise."""
    y = record.y - np.mean(record.y)
    prominence = PROMINENCE * max(assess(record).noise, 1e-6 * float(np.ptp(y)))
    apart = 1 if frequency is None else max(int(CLOSEST / frequency / record.step), 1)
    signed = [(k, 1) for k in find_peaks(y, prominence=prominence, distance=apart)[0]]
    signed += [(k, -1) for k in find_peaks(-y, prominence=prominence, distance=apart)[0]]
    kept: list[tuple[int, int]] = []
    for k, side in sorted(signed):
        if kept and kept[-1][1] == side:
            if side * y[k] > side * y[kept[-1][0]]:
                kept[-1] = (k, side)
        else:
            kept.append((k, side))
    if len(kept) < 2 * FEWEST_CRESTS - 1:
        raise IdentificationError(
            f'{record.name}: a decay must have at least {FEWEST_CRESTS} crests above the noise, '
            f'got {len(kept)} extremes'
        )
    points = [_vertex(record, k) for k, _ in kept]
    return np.array([t for t, _ in points]), np.array([v for _, v in points])


def _vertex(record: Record, k: int) -> tuple[float, float]:
    """Return time and value of the extreme of a parabola through the samples around one."""
    around = slice(max(0, k - 2), k + 3)
    t, y = record.t[around] - record.t[k], record.y[around]
    curve = np.polyfit(t, y, 2)
    at = -curve[1] / (2.0 * curve[0]) if curve[0] else 0.0
    at = float(np.clip(at, t[0], t[-1]))
    return float(record.t[k] + at), float(np.polyval(curve, at))


def _slope(x: Array, y: Array, weight: Array) -> tuple[float, float]:
    """Return slope of a weighted line and its standard deviation (nan for two points)."""
    away = x - weight @ x / weight.sum()
    inertia = float(weight @ away**2)
    slope = float((weight * away) @ y / inertia)
    if x.size < 3:
        return slope, np.nan
    rest = y - weight @ y / weight.sum() - slope * away
    return slope, float(np.sqrt(weight @ rest**2 / (x.size - 2) / inertia))


def _from_crests(record: Record, times: Array, values: Array) -> Decrement:
    cycle = 2.0 * float(np.mean(np.diff(times)))
    level = float(np.mean(record.y[record.t > record.t[-1] - cycle]))
    crests = values > level
    time, height = times[crests], values[crests] - level
    count = round((time[-1] - time[0]) / cycle) if time.size else 0
    if time.size < FEWEST_CRESTS or not count:
        raise IdentificationError(
            f'{record.name}: a decay must have at least {FEWEST_CRESTS} crests above its last '
            f"cycle's mean, a cycle apart, got {time.size}"
        )
    decrement = float(np.log(height[0] / height[-1]) / count)
    unknown = np.full(2, np.nan)
    zeta = damping_ratio(decrement, 'book')
    return Decrement(decrement, zeta, unknown, 1.0 / cycle, time, height, 'book')
