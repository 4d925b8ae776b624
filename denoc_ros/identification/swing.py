"""Free swing of a joint under gravity or a spring, with viscous and Coulomb friction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import copysign, sin

import numpy as np

from denoc_ros.types import Array

STEPS_PER_CYCLE = 60


@dataclass(frozen=True)
class JointSwing:
    """Parameters of a free swing: everything per inertia.

    th'' + viscous th' + quadratic |th'| th' + coulomb sign th' + stiffness sin(th) = 0, th from
    the rest position.

    Attributes
    ----------
    angle, rate : float
        At the start [rad], [rad/s].
    rest : float
        Measured angle at which gravity is in balance [rad].
    stiffness : float
        [1/s^2]
    viscous, coulomb, quadratic : float
        [1/s], [1/s^2], [1/rad]
    """

    angle: float
    rate: float
    rest: float
    stiffness: float
    viscous: float = 0.0
    coulomb: float = 0.0
    quadratic: float = 0.0


def swing_angles(
    swing: JointSwing, t: Array, large: bool = True, steps: int = STEPS_PER_CYCLE
) -> Array:
    """Return the measured angle at times t from the start [rad].

    Parameters
    ----------
    swing : JointSwing
    t : ndarray, shape (k,)
        From 0, rising [s].
    large : bool
        Gravity's sine; False: a linear spring.
    steps : int
        Of the integration, per cycle of a small swing.

    Notes
    -----
    Runge-Kutta steps of fourth order between turning points, which are found (friction jumps
    there); at one the joint stays where friction holds it.
    """
    step = 2.0 * np.pi / np.sqrt(abs(swing.stiffness) + 1e-12) / steps
    step = min(step, float(t[-1]) / 10.0)
    times, angles, rates = _path(swing, float(t[-1]) + step, step, large)
    return np.asarray(swing.rest + _hermite(times, angles, rates, t))


def _path(swing: JointSwing, end: float, step: float, large: bool) -> tuple[Array, Array, Array]:
    time, angle, rate = 0.0, swing.angle - swing.rest, swing.rate
    rows = [(time, angle, rate)]
    side = copysign(1.0, rate if rate else -angle)
    while time < end:
        if rate == 0.0:
            pull = -swing.stiffness * (sin(angle) if large else angle)
            if abs(pull) <= swing.coulomb:
                rows.append((end, angle, 0.0))
                break
            side = copysign(1.0, pull)
        slope = _acceleration(swing, side, large)
        new_angle, new_rate = _step(slope, angle, rate, step)
        taken = step
        if new_rate * side < 0.0:
            taken = _turning(slope, angle, rate, step)
            new_angle, new_rate = _step(slope, angle, rate, taken)[0], 0.0
        time, angle, rate = time + taken, new_angle, new_rate
        rows.append((time, angle, rate))
    table = np.array(rows)
    return table[:, 0], table[:, 1], table[:, 2]


def _acceleration(swing: JointSwing, side: float, large: bool) -> Callable[[float, float], float]:
    stiffness, viscous = swing.stiffness, swing.viscous
    quadratic, coulomb = side * swing.quadratic, side * swing.coulomb
    if large:
        return lambda a, r: -stiffness * sin(a) - viscous * r - quadratic * r * r - coulomb
    return lambda a, r: -stiffness * a - viscous * r - quadratic * r * r - coulomb


def _step(
    slope: Callable[[float, float], float], angle: float, rate: float, h: float
) -> tuple[float, float]:
    r1, s1 = rate, slope(angle, rate)
    r2 = rate + 0.5 * h * s1
    s2 = slope(angle + 0.5 * h * r1, r2)
    r3 = rate + 0.5 * h * s2
    s3 = slope(angle + 0.5 * h * r2, r3)
    r4 = rate + h * s3
    s4 = slope(angle + h * r3, r4)
    return angle + h / 6.0 * (r1 + 2.0 * (r2 + r3) + r4), rate + h / 6.0 * (
        s1 + 2.0 * (s2 + s3) + s4
    )


def _turning(slope: Callable[[float, float], float], angle: float, rate: float, h: float) -> float:
    """Return the time within a step at which the rate is zero."""
    low, high = 0.0, h
    at_low, at_high = rate, _step(slope, angle, rate, h)[1]
    middle = h
    for _ in range(30):
        middle = high - at_high * (high - low) / (at_high - at_low)
        at = _step(slope, angle, rate, middle)[1]
        if abs(at) <= 1e-13 * max(abs(rate), abs(at_high), 1e-9):
            break
        if at * rate > 0.0:
            low, at_low = middle, at
            at_high *= 0.5
        else:
            high, at_high = middle, at
            at_low *= 0.5
    return max(middle, 1e-12)


def _hermite(times: Array, angles: Array, rates: Array, t: Array) -> Array:
    k = np.clip(np.searchsorted(times, t, side='right') - 1, 0, times.size - 2)
    h = times[k + 1] - times[k]
    x = (t - times[k]) / h
    return np.asarray(
        angles[k] * (1.0 + 2.0 * x) * (1.0 - x) ** 2
        + angles[k + 1] * x**2 * (3.0 - 2.0 * x)
        + h * (rates[k] * x * (1.0 - x) ** 2 - rates[k + 1] * x**2 * (1.0 - x))
    )
