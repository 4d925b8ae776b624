"""A record of a free decay from end to end: window, modes, and other methods beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from denoc_ros.errors import IdentificationError
from denoc_ros.identification.decay.components import COMPARABLE_NEIGHBOUR, HEAVY
from denoc_ros.identification.decay.decrement import Convention, Decrement, log_decrement
from denoc_ros.identification.decay.modes import (
    DOUBTFUL,
    GOOD,
    NOT_IDENTIFIABLE,
    Modes,
    strongest,
)
from denoc_ros.identification.decay.modes_fit import (
    FEWEST_FOLDS,
    NOT_WHITE,
    TOO_MANY,
    fit_modes,
)
from denoc_ros.identification.decay.record_segments import (
    Span,
    decay_window,
    moving_until,
    release_time,
)
from denoc_ros.identification.decay.records import Quality, Record, assess, doubtful_rate
from denoc_ros.identification.decay.spectra import Method, SpectralDecay, evolving_spectra
from denoc_ros.types import Array

CONVENTIONS: tuple[Convention, ...] = ('exact', 'book')
CLEAR = 5.0  # standard deviations of the noise: lower crests are not counted
HELD_OUT = 0.3  # of a decay: predicted from the rest
TIME_CONSTANTS = 2.0  # after which what a motion's end left is gone
LATEST = 0.5  # of a window: it is not begun anew later than that
LONG = 100_000  # samples: of a longer record a part is looked at first
FIRST_LOOK = 10_000  # samples of that part
MISSED = 0.5  # of the power of that part: a fit that misses more explains nothing
PER_CYCLE = 5.0  # samples of that part in a cycle of the fastest motion that is strong
MOST_POWER = 0.995  # of a record: the motions that hold it are strong


@dataclass(frozen=True)
class Check:
    """Estimate of a mode's frequency and damping by another method."""

    method: str
    # None where it does not apply
    frequency_hz: float | None
    damping_ratio: float | None
    reason: str  # why it does not apply, or why it differs; '' where it agrees


@dataclass(frozen=True, eq=False)
class DecayAnalysis:
    """All that was found in a record of a free decay."""

    record: Record  # the part that was fitted
    # who chose it: `given`, `found`, `found where the joints stand` or `whole record`
    window_by: str
    quality: Quality  # of that part
    modes: Modes
    spectra: tuple[SpectralDecay, ...]  # evolving spectra of the modes, one each
    checks: tuple[tuple[Check, ...], ...]  # other methods, one tuple per mode


def analyse_decay(
    record: Record, given: bool = False, standing: Sequence[Span] = (), doubt: str = ''
) -> DecayAnalysis:
    """Return the modes of a free decay, and the results of other methods for them.

    Parameters
    ----------
    given : bool
        Whether the record is the decay; else the longest free decay in it is looked for.
    standing : sequence of (float, float)
        From when to when the joints stand [s], where that is known: the decay is looked for
        there, and a given window that they move in is doubted.
    doubt : str
        Why no mode is good, whatever the fit says; '' where nothing speaks against the record.
    """
    if given:
        window_by = 'given'
    else:
        record, window_by = decay_window(record, standing)
    short = _no_free_decay(record)
    if short is not None:
        record, modes = short
    else:
        modes = fit_modes(record)
    if not given and (later := _after_motion(record, modes)) is not None:
        record, modes = later
    if moves := moving_until(record, standing):
        modes = _doubted(modes, f'joints move until {moves:.4g} s, in the window')
    for reason in filter(None, (doubt, doubtful_rate(record))):
        modes = _doubted(modes, reason)
    spectra = _spectra(record, modes, 'weighted')
    checks = tuple(
        (
            _spectral_check('evolving spectra', spectra[k], modes, k),
            *(_decrement_check(record, modes, k, convention) for convention in CONVENTIONS),
        )
        for k in range(len(modes.frequency))
    )
    return DecayAnalysis(record, window_by, assess(record), modes, spectra, checks)


def _no_free_decay(record: Record) -> tuple[Record, Modes] | None:
    """Return the first part of a long record that is no free decay, and its modes; else None.

    A fit of many components to all samples takes minutes. A record whose first part damped cosines
    do not explain is no free decay where its power does not fall, or where they miss most of it.
    """
    if record.t.size <= LONG:
        return None
    free = record.part(release_time(record), float(record.t[-1]))
    first, falls = _first_part(free), _falls(free)
    modes = fit_modes(first)
    if not {NOT_WHITE, TOO_MANY} & {*modes.remarks}:
        return None
    if falls and modes.noise**2 < MISSED * float(np.var(first.y)):
        return None
    why = 'damped cosines miss most of its beginning' if falls else 'its power does not fall'
    share = 100.0 * first.duration / record.duration
    return first, replace(
        modes,
        verdict=(NOT_IDENTIFIABLE,) * len(modes.verdict),
        remarks=(*modes.remarks, f'no free decay: {why}; the first {share:.2g} % are fitted'),
    )


def _falls(record: Record) -> bool:
    """Say whether a record or its speed falls as a mode does that falls enough in its window.

    A drift hides the decay in the record, and noise hides it in the speed.
    """
    x = (record.t - record.t.mean()) / record.duration
    rest = record.y - record.y.mean()
    rest = rest - x * float(x @ rest / (x @ x))
    quarter = record.t.size // 4
    least = np.exp(-2.0 * FEWEST_FOLDS * 0.75)  # from the middle of one quarter to the other
    return any(
        np.mean(one[-quarter:] ** 2) < least * np.mean(one[:quarter] ** 2)
        for one in (rest, np.diff(rest))
    )


def _first_part(record: Record) -> Record:
    """Return the first samples of a record, means of several where all its motion is slow."""
    power = np.cumsum(np.abs(np.fft.rfft(np.diff(record.y))) ** 2)
    lines = int(np.searchsorted(power, MOST_POWER * power[-1])) + 1  # cycles in the record
    size = max(int(record.t.size / (PER_CYCLE * max(lines, FIRST_LOOK / PER_CYCLE))), 1)
    count = min(record.t.size // size, FIRST_LOOK)
    t, y = (each[: count * size].reshape(-1, size).mean(axis=1) for each in (record.t, record.y))
    return Record(t, y, record.name, record.unit)


def _after_motion(record: Record, modes: Modes) -> tuple[Record, Modes] | None:
    """Return a record that begins later, and its modes; None where its start is free decay.

    The end of a motion at the start of a window is fitted by heavily damped cosines, which bend
    the mode that goes on. None of them is good; without them that mode is.
    """
    if len(modes.frequency) < 2:
        return None
    k = strongest(modes.frequency, modes.energy)[0]
    heavy = (modes.damping_ratio > HEAVY) & (
        modes.amplitude > COMPARABLE_NEIGHBOUR * modes.amplitude[k]
    )
    if modes.verdict[k] != GOOD or modes.damping_ratio[k] > HEAVY or not heavy.any():
        return None
    rates = 2.0 * np.pi * modes.frequency[heavy] * modes.damping_ratio[heavy]
    late = TIME_CONSTANTS / float(rates.min())
    if any(modes.verdict[j] == GOOD for j in np.flatnonzero(heavy)) or late > LATEST * (
        record.duration
    ):
        return None
    later = record.part(float(record.t[0]) + late, float(record.t[-1]))
    try:
        return later, fit_modes(later)
    except IdentificationError:
        return None


def held_out(record: Record) -> tuple[Modes, float] | None:
    """Return modes of the first part of a decay and where it ends [s]; None of a short record.

    What they predict of the rest was not seen by the fit.
    """
    split = float(record.t[0]) + (1.0 - HELD_OUT) * record.duration
    try:
        return fit_modes(record.part(float(record.t[0]), split)), split
    except IdentificationError:
        return None


def own_decay(analysis: DecayAnalysis, k: int) -> Array:
    """Return the record without offset, drift and all modes but one, (samples,)."""
    t, modes = analysis.record.t, analysis.modes
    return np.asarray(analysis.record.y - modes.prediction(t) + modes.component(k, t))


def residual_spectrum(analysis: DecayAnalysis) -> tuple[Array, Array, Array]:
    """Return frequencies [Hz], amplitudes of the record and of the residual [unit], each (m,)."""
    record, modes = analysis.record, analysis.modes
    grid = np.linspace(record.t[0], record.t[-1], record.t.size)
    residual = record.y - modes.prediction(record.t)
    base = modes.offset + modes.drift * (record.t - modes.start)
    window = np.hanning(grid.size)
    scale = 2.0 / window.sum()
    amplitudes = [
        scale * np.abs(np.fft.rfft(window * np.interp(grid, record.t, values)))
        for values in (record.y - base, residual)
    ]
    frequency = np.fft.rfftfreq(grid.size, grid[1] - grid[0])
    return frequency, amplitudes[0], amplitudes[1]


def _doubted(modes: Modes, reason: str) -> Modes:
    """Return modes of which none is good any more, for a reason."""
    return replace(
        modes,
        verdict=tuple(DOUBTFUL if word == GOOD else word for word in modes.verdict),
        reasons=tuple((*reasons, reason) for reasons in modes.reasons),
    )


def _spectra(record: Record, modes: Modes, method: Method) -> tuple[SpectralDecay, ...]:
    if not len(modes.frequency):
        return ()
    damped = modes.frequency * np.sqrt(np.maximum(1.0 - modes.damping_ratio**2, 0.01))
    order = np.argsort(damped)
    found = evolving_spectra(record, damped, method=method)
    return tuple(found[k] for k in np.argsort(order))


def _spectral_check(method: str, found: SpectralDecay, modes: Modes, k: int) -> Check:
    if found.reasons:
        return Check(method, None, None, f'does not hold: {"; ".join(found.reasons)}')
    low, high = modes.interval[k]
    reason = ''
    if found.interval[1] < low or found.interval[0] > high:
        reason = 'its interval and that of the fit do not overlap'
        curve = modes.curves[k]
        if curve is not None and curve.dependent:
            reason += ': they weigh large and small amplitudes differently'
    return Check(method, found.frequency, found.damping_ratio, reason)


def _decrement_check(record: Record, modes: Modes, k: int, convention: Convention) -> Check:
    """Return the log decrement of one mode's decay without the others, while it is clear."""
    others = modes.prediction(record.t) - modes.component(k, record.t)
    own = Record(record.t, record.y - others, record.name, record.unit)
    method = f'log decrement ({convention})'
    rate = 2.0 * np.pi * modes.frequency[k] * modes.damping_ratio[k]
    above = np.log(max(modes.amplitude[k] / (CLEAR * modes.noise), 1.0)) if modes.noise else np.inf
    stop = modes.start + above / rate if rate > 0.0 else modes.stop
    damped = modes.frequency[k] * np.sqrt(max(1.0 - modes.damping_ratio[k] ** 2, 0.01))
    try:
        found = log_decrement(own.part(modes.start, stop), convention, damped)
    except IdentificationError as error:
        return Check(method, None, None, str(error).removeprefix(f'{record.name}: '))
    reason = _difference(modes, k, found)
    return Check(method, float(found.frequency), float(found.damping_ratio), reason)


def _difference(modes: Modes, k: int, found: Decrement) -> str:
    """Return why a log decrement is outside the interval of a mode; '' where it is not."""
    low, high = modes.interval[k]
    if low <= found.damping_ratio <= high:
        return ''
    if found.interval[0] <= high and found.interval[1] >= low:
        return 'outside the interval, which overlaps that of its own crests'
    curve = modes.curves[k]
    if curve is not None and curve.dependent:
        return 'outside the interval: it weighs small amplitudes as much as large ones'
    if found.convention == 'book':
        return 'outside the interval: two crests alone, and the formula for small damping'
    return f'outside the interval: {found.height.size} half cycles against the whole record'
