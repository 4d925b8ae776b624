"""Number and poles of the damped cosines of a record: matrix pencil, residual search, BIC."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import hankel, svd

from denoc_ros.identification.damped import (
    Damped,
    columns,
    even_values,
    fit_damped,
    local_variance,
)
from denoc_ros.identification.records import Mask
from denoc_ros.types import Array

LONGEST = 600
MOST_COSINES = 12
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


def refined_cosines(search: Search, poles: Array) -> Damped:
    """Refine the fit from these poles: add components while the residual asks for them."""
    return _pruned(search, _grown(search, search.fit(poles)))


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
