"""Decays with known truth and a bag's defects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from denoc_ros.identification.damped import columns
from denoc_ros.identification.records import Record
from denoc_ros.types import Array


@dataclass(frozen=True)
class Truth:
    """One mode of a synthetic decay."""

    frequency: float  # undamped natural frequency [Hz]
    damping_ratio: float  # below 1
    # at the release [unit], [rad]
    amplitude: float = 1.0
    phase: float = 0.0

    @property
    def pole(self) -> tuple[float, float]:
        """Decay rate [1/s] and damped angular frequency [rad/s]."""
        omega = 2.0 * np.pi * self.frequency
        return self.damping_ratio * omega, omega * float(np.sqrt(1.0 - self.damping_ratio**2))


@dataclass(frozen=True)
class Defects:
    """Defects that a recording adds to a signal."""

    # 20 log10 of the largest value of the decay over the noise's standard deviation
    snr_db: float = 40.0
    # in parts of the largest value; the drift is that over the whole record
    offset: float = 0.0
    drift: float = 0.0
    # standard deviation of the stamps in parts of the sample time; the stamps say when
    jitter: float = 0.0
    lost: float = 0.0  # part of the samples that is missing
    lsb: float = 0.0  # resolution in parts of the largest value; 0: none
    clip: float = 0.0  # part of the largest value (either side of the offset) that is cut off


@dataclass(frozen=True, eq=False)
class Decay:
    """A synthetic record and its true parameters."""

    record: Record
    truth: tuple[Truth, ...]  # by rising frequency
    # (k,) Cramer-Rao bound of each damping ratio, relative to it: at the true poles and noise, at
    # the samples that are there and not clipped, offset and drift unknown
    bound: Array


def synthetic_decay(
    modes: Sequence[Truth],
    rate: float,
    duration: float,
    defects: Defects = Defects(),
    seed: int | np.random.Generator = 0,
) -> Decay:
    """Return a free decay with known modes, as a bag would hold it.

    Parameters
    ----------
    rate, duration : float
        [Hz], [s]; the record starts at the release.
    """
    draw = np.random.default_rng(seed)
    truth = tuple(sorted(modes, key=lambda mode: mode.frequency))
    t = _stamps(rate, duration, defects, draw)
    phi = columns(t, np.array([mode.pole for mode in truth]), duration)
    weights = np.array(
        [
            value
            for mode in truth
            for value in (
                mode.amplitude * np.cos(mode.phase),
                -mode.amplitude * np.sin(mode.phase),
            )
        ]
    )
    clean = phi[:, :-2] @ weights
    peak = float(np.abs(clean).max())
    noise = peak * 10.0 ** (-defects.snr_db / 20.0)
    y = clean + peak * (defects.offset + defects.drift * t / duration)
    y = y + noise * draw.standard_normal(t.size)
    if defects.lsb:
        lsb = peak * defects.lsb
        y = lsb * np.round(y / lsb)
    seen = np.ones(t.size, bool)
    if defects.clip:
        level = (1.0 - defects.clip) * peak
        low, high = peak * defects.offset - level, peak * defects.offset + level
        seen = (y > low) & (y < high)
        y = np.clip(y, low, high)
    bound = damping_bound(t[seen], truth, noise, duration)
    return Decay(Record(t, y, 'synthetic'), truth, bound)


def _stamps(rate: float, duration: float, defects: Defects, draw: np.random.Generator) -> Array:
    t = np.arange(int(duration * rate) + 1) / rate
    t = t + np.clip(defects.jitter * draw.standard_normal(t.size), -0.45, 0.45) / rate
    kept = draw.random(t.size) >= defects.lost
    return np.asarray(np.abs(t[kept]))


def damping_bound(t: Array, truth: Sequence[Truth], noise: float, span: float) -> Array:
    """Return the Cramer-Rao bounds of the damping ratios, relative to them, shape (k,).

    Parameters
    ----------
    t : ndarray
        Times from the release [s].
    noise : float
        Standard deviation of white Gaussian noise [unit].
    span : float
        What the drift is scaled by [s].
    """
    phi = columns(t, np.array([mode.pole for mode in truth]), span)
    slopes = []
    for k, mode in enumerate(truth):
        cosine, sine = phi[:, 2 * k], phi[:, 2 * k + 1]
        c, s = mode.amplitude * np.cos(mode.phase), mode.amplitude * np.sin(mode.phase)
        along, across = c * cosine - s * sine, c * sine + s * cosine
        omega = 2.0 * np.pi * mode.frequency
        zeta, damped = mode.damping_ratio, np.sqrt(1.0 - mode.damping_ratio**2)
        slopes += [
            omega * (-t * along + t * across * zeta / damped),
            -t * (zeta * along + damped * across),
        ]
    jacobian = np.column_stack((*slopes, phi))
    scale = np.linalg.norm(jacobian, axis=0)
    inverse = np.linalg.inv((jacobian / scale).T @ (jacobian / scale))
    deviation = noise * np.sqrt(np.diag(inverse)) / scale
    zetas = np.array([mode.damping_ratio for mode in truth])
    return np.asarray(deviation[: 2 * len(truth) : 2] / zetas)


Draw = np.random.Generator
Drawn = tuple[list[Truth], float, float]  # modes, sample rate [Hz], duration [s]


def _phase(draw: Draw) -> float:
    return float(draw.uniform(0.0, 2.0 * np.pi))


def _book_link(draw: Draw) -> Drawn:
    """The link of the book's sec. 8.2.2: zeta 0.198 and 0.0428."""
    second = Truth(47.7, 0.0428, draw.uniform(0.2, 1.0), _phase(draw))
    return [Truth(7.62, 0.198, 1.0, _phase(draw)), second], 1000.0, 2.0


def _two_links(draw: Draw) -> Drawn:
    """The tips of the book's sec. 8.4: 11.75 and 13.5 Hz."""
    first = Truth(11.75, draw.uniform(0.005, 0.05), 1.0, _phase(draw))
    second = Truth(13.5, draw.uniform(0.005, 0.05), draw.uniform(0.3, 1.0), _phase(draw))
    return [first, second], 500.0, 5.0


def _light(draw: Draw) -> Drawn:
    return [Truth(draw.uniform(2.0, 10.0), draw.uniform(0.001, 0.005), 1.0, _phase(draw))], 200, 20


def _close_pair(draw: Draw) -> Drawn:
    first = Truth(11.50, draw.uniform(0.001, 0.003), 1.0, _phase(draw))
    second = Truth(11.62, draw.uniform(0.001, 0.003), draw.uniform(0.5, 1.0), _phase(draw))
    return [first, second], 200.0, 20.0


def _joint_and_tip(draw: Draw) -> Drawn:
    """Joint and tip of the book's sec. 8.3: 1.1 and 20.5 Hz."""
    first = Truth(1.1, draw.uniform(0.01, 0.05), 1.0, _phase(draw))
    second = Truth(20.5, draw.uniform(0.005, 0.03), draw.uniform(0.1, 0.5), _phase(draw))
    return [first, second], 200.0, 10.0


def _four_modes(draw: Draw) -> Drawn:
    steps = ((2.0, 4.0), (5.0, 10.0), (8.0, 20.0), (10.0, 30.0))
    frequencies = np.cumsum([draw.uniform(*step) for step in steps])
    zetas = np.exp(draw.uniform(np.log(0.005), np.log(0.2), 4))
    modes = [
        Truth(float(f), float(zeta), draw.uniform(0.3, 1.0), _phase(draw))
        for f, zeta in zip(frequencies, zetas, strict=True)
    ]
    return modes, 500.0, 5.0


CASES: dict[str, Callable[[Draw], Drawn]] = {
    "the book's link": _book_link,
    '11.75 and 13.5 Hz': _two_links,
    'zeta 0.1 to 0.5 %': _light,
    '11.50 and 11.62 Hz': _close_pair,
    '1.1 and 20.5 Hz': _joint_and_tip,
    'four modes, 0.5 to 20 %': _four_modes,
}


def draw_decay(
    case: str, snr_db: tuple[float, float], clip: float, draw: np.random.Generator
) -> Decay:
    """Return a decay of a case with a bag's defects.

    Offset up to half, drift up to a tenth of the largest value, 10 % jitter, 5 % of the samples
    lost, a resolution of a quarter to one and a half of the noise.

    Parameters
    ----------
    snr_db : (float, float)
        Range that the release's ratio of largest value to noise is drawn from.
    clip : float
        Part of the largest value that is cut off.
    """
    modes, rate, duration = CASES[case](draw)
    snr = float(draw.uniform(*snr_db))
    defects = Defects(
        snr_db=snr,
        offset=draw.uniform(-0.5, 0.5),
        drift=draw.uniform(-0.1, 0.1),
        jitter=0.1,
        lost=0.05,
        lsb=10.0 ** (-snr / 20.0) * draw.uniform(0.25, 1.5),
        clip=clip,
    )
    return synthetic_decay(modes, rate, duration, defects, draw)
