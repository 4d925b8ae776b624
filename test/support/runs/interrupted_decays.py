"""Free decays that a later excitation interrupts: steps to another level, and blows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from denoc_ros.identification.decay.records import Record
from denoc_ros.types import Array


@dataclass(frozen=True)
class Interrupted:
    """A record of two step responses of one oscillator.

    Attributes
    ----------
    record : Record
    release, second : float
        When the first and the second excitation begin [s].
    size : float
        Of the second, by the amplitude that the first has left then.
    frequency, zeta : float
        [Hz]; damping ratio.
    """

    record: Record
    release: float
    second: float
    size: float
    frequency: float
    zeta: float


def interrupted_decay(seed: int, size: tuple[float, float] = (0.2, 5.0)) -> Interrupted:
    """Return the draw of a seed: steps up and down, blows, small and large, early and late.

    Parameters
    ----------
    seed : int
    size : (float, float)
        Least and largest second excitation, by the amplitude that is left then.
    """
    draw = np.random.default_rng([seed, 14])
    frequency = float(np.exp(draw.uniform(np.log(0.5), np.log(20.0))))
    zeta = float(np.exp(draw.uniform(np.log(0.003), np.log(0.05))))
    folds = draw.uniform(1.0, 3.5)
    length = max(folds / (2.0 * np.pi * zeta), 8.0) / frequency
    rate = frequency * draw.uniform(16.0, 60.0)
    release = draw.choice([0.0, 0.3]) * length
    t = np.arange(int(min((release + length) * rate, 12000))) / rate
    length = float(t[-1]) - release
    cycle = 1.0 / frequency
    share = draw.uniform(0.3, 0.9) if seed % 3 else draw.uniform(0.9, 0.99)
    second = release + max(share * length, 5.0 * cycle)
    second = min(second, float(t[-1]) - 0.4 * cycle)
    left = np.exp(-2.0 * np.pi * frequency * zeta * (second - release))
    relative = float(np.exp(draw.uniform(*np.log(size))))
    height = relative * left * draw.choice([-1.0, 1.0])
    sharp = draw.random() < 0.3
    y = _response(t - release, frequency, zeta, False) * (draw.choice([-1.0, 1.0]))
    y = y + height * _response(t - second, frequency, zeta, sharp)
    noise = min(0.02 * left * relative, 10.0 ** draw.uniform(-4.0, -2.0))
    y = y + noise * draw.standard_normal(t.size)
    return Interrupted(Record(t, y, f'draw {seed}'), release, second, relative, frequency, zeta)


def _response(t: Array, frequency: float, zeta: float, sharp: bool) -> Array:
    """Return the response (k,) to a unit step at 0, or to a blow."""
    since = np.maximum(t, 0.0)
    rate = 2.0 * np.pi * frequency
    damped = rate * np.sqrt(1.0 - zeta**2)
    fall = np.exp(-zeta * rate * since)
    if sharp:
        return np.asarray(fall * np.sin(damped * since))
    turn = np.cos(damped * since) + zeta * rate / damped * np.sin(damped * since)
    return np.asarray((1.0 - fall * turn) * (t >= 0.0))
