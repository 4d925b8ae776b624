"""Records as strangers make them, of true physics: free decays, and what only looks like one.

A draw has a shape, a true mode where it has one, and a file's text. What is no free decay, or has
a damping that changes, must never be called good with an interval that excludes the truth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from denoc_ros.types import Array

Draw = np.random.Generator


@dataclass(frozen=True)
class StrangeRecord:
    """A record and its truth.

    Attributes
    ----------
    shape : str
    t, y : (k,) array
        Stamps [s] and values.
    is_clean : bool
        A free decay of steady modes that any good estimator calls good.
    frequency, zeta : float
        Of the strongest mode [Hz]; nan where nothing rings freely.
    lowest, highest : float
        Of its damping ratio over the amplitudes of the record.
    """

    shape: str
    t: Array
    y: Array
    is_clean: bool
    frequency: float = float('nan')
    zeta: float = float('nan')
    lowest: float = float('nan')
    highest: float = float('nan')

    def is_false_good(self, frequency: float, interval: Array) -> bool:
        """Say whether a mode that is called good, of an interval of zeta (2,), is not true."""
        if not np.isfinite(self.zeta):
            return True
        if abs(frequency / self.frequency - 1.0) > 0.02:
            return True
        low, high = interval
        # a steady damping ratio may be outside one interval in twenty, not far outside
        slack = 0.5 * (high - low)
        return bool(self.highest < low - slack or self.lowest > high + slack)


@dataclass(frozen=True)
class Ring:
    """A free decay by its physics: stiffness and damping may depend on the amplitude."""

    frequency: float
    zeta: float
    coulomb: float = 0.0  # of the release's restoring force
    quadratic: float = 0.0  # zeta more per unit of amplitude
    hardening: float = 0.0  # of the stiffness at unit amplitude

    def values(self, t: Array, release: float = 1.0) -> Array:
        """Return the motion (k,) from a release at rest."""
        if not (self.coulomb or self.quadratic or self.hardening):
            rate = 2.0 * np.pi * self.frequency
            damped = rate * np.sqrt(1.0 - self.zeta**2)
            turn = np.cos(damped * t) + self.zeta / np.sqrt(1.0 - self.zeta**2) * np.sin(
                damped * t
            )
            return np.asarray(release * np.exp(-self.zeta * rate * t) * turn)
        rate = 2.0 * np.pi * self.frequency

        def slopes(_: float, state: Array) -> list[float]:
            x, v = state
            size = np.hypot(x, v / rate)
            zeta = self.zeta + self.quadratic * size
            force = rate**2 * (x + self.hardening * x**3) + 2.0 * zeta * rate * v
            return [v, -force - self.coulomb * rate**2 * np.tanh(v / (1e-3 * rate))]

        found = solve_ivp(slopes, (0.0, t[-1]), [release, 0.0], t_eval=t, rtol=1e-8, atol=1e-10)
        return np.asarray(found.y[0])

    def range(self, left: float) -> tuple[float, float]:
        """Return the least and largest damping ratio between a share of the release and it."""
        sizes = np.array([left, 1.0])
        friction = 2.0 * self.coulomb / (np.pi * sizes)  # equivalent viscous, of a cycle
        zetas = self.zeta + 8.0 / (3.0 * np.pi) * self.quadratic * sizes + friction
        return float(zetas.min()), float(zetas.max())


def time_grid(draw: Draw, frequency: float, cycles: float) -> Array:
    rate = frequency * draw.uniform(12.0, 60.0)
    return np.arange(int(min(max(cycles / frequency * rate, 200.0), 6000.0))) / rate


def steady_ring(draw: Draw) -> tuple[Ring, Array]:
    frequency = float(np.exp(draw.uniform(np.log(0.5), np.log(60.0))))
    zeta = float(np.exp(draw.uniform(np.log(0.002), np.log(0.05))))
    folds = draw.uniform(1.0, 4.0)
    return Ring(frequency, zeta), time_grid(draw, frequency, folds / (2.0 * np.pi * zeta))


def clean_decay(shape: str, ring: Ring, t: Array, y: Array) -> StrangeRecord:
    return StrangeRecord(shape, t, y, True, ring.frequency, ring.zeta, ring.zeta, ring.zeta)


def noise_of(draw: Draw, y: Array, snr_db: float) -> Array:
    return np.asarray(np.abs(y).max() * 10.0 ** (-snr_db / 20.0) * draw.standard_normal(y.size))


def free_decay(draw: Draw) -> StrangeRecord:
    """Return a plain decay."""
    ring, t = steady_ring(draw)
    y = ring.values(t)
    return clean_decay('free decay', ring, t, y + noise_of(draw, y, draw.uniform(35.0, 60.0)))


def with_drift(draw: Draw) -> StrangeRecord:
    """Return a decay on an offset that drifts."""
    ring, t = steady_ring(draw)
    y = ring.values(t)
    base = draw.uniform(-3.0, 3.0) + draw.uniform(-0.2, 0.2) * t / t[-1]
    return clean_decay('drift', ring, t, y + base + noise_of(draw, y, draw.uniform(35.0, 60.0)))


def coarse(draw: Draw) -> StrangeRecord:
    """Return a decay of a sensor with few levels."""
    ring, t = steady_ring(draw)
    y = ring.values(t)
    y = y + noise_of(draw, y, draw.uniform(40.0, 50.0))
    level = draw.uniform(0.002, 0.006)
    return clean_decay('coarse', ring, t, level * np.round(y / level))


def clipped(draw: Draw) -> StrangeRecord:
    """Return a decay whose release is beyond the sensor's range."""
    ring, t = steady_ring(draw)
    y = ring.values(t)
    limit = draw.uniform(0.7, 0.95)
    noisy = y + noise_of(draw, y, draw.uniform(40.0, 60.0))
    return clean_decay('clipped', ring, t, np.clip(noisy, -limit, limit))


def two_modes(draw: Draw) -> StrangeRecord:
    """Return a decay of two modes far apart."""
    ring, t = steady_ring(draw)
    second = Ring(ring.frequency * draw.uniform(1.8, 3.5), ring.zeta * draw.uniform(0.5, 2.0))
    y = ring.values(t) + draw.uniform(0.05, 0.3) * second.values(t)
    return clean_decay('two modes', ring, t, y + noise_of(draw, y, draw.uniform(40.0, 60.0)))


def lossy(draw: Draw) -> StrangeRecord:
    """Return a decay with lost samples and uneven stamps."""
    ring, t = steady_ring(draw)
    step = float(t[1])
    t = np.abs(t + 0.2 * step * np.clip(draw.standard_normal(t.size), -2.0, 2.0))
    t = t[draw.random(t.size) > 0.05]
    y = ring.values(t)
    return clean_decay('lossy', ring, t, y + noise_of(draw, y, draw.uniform(40.0, 60.0)))


def driven_tone(draw: Draw) -> StrangeRecord:
    """Return a driven vibration of slowly falling strength."""
    frequency = draw.uniform(2.0, 60.0)
    t = time_grid(draw, frequency, draw.uniform(60.0, 500.0))
    least = draw.choice([0.001, 0.026, 0.1, 0.2])
    if draw.random() < 0.5:
        fall = np.exp(-least * t / t[-1])
    else:
        fall = 1.0 - least * (t / t[-1]) ** draw.choice([0.5, 1.0, 2.0])
    turns = 2.0 * np.pi * draw.uniform(0.5, 3.0) * t / t[-1]
    wander = 1.0 + draw.choice([0.0, 1e-5, 1e-4, 5e-3]) * np.sin(turns)
    y = fall * wander * np.sin(2.0 * np.pi * frequency * t + draw.uniform(0.0, 6.0))
    y = y + noise_of(draw, y, draw.uniform(30.0, 70.0))
    if draw.random() < 0.5:
        level = 10.0 ** draw.uniform(-3.0, -1.5)
        y = level * np.round(y / level)
    return StrangeRecord('driven tone', t, y, False)


def clipped_tone(draw: Draw) -> StrangeRecord:
    """Return a driven vibration beyond the sensor's range."""
    made = driven_tone(draw)
    limit = draw.uniform(0.5, 0.95)
    return StrangeRecord('clipped tone', made.t, np.clip(made.y, -limit, limit), False)


def two_tones(draw: Draw) -> StrangeRecord:
    """Return the beat of two driven vibrations, cut off in a falling part."""
    frequency = draw.uniform(2.0, 60.0)
    t = time_grid(draw, frequency, draw.uniform(20.0, 60.0))
    beat = draw.uniform(0.2, 0.45) / t[-1]
    y = np.sin(2.0 * np.pi * frequency * t) + np.sin(2.0 * np.pi * (frequency + beat) * t)
    return StrangeRecord('two tones', t, y + noise_of(draw, y, draw.uniform(30.0, 60.0)), False)


def _changing(shape: str, ring: Ring, draw: Draw, cycles: float) -> StrangeRecord:
    t = time_grid(draw, ring.frequency, cycles)
    y = ring.values(t)
    left = max(float(np.abs(y[-max(y.size // 20, 8) :]).max()), 0.02)
    low, high = ring.range(left)
    noisy = y + noise_of(draw, y, draw.uniform(35.0, 60.0))
    return StrangeRecord(shape, t, noisy, False, ring.frequency, ring.zeta, low, high)


def coulomb(draw: Draw) -> StrangeRecord:
    """Return a decay by dry friction, viscous damping beside it."""
    ring = Ring(draw.uniform(1.0, 20.0), draw.uniform(0.002, 0.01), draw.uniform(0.002, 0.01))
    return _changing('coulomb', ring, draw, draw.uniform(10.0, 40.0))


def quadratic(draw: Draw) -> StrangeRecord:
    """Return a decay whose damping ratio grows with the amplitude, as of a joint or air."""
    zeta = draw.uniform(0.003, 0.01)
    ring = Ring(draw.uniform(1.0, 20.0), zeta, 0.0, zeta * draw.uniform(0.3, 4.0))
    return _changing('quadratic', ring, draw, draw.uniform(15.0, 60.0))


def hardening(draw: Draw) -> StrangeRecord:
    """Return a decay of a spring that is not linear."""
    zeta = draw.uniform(0.003, 0.02)
    ring = Ring(draw.uniform(1.0, 20.0), zeta, 0.0, 0.0, draw.uniform(0.01, 0.1))
    made = _changing('hardening', ring, draw, draw.uniform(15.0, 60.0))
    # the frequency at the release
    return StrangeRecord(made.shape, made.t, made.y, False, ring.frequency, zeta, zeta, zeta)


def second_step(draw: Draw) -> StrangeRecord:
    """Return a decay that a later step to another level interrupts."""
    ring, t = steady_ring(draw)
    y = ring.values(t)
    at = int(draw.uniform(0.75, 0.97) * t.size)
    y[at:] = y[at:] + draw.uniform(0.4, 1.5) * (1.0 - ring.values(t[at:] - t[at]))
    noisy = y + noise_of(draw, y, draw.uniform(35.0, 60.0))
    return StrangeRecord(
        'second step', t, noisy, False, ring.frequency, ring.zeta, ring.zeta, ring.zeta
    )


def ramp_then_ring(draw: Draw) -> StrangeRecord:
    """Return a motion, the decay after it, and a rest."""
    ring, t = steady_ring(draw)
    before = np.linspace(0.0, 1.0, max(t.size // 6, 20))
    move = draw.uniform(1.0, 4.0) * (10.0 - 15.0 * before + 6.0 * before**2) * before**3
    step = float(t[1])
    y = np.concatenate([move, move[-1] + ring.values(t)])
    stamps: Array = step * np.arange(y.size, dtype=np.float64)
    noisy = y + noise_of(draw, y, draw.uniform(40.0, 60.0))
    return StrangeRecord(
        'ramp then ring', stamps, noisy, False, ring.frequency, ring.zeta, ring.zeta, ring.zeta
    )


def noise_alone(draw: Draw) -> StrangeRecord:
    """Return noise, white or filtered."""
    y = draw.standard_normal(2000)
    if draw.random() < 0.5:
        width = int(draw.integers(2, 20))
        y = np.convolve(y, np.hanning(width + 2), 'same')
    return StrangeRecord('noise', np.arange(2000) / 200.0, y, False)


def random_excitation(draw: Draw) -> StrangeRecord:
    """Return the vibration of a mode that noise drives."""
    ring, t = steady_ring(draw)
    step = float(t[1])
    kernel = ring.values(t)
    y = np.convolve(draw.standard_normal(t.size), kernel)[: t.size] * np.sqrt(step)
    values: Array = y.astype(np.float64)
    return StrangeRecord('random excitation', t, values, False)


CLEAN: tuple[Callable[[Draw], StrangeRecord], ...] = (
    free_decay, with_drift, coarse, clipped, two_modes, lossy,
)  # fmt: skip
STRANGE: tuple[Callable[[Draw], StrangeRecord], ...] = (
    driven_tone, clipped_tone, two_tones, coulomb, quadratic, hardening, second_step,
    ramp_then_ring, noise_alone, random_excitation,
)  # fmt: skip


def strange_record(seed: int) -> StrangeRecord:
    """Return the record of a seed: the kinds take turns."""
    kinds = (*CLEAN, *STRANGE)
    return kinds[seed % len(kinds)](np.random.default_rng([seed, 41]))
