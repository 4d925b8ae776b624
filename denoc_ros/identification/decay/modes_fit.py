"""Modes of a free decay: number, frequencies, damping ratios, and their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.linalg import hankel, svd

from denoc_ros.errors import IdentificationError
from denoc_ros.identification.decay.components import Component, components
from denoc_ros.identification.decay.curves import NORMAL_95
from denoc_ros.identification.decay.damped import (
    Damped,
    coloured,
    columns,
    even_values,
    fit_damped,
    local_variance,
)
from denoc_ros.identification.decay.modes import DOUBTFUL, GOOD, NOT_IDENTIFIABLE, Modes
from denoc_ros.identification.decay.record_segments import release_time
from denoc_ros.identification.decay.records import Mask, Quality, Record, assess, sample_noise
from denoc_ros.types import Array

WIDEST = 0.05  # relative standard deviation of zeta of a good mode
USELESS = 0.35  # relative standard deviation that says nothing
FEWEST_CYCLES = 1.5
HEAVIEST = 0.3  # damping ratio with which the amplitude falls to 5 % in one and a half cycles
MOST_CLIPPED = 0.4
FEWEST_FOLDS = 0.25  # e-folds of amplitude that a decay must fall by in its window
WEAK = 0.1  # of the strongest, for a mode beside a coloured residual
NEAR_NYQUIST = 0.8  # of half the sample rate
CLIP_MARGIN = 3.0  # standard deviations of the noise below the limit
SMEARED = 0.4  # of the resolution: noise from which on levels are as good as none
MOST_EXTREMES = 0.1  # of the samples: more at one value are no crest
MOST_COSINES = 12
TOO_MANY = f'{MOST_COSINES} or more components: the record is not a free decay'
NOT_WHITE = 'the residual is not white noise: the modes do not explain the record'


def judge(
    part: Component, record: Record, quality: Quality, coloured: bool, left_out: float
) -> tuple[str, tuple[str, ...]]:
    """Return the verdict on a mode and the reasons.

    Parameters
    ----------
    left_out : float
        Share of the samples that the fit did not use.
    """
    doubts = _doubts(part, record, quality, coloured, left_out)
    if part.zeta <= 0.0:
        return NOT_IDENTIFIABLE, (f'does not decay: damping ratio {part.zeta:.3g}', *doubts)
    if part.no_decay:
        return NOT_IDENTIFIABLE, (part.no_decay, *doubts)
    relative = max(part.deviation, _half_width(part) / NORMAL_95) / part.zeta
    spread = f'standard deviation of the damping ratio is {100.0 * relative:.1f} % of it'
    if relative > USELESS:
        return NOT_IDENTIFIABLE, (spread, *doubts)
    if relative > WIDEST:
        return DOUBTFUL, (f'{spread}, more than {100.0 * WIDEST:.0f} %', *doubts)
    return (DOUBTFUL, tuple(doubts)) if doubts else (GOOD, ())


def _half_width(part: Component) -> float:
    low, high = part.interval
    return float(0.5 * (high - low)) if np.isfinite(high - low) else 0.0


def _doubts(
    part: Component, record: Record, quality: Quality, coloured: bool, left_out: float
) -> list[str]:
    reasons = []
    folds = 2.0 * np.pi * part.frequency * part.zeta * record.duration
    if 0.0 < folds < FEWEST_FOLDS:
        reasons.append(
            f'falls by {-100.0 * np.expm1(-folds):.2g} % in the window: a driven vibration whose '
            f'strength drifts looks the same; give a window in which it falls by '
            f'{-100.0 * np.expm1(-FEWEST_FOLDS):.0f} % or more'
        )
    if coloured and part.share < WEAK:
        reasons.append(
            f'{100.0 * part.share:.1f} % of a stronger mode that the model does not explain down '
            'to the noise'
        )
    if part.origin:
        reasons.append(f'may be a harmonic: {part.origin}')
    if part.overlap:
        reasons.append(part.overlap)
    if part.zeta > HEAVIEST:
        reasons.append(f'falls to 5 % in less than 1.5 cycles: a damping ratio above {HEAVIEST}')
    if part.merged > 1:
        reasons.append(
            f'{part.merged} components closer than one over the duration '
            f'({1.0 / record.duration:.3g} Hz) taken as one mode: amplitude dependent'
        )
    curve = part.curve
    if curve is not None and curve.dependent:
        grows = 'grows' if curve.trend > 0.0 else 'falls'
        reasons.append(
            f'amplitude dependent: the damping ratio {grows} with amplitude, '
            f'{curve.damping_ratio.min():.3g} to {curve.damping_ratio.max():.3g} over '
            f'{curve.time.size} windows'
        )
    cycles = part.frequency * record.duration
    if cycles < FEWEST_CYCLES:
        reasons.append(f'{cycles:.2g} cycles in the record, less than {FEWEST_CYCLES}')
    if part.frequency > NEAR_NYQUIST * 0.5 * quality.rate:
        reasons.append(f'close to half the sample rate ({0.5 * quality.rate:.4g} Hz)')
    if left_out > MOST_CLIPPED:
        reasons.append(f'{100.0 * left_out:.0f} % of the samples are left out as clipped')
    return reasons


def identify_modes(t: ArrayLike, y: ArrayLike) -> Modes:
    """Identify the modes of a free decay.

    The number of modes is found, not asked for. Offset and drift of the signal, uneven and
    missing stamps and clipped samples are taken as they are.

    Parameters
    ----------
    t : array_like, shape (k,)
        Stamps [s], increasing; the decay is free from the first one on, or from the end of a rest
        that the record starts with.
    y : array_like, shape (k,)
        Measured values.

    Returns
    -------
    Modes
        By rising frequency; none of them where nothing but noise was found.

    Raises
    ------
    IdentificationError
        The record is no record: see Record.

    Notes
    -----
    A matrix pencil and the residual's spectrum give first poles; damped cosines, an offset and a
    drift are fitted to the samples by nonlinear least squares; their number is the one of the
    least Bayesian information criterion.
    """
    return fit_modes(Record(np.asarray(t, float), np.asarray(y, float)))


def fit_modes(record: Record) -> Modes:
    """Identify the modes of a record of a free decay: see identify_modes.

    Raises
    ------
    IdentificationError
        Fewer than 8 samples are left beside the clipped ones.
    """
    release = release_time(record)
    late = release - float(record.t[0])
    record = record.part(release, float(record.t[-1]))
    quality = assess(record)
    seen, fit = _fit(record, quality)
    t = record.t - record.t[0]
    parts, lines = components(t[seen], fit, record.duration)
    growing = [part for part in parts if part.zeta < -NORMAL_95 * part.deviation]
    parts = [part for part in parts if part not in growing]
    is_coloured, left_out = coloured(fit.residual), float(np.mean(~seen))
    verdicts = [judge(part, record, quality, is_coloured, left_out) for part in parts]
    base = fit.weights[-2:]
    return Modes(
        frequency=_column(parts, 'frequency'),
        damping_ratio=_column(parts, 'zeta'),
        amplitude=_column(parts, 'amplitude'),
        phase=_column(parts, 'phase'),
        interval=_column(parts, 'interval').reshape(-1, 2),
        formal_interval=_column(parts, 'formal').reshape(-1, 2),
        window_interval=_column(parts, 'windowed').reshape(-1, 2),
        bound=_column(parts, 'bound'),
        frequency_deviation=_column(parts, 'frequency_deviation'),
        snr_db=_column(parts, 'snr_db'),
        verdict=tuple(word for word, _ in verdicts),
        reasons=tuple(reasons for _, reasons in verdicts),
        curves=tuple(part.curve for part in parts),
        lines=lines,
        offset=float(base[0]),
        drift=float(base[1] / record.duration),
        noise=float(np.sqrt(fit.variance)),
        start=float(record.t[0]),
        stop=float(record.t[-1]),
        remarks=_remarks(late, quality, seen, parts, growing, fit),
    )


def _fit(record: Record, quality: Quality) -> tuple[Mask, Damped]:
    """Return which samples were used and the fit to them.

    Samples that share the largest or the smallest value wait outside until a fit to the others
    says whether they belong beyond it.
    """
    t = record.t - record.t[0]
    outside = quality.clipped | _repeated_extremes(record.y)
    levels = _level_limit(record, quality)
    fit = search_cosines(_search(record, t, ~outside, levels))
    if not outside.any():
        return ~outside, fit
    seen = np.ones(t.size, bool)
    if quality.clipped.any() or _beyond(record, outside, t, fit):
        seen = _inside_limits(record, ~outside, t, fit)
    search = _search(record, t, seen, levels)
    return seen, _pruned(search, _grown(search, search.fit(fit.poles)))


def _repeated_extremes(y: Array) -> Mask:
    outside = np.zeros(y.size, bool)
    for extreme in (y.min(), y.max()):
        same = y == extreme
        if 2 <= np.count_nonzero(same) < MOST_EXTREMES * y.size:
            outside |= same
    return outside


def _beyond(record: Record, outside: Mask, t: Array, fit: Damped) -> bool:
    """Say whether a fit to the other samples puts these beyond the limits."""
    middle = 0.5 * (record.y.max() + record.y.min())
    y = record.y[outside]
    further = (fit.prediction(t[outside]) - y) * np.sign(y - middle)
    return any(
        further[side].size > 0 and further[side].mean() > CLIP_MARGIN * np.sqrt(fit.variance)
        for side in (y > middle, y < middle)
    )


def _level_limit(record: Record, quality: Quality) -> float:
    """Return the amplitude that levels without noise to smear them do not show."""
    smeared = sample_noise(record.y) > SMEARED * quality.resolution
    return 0.0 if smeared else 0.5 * quality.resolution


def _search(record: Record, t: Array, seen: Mask, smallest: float) -> Search:
    if np.count_nonzero(seen) < 8:
        raise IdentificationError(
            f'{record.name}: at least 8 samples must lie within the range of the sensor, got '
            f'{np.count_nonzero(seen)} of {t.size}'
        )
    return Search(t[seen], record.y[seen], record.duration, smallest)


def _inside_limits(record: Record, seen: Mask, t: Array, fit: Damped) -> Mask:
    """Leave out samples that noise alone could have clipped: the rest would be biased inwards."""
    margin = CLIP_MARGIN * np.sqrt(fit.variance)
    expected = fit.prediction(t)
    low, high = record.y.min() + margin, record.y.max() - margin
    return np.asarray(seen & (expected > low) & (expected < high))


def _column(parts: list[Component], name: str) -> Array:
    return np.array([getattr(part, name) for part in parts], float)


def _remarks(
    late: float,
    quality: Quality,
    seen: Mask,
    parts: list[Component],
    growing: list[Component],
    fit: Damped,
) -> tuple[str, ...]:
    remarks = []
    if late:
        remarks.append(f'starts with a rest: fitted from {late:.3g} s after its start on')
    if len(fit.poles) >= MOST_COSINES:
        remarks.append(TOO_MANY)
    if not parts:
        remarks.append('no mode is above the noise')
    remarks += [
        f'the vibration at {part.frequency:.4g} Hz grows: no free decay' for part in growing
    ]
    if coloured(fit.residual):
        remarks.append(NOT_WHITE)
    if not seen.all():
        remarks.append(f'{np.count_nonzero(~seen)} clipped samples left out')
    if quality.gaps:
        remarks.append(f'{quality.gaps} gaps, the longest {quality.longest_gap:.3g} s')
    return tuple(remarks)


# the number of modes -----------------------------------------------------------------------------

LONGEST = 600
COST = 5.0  # of one damped cosine, in log(samples): four parameters and the search for them
DYNAMIC_RANGE = 1e-5  # no component is looked for below this part of the largest value
HIGHEST = 0.95  # of half the sample rate
CONVERGED = 1e-8  # of the frequency: fits whose poles are that close are one
MOST_TRIED = 2  # candidates, one after the other
SLOWEST = 0.6  # cycles in the record: less is part of the drift
DECAYS_PER_OCTAVE = 1.0
FEWEST_SAMPLES = 3.5  # that carry a component: fewer are a spike
LARGEST = 20.0  # component at the start, in ranges of the record: more is extrapolated


def even_samples(t: Array, y: Array, step: float, count: int) -> Array:
    """Return y at t[0] + k step, k < count (cubic between the samples)."""
    grid = t[0] + step * np.arange(count)
    return np.asarray(CubicSpline(t, y)(np.minimum(grid, t[-1])))


def matrix_pencil(y: Array, step: float, order: int) -> Array:
    """Return poles of a decay (sigma [1/s], damped w [rad/s]), shape (m, 2), w > 0.

    Parameters
    ----------
    y : ndarray, shape (k,)
        Evenly spaced samples without their mean.
    step : float
        Between the samples [s].
    order : int
        Number of exponentials kept: twice that of the cosines, and what offset and drift take.

    Notes
    -----
    The eigenvalues of the pencil of the signal subspace of the samples' Hankel matrix and the same
    subspace one sample on are exp(s step) (Hua and Sarkar, IEEE Trans. ASSP 38, 1990).
    """
    rows = y.size // 2
    trajectory = hankel(y[:rows], y[rows - 1 :])
    subspace = svd(trajectory, full_matrices=False)[0][:, :order]
    steps = np.linalg.eigvals(np.linalg.pinv(subspace[:-1]) @ subspace[1:])
    s = np.log(np.where(np.abs(steps) < 1e-12, 1e-12, steps)) / step
    upper = s[s.imag > 0.0]
    return np.column_stack((-upper.real, upper.imag))


def pencil_poles(t: Array, y: Array, highest: float, cosines: int) -> Array:
    """Return poles of up to `cosines` damped cosines below `highest` [Hz], shape (m, 2).

    Long records are taken at the lowest rate that holds `highest`, and where that is not short
    enough from their beginning only.
    """
    span = float(t[-1] - t[0])
    step = max(span / (t.size - 1), 1.0 / (2.6 * highest))
    count = int(min(span / step, LONGEST)) + 1
    values = even_samples(t, y, step, count)
    return matrix_pencil(values - values.mean(), step, min(2 * cosines + 2, count // 3))


@dataclass(frozen=True, eq=False)
class Search:
    """Samples to be searched."""

    # (k,) times from the start of the record [s], values
    t: Array
    y: Array
    span: float  # duration of the record [s]
    smallest: float = 0.0  # amplitude below which a component is not looked for

    @property
    def highest(self) -> float:
        """Highest frequency looked for [Hz]."""
        return float(HIGHEST * 0.5 / np.median(np.diff(self.t)))

    @property
    def floor(self) -> float:
        """Sum of squares that counts as exact."""
        peak = float(np.ptp(self.y)) or 1.0
        return self.t.size * (DYNAMIC_RANGE * peak) ** 2

    def criterion(self, fit: Damped) -> float:
        """Bayesian information criterion of a fit (less is better)."""
        k = self.t.size
        cost = COST * len(fit.poles) * np.log(k)
        return float(k * np.log((fit.rss + self.floor) / k) + cost)

    def fit(self, poles: Array) -> Damped:
        """Fit from these poles and keep those that are damped cosines."""
        fit = fit_damped(self.t, self.y, poles, self.span)
        sound = self.sound(fit.poles)
        if sound.all():
            return fit
        return self.fit(fit.poles[sound])

    def sound(self, poles: Array) -> Mask:
        """Select the poles of cosines that the record can show, shape (m,)."""
        sigma, omega = poles[:, 0], poles[:, 1]
        return np.asarray(
            (omega > 0.2 / self.span)
            & (omega < 2.0 * np.pi * self.highest / HIGHEST)
            & (sigma > -3.0 / self.span)
            & (sigma < 20.0 * omega)
        )


def search_cosines(search: Search) -> Damped:
    """Return the fit with the damped cosines that the record holds."""
    nothing, start = _starts(search)
    first, second = _grown(search, nothing), _pruned(search, start)
    if not _same(first, second):  # what grew no further from these poles will not do so again
        second = _grown(search, second)
    return _pruned(search, min(first, second, key=search.criterion))


def _same(one: Damped, other: Damped) -> bool:
    """Say whether two fits have the same poles, but for the end of their iterations."""
    if len(one.poles) != len(other.poles):
        return False
    first, second = (fit.poles[np.argsort(fit.poles[:, 1])] for fit in (one, other))
    return bool(np.all(np.abs(first - second) < CONVERGED * np.abs(second[:, 1:])))


def _starts(search: Search) -> tuple[Damped, Damped]:
    nothing = fit_damped(search.t, search.y, np.empty((0, 2)), search.span)
    spectrum = np.abs(np.fft.rfft(even_values(search.t, nothing.residual, search.span)))
    power = np.cumsum(spectrum**2)
    top = int(np.searchsorted(power, 0.995 * power[-1])) + 1
    highest = min(search.highest, 1.5 * top / search.span)
    poles = pencil_poles(search.t, nothing.residual, highest, 6)
    poles = poles[search.sound(poles)]
    start = search.fit(poles[np.argsort(poles[:, 0])][:6]) if len(poles) else nothing
    return nothing, start


def _grown(search: Search, fit: Damped) -> Damped:
    """Add components of the residual while they pay."""
    while len(fit.poles) < MOST_COSINES:
        for pole in _strongest(search, fit.residual):
            larger = search.fit(np.vstack((fit.poles, pole)))
            if _pays(search, fit, larger):
                fit = larger
                break
        else:
            return fit
    return fit


def _pays(search: Search, fit: Damped, larger: Damped) -> bool:
    return (
        search.criterion(larger) < search.criterion(fit)
        and bool(_lasting(search, larger).all())
        and _stands_out(search, fit, larger)
    )


def _stands_out(search: Search, fit: Damped, larger: Damped) -> bool:
    """Say whether an added component exceeds the local residual, not only its mean."""
    gain = fit.rss - larger.rss
    local = local_variance(search.t, larger.residual, search.span, *larger.poles[-1])
    k = search.t.size
    return bool(gain > COST * np.log(k) * max(local, search.floor / k))


def _lasting(search: Search, fit: Damped) -> Mask:
    """Say which components are more than a few samples, and neither too small nor too large."""
    phi = columns(search.t, fit.poles, search.span)[:, :-2] * fit.weights[:-2]
    values = phi[:, ::2] + phi[:, 1::2]
    power = np.maximum(np.sum(values**2, axis=0), 1e-300)
    samples = power**2 / np.maximum(np.sum(values**4, axis=0), 1e-300)
    size = np.abs(fit.complex_amplitudes)
    sized = (size > search.smallest) & (size < LARGEST * np.ptp(search.y))
    return np.asarray((samples > FEWEST_SAMPLES) & sized)


def _strongest(search: Search, residual: Array) -> list[Array]:
    """Return poles whose damped cosines explain most of the residual, apart from each other."""
    even = even_values(search.t, residual, search.span)
    count = even.size
    step = search.span / (count - 1)
    size = 1 << int(np.ceil(np.log2(2 * count)))
    frequency = np.fft.rfftfreq(size, step)
    allowed = (frequency > SLOWEST / search.span) & (frequency < search.highest)
    octaves = np.log2(search.highest * search.span) * DECAYS_PER_OCTAVE
    rates = np.append(0.0, np.geomspace(0.3 / search.span, search.highest, int(octaves) + 2))
    peaks = []
    for sigma in rates:
        decay = np.exp(-sigma * step * np.arange(count))
        power = np.abs(np.fft.rfft(even * decay, size)) ** 2 / (decay @ decay)
        power[~allowed] = 0.0
        k = int(np.argmax(power))
        peaks.append((float(power[k]), np.array([sigma, 2.0 * np.pi * frequency[k]])))
    apart: list[Array] = []
    for _, pole in sorted(peaks, key=lambda peak: -peak[0]):
        if all(abs(pole[1] - other[1]) > 4.0 * np.pi / search.span for other in apart):
            apart.append(pole)
    return apart[:MOST_TRIED]


def _pruned(search: Search, fit: Damped) -> Damped:
    """Remove components that do not decay or do not pay, the weakest first."""
    while not (lasting := _lasting(search, fit)).all():
        fit = search.fit(fit.poles[lasting])
    while len(fit.poles):
        power = np.abs(fit.complex_amplitudes) ** 2 / np.maximum(
            fit.poles[:, 0], 1.0 / search.span
        )
        smaller = search.fit(np.delete(fit.poles, int(np.argmin(power)), axis=0))
        if search.criterion(smaller) >= search.criterion(fit):
            return fit
        fit = smaller
    return fit
