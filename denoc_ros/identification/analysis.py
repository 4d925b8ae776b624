"""A record of a free decay from end to end: window, modes, and other methods beside them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from denoc_ros.errors import IdentificationError
from denoc_ros.identification.decrement import Convention, log_decrement
from denoc_ros.identification.fit import fit_modes
from denoc_ros.identification.modes import Modes
from denoc_ros.identification.quality import Quality, assess
from denoc_ros.identification.records import Floats, Record
from denoc_ros.identification.segments import find_segments
from denoc_ros.identification.spectra import Method, SpectralDecay, evolving_spectra

CONVENTIONS: tuple[Convention, ...] = ('exact', 'book')
CLEAR = 5.0  # standard deviations of the noise: lower crests are not counted
HELD_OUT = 0.3  # of a decay: predicted from the rest


@dataclass(frozen=True)
class Check:
    """What another method says of a mode.

    Attributes
    ----------
    method : str
    frequency_hz, damping_ratio : float or None
        None where it does not apply.
    reason : str
        Why it does not apply, or why it differs; '' where it agrees.
    """

    method: str
    frequency_hz: float | None
    damping_ratio: float | None
    reason: str


@dataclass(frozen=True, eq=False)
class DecayAnalysis:
    """All that was found in a record of a free decay.

    Attributes
    ----------
    record : Record
        The part that was fitted.
    window_by : str
        Who chose it: `given`, `found` or `whole record`.
    quality : Quality
        Of that part.
    modes : Modes
    spectra : tuple of SpectralDecay
        Evolving spectra of the modes, one each.
    checks : tuple of tuple of Check
        Other methods, one tuple per mode.
    """

    record: Record
    window_by: str
    quality: Quality
    modes: Modes
    spectra: tuple[SpectralDecay, ...]
    checks: tuple[tuple[Check, ...], ...]


def analyse_decay(record: Record, given: bool = False) -> DecayAnalysis:
    """Return the modes of a record of a free decay, and what other methods say of them.

    Parameters
    ----------
    record : Record
    given : bool
        Whether the record is the decay; else the longest free decay in it is looked for.

    Raises
    ------
    IdentificationError
        As `fit_modes`.
    """
    record, window_by = (record, 'given') if given else _longest_decay(record)
    modes = fit_modes(record)
    spectra = _spectra(record, modes, 'weighted')
    checks = tuple(
        (
            _spectral_check('evolving spectra', spectra[k], modes, k),
            *(_decrement_check(record, modes, k, convention) for convention in CONVENTIONS),
        )
        for k in range(len(modes.frequency))
    )
    return DecayAnalysis(record, window_by, assess(record), modes, spectra, checks)


def held_out(record: Record) -> tuple[Modes, float] | None:
    """Return modes of the first part of a decay and where it ends [s]; None of a short record.

    What they predict of the rest was not seen by the fit.
    """
    split = float(record.t[0]) + (1.0 - HELD_OUT) * record.duration
    try:
        return fit_modes(record.part(float(record.t[0]), split)), split
    except IdentificationError:
        return None


def own_decay(analysis: DecayAnalysis, k: int) -> Floats:
    """Return the record without offset, drift and all modes but one, (samples,)."""
    t, modes = analysis.record.t, analysis.modes
    return np.asarray(analysis.record.y - modes.prediction(t) + modes.component(k, t))


def residual_spectrum(analysis: DecayAnalysis) -> tuple[Floats, Floats, Floats]:
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


def _longest_decay(record: Record) -> tuple[Record, str]:
    """Return the free decay that says most, with the rest that follows, and how it was chosen."""
    segments = find_segments(record)
    decays = [segment for segment in segments if segment.kind == 'decay']
    if not decays:
        return record, 'whole record'
    chosen = max(decays, key=lambda segment: segment.amplitude * (segment.stop - segment.start))
    later = [s.start for s in segments if s.kind != 'rest' and s.start >= chosen.stop]
    return record.part(chosen.start, min([float(record.t[-1]), *later])), 'found'


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
        reason = 'its interval and that of the fit do not meet'
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
    try:
        found = log_decrement(own.part(modes.start, stop), convention)
    except IdentificationError as error:
        return Check(method, None, None, str(error).removeprefix(f'{record.name}: '))
    reason = ''
    low, high = modes.interval[k]
    if not low <= found.damping_ratio <= high:
        curve = modes.curves[k]
        if curve is not None and curve.dependent:
            reason = 'outside the interval: it weighs small amplitudes as much as large ones'
        elif convention == 'book':
            reason = 'outside the interval: two crests alone, and the formula for small damping'
        else:
            reason = 'outside the interval: lines and noise that the fit leaves move its crests'
    return Check(method, float(found.frequency), float(found.damping_ratio), reason)
