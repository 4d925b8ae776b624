"""From the damped cosines of a fit to modes: merged pairs, lines, standard deviations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.optimize import least_squares

from denoc_ros.identification.decay.curves import (
    NORMAL_95,
    along,
    amplitude_curve,
    frequency_spread,
    window_interval,
    zeta_and_rate,
    zeta_deviation,
)
from denoc_ros.identification.decay.damped import (
    Damped,
    coloured,
    columns,
    fit_damped,
    local_variance,
)
from denoc_ros.identification.decay.modes import AmplitudeCurve, Line
from denoc_ros.types import Array

HIGHEST_HARMONIC = 5
MUCH_WEAKER = 0.1  # than the mode a suspect may be a harmonic of
NEAR_HARMONIC = 0.3  # of one over the record's duration, for a suspect
WEAKER = 0.3  # than each of its parents at the release
DEVIATIONS = 3.0
RESOLUTION = 0.1  # of one over the record's duration
WIDTH = 0.5  # of its decay rate, for a line beside a residual that is no white noise
FARTHEST = 0.03  # of the line's frequency, however uncertain it is
FEWEST_CYCLES = 2.0  # of a parent in the record: a slower one is hardly told from the drift
DECAY_MATCH = 0.3  # of the decay rate that the parents give
DEGREES = (2, 3, 4, 5, 6)
LATER = 0.5  # time constants
MOST_CYCLES = 1.5
SHORT = 0.15  # of the record: a time constant longer than that is seen for long enough
SURPRISING = 30.0  # squared deviations of two numbers; noise alone passes it once in 3e6
LARGE = 0.25  # of the decay rate
GONE = 0.3  # standard deviations of the noise: a component smaller than that is left out
FEWEST_SAMPLES = 16
HEAVY = 0.05  # damping ratio from which on neighbours are looked at
COMPARABLE_NEIGHBOUR = 0.1  # of its amplitude: smaller neighbours do not count
CYCLES = 0.75  # in the record: less is part of the drift
SEEN = 3.5  # time constants that a mode is seen for: 0.1 % of its energy is left
NEAR_CYCLES = 2.0  # over the time that both of two modes are seen for [Hz]: maybe they are one
DRIFT_LEAVES = 0.02  # of a group's energy
AS_LONG = 3.0  # times the time constant of what is no free decay
COMPARABLE = 0.05  # of the larger amplitude: a smaller one is no part of one mode
SMALLEST = 0.01  # of the largest: what a coloured residual lets pass for a mode


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
            near = abs(hertz[k] - n * hertz[i]) < min(NEAR_HARMONIC / span, FARTHEST * hertz[k])
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


def drifting_rss(t: Array, own: Array, pole: Array, value: complex) -> list[tuple[int, float]]:
    """Fit Re exp(p(t)), p a complex polynomial, and return (parameters, rss) per degree.

    A damping ratio that depends on amplitude bends the logarithm of the envelope, and a stiffness
    that does bends the phase: neither makes it beat, as two modes do.

    Parameters
    ----------
    t, own : ndarray, shape (k,)
        Times from the start [s]; the record without its other components.
    pole : ndarray, shape (2,)
        Decay rate [1/s] and damped angular frequency [rad/s] of the one steady mode nearest.
    value : complex
        Its amplitude at the start.
    """
    x = t / t[-1]
    start = np.array([np.log(value), (-pole[0] + 1j * pole[1]) * t[-1]])
    found = []
    for degree in DEGREES:
        start = np.append(start, np.zeros(degree + 1 - start.size))
        start = _fitted(x, own, start)
        rest = own - np.exp(_exponent(x, start)).real
        found.append((2 * (degree + 1), float(rest @ rest)))
    return found


def _exponent(x: Array, coefficients: np.ndarray[tuple[int], np.dtype[np.complex128]]) -> Array:
    exponent = np.polynomial.polynomial.polyval(x, coefficients)
    return np.asarray(np.minimum(exponent.real, 50.0) + 1j * exponent.imag)


def _fitted(
    x: Array, own: Array, start: np.ndarray[tuple[int], np.dtype[np.complex128]]
) -> np.ndarray[tuple[int], np.dtype[np.complex128]]:
    powers = x[:, None] ** np.arange(start.size)

    def residuals(flat: Array) -> Array:
        return np.asarray(np.exp(_exponent(x, flat.view(complex))).real - own)

    def slopes(flat: Array) -> Array:
        grown = np.exp(_exponent(x, flat.view(complex)))[:, None] * powers
        out = np.empty((x.size, flat.size))
        out[:, ::2], out[:, 1::2] = grown.real, -grown.imag
        return out

    found = least_squares(
        residuals, start.view(float), jac=slopes, method='lm', x_scale='jac', max_nfev=60
    )
    return np.asarray(found.x.view(complex))


def later_start_differs(t: Array, fit: Damped, span: float, k: int) -> str:
    """Return how a later start moves component k of a fit; '' where it finds the same mode.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times of the fitted samples from the start of the record [s].
    span : float
        Duration of the record [s].
    """
    sigma, omega = fit.poles[k]
    if sigma <= 0.0 or 1.0 / sigma > SHORT * span:
        return ''
    late = min(LATER / sigma, MOST_CYCLES * 2.0 * np.pi / omega)
    seen = t >= late
    if np.count_nonzero(seen) < FEWEST_SAMPLES + 4 * len(fit.poles):
        return ''
    left = np.abs(fit.complex_amplitudes) * np.exp(-fit.poles[:, 0] * late)
    kept = left > GONE * np.sqrt(fit.variance)
    kept[k] = True
    y = fit.prediction(t) + fit.residual
    again = fit_damped(t[seen] - late, y[seen], fit.poles[kept], span, rounds=12)
    return _difference(t[seen], fit.poles[k], again, int(np.count_nonzero(kept[:k])), late)


def _difference(t: Array, pole: Array, again: Damped, place: int, late: float) -> str:
    found = again.poles[place]
    change = found - pole
    block, span = slice(2 * place, 2 * place + 2), float(t[-1] - t[0])
    covariance = again.covariance()[block, block] * _excess(t - t[0], again, span, place) ** 2
    covariance += 1e-18 * np.eye(2) * float(pole @ pole)
    distance = float(change @ np.linalg.solve(covariance, change))
    if distance < SURPRISING or np.hypot(*change) < LARGE * pole[0]:
        return ''
    rate = float(np.hypot(*found))
    return (
        f'no free decay from the start of the window: {1e3 * late:.3g} ms later it is '
        f'{rate / (2.0 * np.pi):.4g} Hz with a damping ratio of {found[0] / rate:.3g}'
    )


def overlapping(poles: Array, size: Array, k: int) -> str:
    """Return which heavily damped neighbour component k overlaps with; '' where there is none.

    Parameters
    ----------
    poles : ndarray, shape (m, 2)
        Decay rates [1/s] and damped angular frequencies [rad/s].
    size : ndarray, shape (m,)
        Amplitudes at the start.
    """
    rate = np.hypot(*poles.T)
    heavy = poles[:, 0] > HEAVY * rate
    near = np.abs(rate - rate[k]) < poles[:, 0] + poles[k, 0]
    near &= heavy & (size > COMPARABLE_NEIGHBOUR * size[k])
    near[k] = False
    if not (heavy[k] and near.any()):
        return ''
    closest = int(np.argmin(np.where(near, np.abs(rate - rate[k]), np.inf)))
    return (
        f'overlaps with {rate[closest] / (2.0 * np.pi):.4g} Hz, which decays as fast: together '
        'they may be no free decay'
    )


@dataclass(frozen=True, eq=False)
class Component:
    """One mode, and its decay without the rest.

    `deviation` is the fit's standard deviation of zeta, `formal` and `windowed` are 95 %
    intervals, `bound` the Cramer-Rao bound relative to zeta, `share` the amplitude relative to
    the largest one's, `merged` how many cosines it took, `origin` of what it may be a harmonic,
    `no_decay` and `overlap` why it may be no free decay.
    """

    frequency: float
    zeta: float
    amplitude: float
    phase: float
    deviation: float
    formal: Array
    windowed: Array
    bound: float
    frequency_deviation: float
    snr_db: float
    share: float
    curve: AmplitudeCurve | None
    merged: int
    origin: str
    no_decay: str
    overlap: str

    @property
    def interval(self) -> Array:
        """Interval of the damping ratio, shape (2,): never narrower than that over windows."""
        return self.windowed if self.curve else self.formal


def components(t: Array, fit: Damped, span: float) -> tuple[list[Component], tuple[Line, ...]]:
    """Return the modes of a fit by rising frequency, and the components that are none.

    Parameters
    ----------
    t : ndarray, shape (k,)
        Times of the fitted samples from the start of the record [s].
    span : float
        Duration of the record [s].
    """
    lines = find_lines(fit, span)
    size = np.abs(fit.complex_amplitudes)
    smallest = SMALLEST * size.max(initial=0.0) if coloured(fit.residual) else 0.0
    kept = [
        k
        for k in range(len(fit.poles))
        if k not in lines and fit.poles[k, 1] * span > 2.0 * np.pi * CYCLES and size[k] > smallest
    ]
    origins = suspects(fit, span)
    kept.sort(key=lambda k: float(fit.poles[k, 1]))
    parts = [
        replace(
            _component(t, fit, group, span),
            origin=origins.get(group[0], ''),
            overlap=(overlapping(fit.poles, size, group[0]) if len(group) == 1 else '')
            or _not_told_apart(fit, group, kept),
        )
        for group in _groups(t, fit, kept, span)
    ]
    parts = _beside_no_decay(parts)
    parts.sort(key=lambda part: part.frequency)
    largest = max((part.amplitude for part in parts), default=1.0)
    parts = [replace(part, share=part.amplitude / largest) for part in parts]
    return parts, tuple(lines.values())


def _beside_no_decay(parts: list[Component]) -> list[Component]:
    """Doubt modes that decay about as fast as a component that is no free decay."""
    longest = max((_time_constant(part) for part in parts if part.no_decay), default=0.0)
    said = 'beside what is no free decay and lasts as long'
    return [
        replace(part, overlap=part.overlap or said)
        if _time_constant(part) < AS_LONG * longest
        else part
        for part in parts
    ]


def _time_constant(part: Component) -> float:
    rate = 2.0 * np.pi * part.frequency * part.zeta
    return 1.0 / rate if rate > 0.0 else np.inf


def _groups(t: Array, fit: Damped, kept: list[int], span: float) -> list[list[int]]:
    """Put together the cosines of one mode that drifts.

    Those that one over the duration does not tell apart are one; those that are hardly farther
    apart than the time they are seen for tells are one where one drifting mode explains them too.
    Where their widths overlap, no beat is seen before they have decayed, and only the shape of the
    envelope tells two steady modes from one that depends on its amplitude.
    """
    groups: list[list[int]] = []
    for k in kept:
        if groups and _apart(fit, groups[-1][-1], k) < 1.0 / span:
            groups[-1].append(k)
        else:
            groups.append([k])
    merged: list[list[int]] = []
    for chain in _chains(fit, groups, span):
        whole = sorted(k for group in chain for k in group)
        if len(chain) > 1 and _one_drifts(t, fit, whole, span):
            merged.append(whole)
            continue
        for close in _overlapping_groups(fit, chain):
            one = sorted(k for group in close for k in group)
            if len(close) > 1 and _one_drifts(t, fit, one, span):
                merged.append(one)
            else:
                merged += close
    return merged


def _overlap(fit: Damped, i: int, j: int) -> bool:
    """Say whether the widths of two cosines of comparable size overlap."""
    near = abs(fit.poles[i, 1] - fit.poles[j, 1]) < abs(fit.poles[i, 0]) + abs(fit.poles[j, 0])
    sizes = np.abs(fit.complex_amplitudes[[i, j]])
    return bool(near and sizes.min() > COMPARABLE * sizes.max())


def _overlapping_groups(fit: Damped, chain: list[list[int]]) -> list[list[list[int]]]:
    """Put the neighbours of a chain together whose widths overlap."""
    found: list[list[list[int]]] = []
    for group in chain:
        if found and any(_overlap(fit, i, j) for i in found[-1][-1] for j in group):
            found[-1].append(group)
        else:
            found.append([group])
    return found


def _not_told_apart(fit: Damped, group: list[int], kept: list[int]) -> str:
    """Return which other cosine's width one's overlaps with; '' where there is none."""
    own = group[int(np.argmax(np.abs(fit.complex_amplitudes[group])))]
    others = [k for k in kept if k not in group and _overlap(fit, own, k)]
    if not others:
        return ''
    nearest = min(others, key=lambda k: abs(float(fit.poles[k, 1] - fit.poles[own, 1])))
    return (
        f'overlaps with {float(np.hypot(*fit.poles[nearest])) / (2.0 * np.pi):.4g} Hz, and both '
        'decay before they beat: maybe one mode that depends on its amplitude'
    )


def _apart(fit: Damped, i: int, j: int) -> float:
    return float(abs(fit.poles[i, 1] - fit.poles[j, 1])) / (2.0 * np.pi)


def _chains(fit: Damped, groups: list[list[int]], span: float) -> list[list[list[int]]]:
    """Put neighbours together that the time they are seen for hardly tells apart."""
    chains: list[list[list[int]]] = []
    for group in groups:
        last = chains[-1][-1][-1] if chains else None
        if last is not None:
            fastest = max(fit.poles[last, 0], fit.poles[group[0], 0], 1e-12)
            seen = min(SEEN / fastest, span)
            if _apart(fit, last, group[0]) < NEAR_CYCLES / seen:
                chains[-1].append(group)
                continue
        chains.append([group])
    return chains


def _own(t: Array, fit: Damped, group: list[int], span: float) -> Array:
    """Return the record without its other components."""
    phi = columns(t, fit.poles[group], span)[:, :-2]
    chosen = [2 * k + part for k in group for part in (0, 1)]
    return np.asarray(fit.residual + phi @ fit.weights[chosen])


def _one_drifts(t: Array, fit: Damped, group: list[int], span: float) -> bool:
    """Say whether one drifting mode explains a group as well as its steady modes.

    By BIC; by what it leaves, where the residual is coloured, which no number of modes explains,
    or the widths of all overlap, so that the tail of the one is the head of the other.
    """
    own = _own(t, fit, group, span)
    index = group[int(np.argmax(np.abs(fit.complex_amplitudes[group])))]
    alone = fit_damped(t, own, fit.poles[[index]], span, base=False)
    count = t.size
    steady = count * np.log(fit.rss) + 4 * len(group) * np.log(count)
    drifts = drifting_rss(t, own, alone.poles[0], complex(alone.complex_amplitudes[0]))
    if any(count * np.log(rss) + n * np.log(count) < steady for n, rss in drifts):
        return True
    left = min(rss for _, rss in drifts) - fit.rss
    order = sorted(group, key=lambda k: float(fit.poles[k, 1]))
    overlap = all(_overlap(fit, i, j) for i, j in pairwise(order))
    return (overlap or coloured(fit.residual)) and left < DRIFT_LEAVES * float(own @ own)


def _component(t: Array, fit: Damped, group: list[int], span: float) -> Component:
    own = _own(t, fit, group, span)
    index = group[int(np.argmax(np.abs(fit.complex_amplitudes[group])))]
    alone, place = fit, index
    if len(group) > 1:
        alone, place = fit_damped(t, own, fit.poles[[index]], span, base=False), 0
    sigma, omega = alone.poles[place]
    zeta, rate = zeta_and_rate(sigma, omega)
    value = alone.complex_amplitudes[place]
    noise = float(np.sqrt(fit.variance))
    least = zeta_deviation(alone, place)
    excess = _excess(t, alone, span, place)
    deviation = least * excess
    half = NORMAL_95 * deviation
    curve = amplitude_curve(t, own, sigma, omega, noise)
    spread = frequency_spread(curve) if curve else 0.0
    return Component(
        frequency=rate / (2.0 * np.pi),
        zeta=zeta,
        amplitude=float(abs(value)),
        phase=float(np.angle(value)),
        deviation=deviation,
        formal=np.array([zeta - half, zeta + half]),
        windowed=window_interval(curve, zeta, deviation) if curve else np.full(2, np.nan),
        bound=least / abs(zeta) if zeta else np.inf,
        frequency_deviation=float(np.hypot(excess * _frequency_deviation(alone, place), spread)),
        snr_db=20.0 * float(np.log10(abs(value) / (noise * np.sqrt(2.0)))) if noise else np.inf,
        share=1.0,
        curve=curve,
        merged=len(group),
        origin='',
        no_decay='' if len(group) > 1 else later_start_differs(t, fit, span, index),
        overlap='',
    )


def _excess(t: Array, fit: Damped, span: float, k: int) -> float:
    """Return by how much a coloured residual near a mode exceeds white noise, 1 for white."""
    if not coloured(fit.residual) or fit.variance == 0.0:
        return 1.0
    local = local_variance(t, fit.residual, span, *fit.poles[k])
    return float(np.sqrt(max(local / fit.variance, 1.0)))


def _frequency_deviation(fit: Damped, k: int) -> float:
    slope = fit.poles[k] / np.hypot(*fit.poles[k]) / (2.0 * np.pi)
    return along(slope, fit.covariance(), k)
