"""Evolving spectra (waterfall method): amplitude of each mode in windows moved along a decay."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import find_peaks
from scipy.special import stdtrit

from denoc_ros.errors import IdentificationError
from denoc_ros.identification.decay.records import Mask, Record, sample_noise
from denoc_ros.types import Array

Method = Literal['weighted', 'book']
Complexes = NDArray[np.complex128]

OVERLAP = 0.9  # part of a window that the next one shares
MOST_WINDOWS = 200
FEWEST_WINDOWS = 3
FEWEST_SAMPLES = 8
SHORTEST = 3.0  # window times the distance to the next frequency
LONG_ENOUGH = 12.0  # the same, where leakage is no more
ROUNDS = 2  # of window, reading and time constant
LONGEST = 2.0  # window over the mode's time constant
CLEAR = 30.0  # times the leakage and the noise that a peak must be
FEWEST_FOLDS = 0.7  # e-folds that the mode must fall over the windows
SLOWEST = 3.0  # cycles in the record: less may be the drift
PEAK = 0.02  # of the highest, for frequencies that are looked for


@dataclass(frozen=True, eq=False)
class Waterfall:
    """Spectra of windows moved along a record (the book's fig. 8.5b)."""

    time: Array  # (w,) middle of each window [s]
    frequency: Array  # (f,) [Hz]
    # (w, f) amplitude of a steady cosine that would read the same [record's unit]
    magnitude: Array


@dataclass(frozen=True, eq=False)
class SpectralDecay:
    """One mode's decay through the windows (the book's fig. 8.5c) and the damping it gives."""

    frequency: float  # undamped natural frequency [Hz] (book: the one that was given)
    damping_ratio: float  # nan where the method does not hold
    interval: Array  # (2,) 95 % interval of the damping ratio
    reading: float  # what the slope says, whether the method holds or not
    window: float  # [s]
    # (w,) middle of each window [s]; the mode's amplitude there; leakage of the others and noise
    time: Array
    magnitude: Array
    floor: Array
    used: Mask  # (w,) the windows that the slope is of
    reasons: tuple[str, ...]  # why the method does not hold; empty where it does


def waterfall(record: Record, window: float) -> Waterfall:
    """Return the spectra of Hann windows moved along a record.

    Parameters
    ----------
    window : float
        Length of the windows [s].
    """
    count = max(int(window / record.step), FEWEST_SAMPLES)
    even = even_record(record)
    grid, values = even.t, even.y
    hop = max(1, round(count * (1.0 - OVERLAP)))
    starts = np.arange(0, grid.size - count + 1, hop)
    shape = np.hanning(count)
    rows = values[starts[:, None] + np.arange(count)]
    rows = (rows - rows.mean(axis=1, keepdims=True)) * shape
    magnitude = np.abs(np.fft.rfft(rows, 4 * count, axis=1)) * 2.0 / shape.sum()
    frequency = np.asarray(np.fft.rfftfreq(4 * count, record.step))
    magnitude = np.asarray(magnitude, float)
    return Waterfall(grid[starts] + 0.5 * window, frequency, magnitude)


def even_record(record: Record) -> Record:
    """Return the record at even stamps (cubic between its samples).

    A sum over a window with samples missing leaks by chance: more than a window's shape does.
    """
    count = round(record.duration / record.step) + 1
    t = np.linspace(record.t[0], record.t[-1], count)
    return Record(t, CubicSpline(record.t, record.y)(t), record.name, record.unit)


def evolving_spectra(
    record: Record,
    frequencies: Array | None = None,
    window: float | None = None,
    method: Method = 'weighted',
) -> tuple[SpectralDecay, ...]:
    """Return the damping of each mode from the slope of its amplitude over moved windows.

    Parameters
    ----------
    frequencies : ndarray, optional
        Of the modes, damped [Hz], known in advance; default: peaks of the record's spectrum.
    window : float, optional
        [s]; default: what suits each mode, inside the limits of the method.
    method : {'weighted', 'book'}
        Hann windows, 90 % overlap, slope weighted by the signal's power; or the book's (sec.
        8.2.2.1, eq. 8.6c): rectangular, side by side, unweighted, small damping.

    Raises
    ------
    IdentificationError
        No frequency stands out, or one is not positive.

    Notes
    -----
    Holds where 3/df <= window <= 2 tau, df the distance to the next frequency (0, the offset's,
    is one), tau the mode's time constant, and the peak is 30 times its neighbours' leakage in
    at least three windows. Outside the method refuses: damping_ratio is nan, reasons say why.
    """
    found = spectrum_peaks(record) if frequencies is None else np.sort(np.asarray(frequencies))
    if found.size == 0 or found.min() <= 0.0:
        raise IdentificationError(
            f'{record.name}: evolving spectra need frequencies > 0 Hz, got {found.tolist()}'
        )
    even = even_record(record)
    return tuple(_decay(even, found, k, window, method) for k in range(found.size))


def spectrum_peaks(record: Record) -> Array:
    """Return the frequencies of the peaks of a record's spectrum [Hz]."""
    even = even_record(record)
    grid, values = even.t, even.y
    tail = values[-max(values.size // 5, 2) :].mean()
    size = 4 * values.size
    magnitude = np.abs(np.fft.rfft(values - tail, size))
    frequency = np.fft.rfftfreq(size, grid[1] - grid[0])
    magnitude[frequency < SLOWEST / record.duration] = 0.0
    smooth = np.convolve(magnitude, np.hanning(9) / np.hanning(9).sum(), 'same')
    least = PEAK * smooth.max()
    peaks, _ = find_peaks(smooth, height=least, prominence=0.5 * least)
    noise = sample_noise(record.y) * np.sqrt(values.size)
    strong = peaks[smooth[peaks] > CLEAR * noise]
    return np.asarray(frequency[strong[_apart(frequency[strong], smooth[strong], record)]])


def _apart(frequency: Array, height: Array, record: Record) -> list[int]:
    """Keep the highest of peaks that are closer than the resolution."""
    kept: list[int] = []
    for k in np.argsort(-height):
        if all(abs(frequency[k] - frequency[j]) > 2.0 / record.duration for j in kept):
            kept.append(int(k))
    return sorted(kept)


def _decay(
    record: Record, frequencies: Array, k: int, window: float | None, method: Method
) -> SpectralDecay:
    apart = np.append(np.abs(np.delete(frequencies, k) - frequencies[k]), frequencies[k]).min()
    shortest = SHORTEST / apart
    if window is not None:
        return _in_windows(record, frequencies, k, window, method, shortest)
    reading = _in_windows(record, frequencies, k, shortest, method, shortest)
    suited = shortest
    for _ in range(ROUNDS):
        longest = min(LONGEST * _time_constant(reading), 0.5 * record.duration)
        suited = max(min(LONG_ENOUGH / SHORTEST * shortest, longest), shortest)
        reading = _in_windows(record, frequencies, k, suited, method, shortest)
    return reading


def _time_constant(decay: SpectralDecay) -> float:
    rate = 2.0 * np.pi * decay.frequency * decay.reading
    return float(1.0 / rate) if rate > 0.0 else np.inf


def _in_windows(
    record: Record, frequencies: Array, k: int, window: float, method: Method, shortest: float
) -> SpectralDecay:
    starts = _window_starts(record, window, method)
    amplitudes = _amplitudes(record, starts, window, frequencies, method)
    magnitude = np.abs(amplitudes[:, k])
    floor = _floor(record, np.abs(amplitudes), frequencies, k, window, method)
    used = np.logical_and.accumulate(magnitude > CLEAR * floor)
    decay = SpectralDecay(
        frequency=float(frequencies[k]),
        damping_ratio=np.nan,
        interval=np.full(2, np.nan),
        reading=np.nan,
        window=window,
        time=starts + 0.5 * window,
        magnitude=magnitude,
        floor=floor,
        used=used,
        reasons=(),
    )
    fitted = used if method == 'weighted' else magnitude > 0.0
    if np.count_nonzero(fitted) >= 2:
        decay = _slope(decay, amplitudes[:, k], fitted, method)
    return _checked(decay, shortest)


def _window_starts(record: Record, window: float, method: Method) -> Array:
    last = record.t[-1] - window
    hop = window if method == 'book' else window * (1.0 - OVERLAP)
    hop = max(hop, (last - record.t[0]) / MOST_WINDOWS, record.step)
    return np.asarray(np.arange(record.t[0], last + 1e-9, hop))


def _amplitudes(
    record: Record, starts: Array, window: float, frequencies: Array, method: Method
) -> Complexes:
    """Return the amplitudes of e^{i 2 pi f t} in windows, (w, f); 0 where samples are too few.

    Hann: weighted least squares with an offset, each frequency alone. Book: the FFT's.
    """
    turns = np.exp(-2j * np.pi * np.outer(record.t - record.t[0], frequencies))
    phi = np.column_stack((turns.real, -turns.imag, np.ones(record.t.size), record.y))
    found = np.zeros((starts.size, frequencies.size), np.complex128)
    edges = np.searchsorted(record.t, (starts, starts + window))
    for row, (start, low, high) in enumerate(zip(starts, *edges, strict=True)):
        if high - low < FEWEST_SAMPLES:
            continue
        if method == 'book':
            y = record.y[low:high]
            found[row] = 2.0 * np.mean((y - y.mean())[:, None] * turns[low:high], axis=0)
        else:
            shape = np.sin(np.pi * (record.t[low:high] - start) / window) ** 2
            found[row] = _each_alone(phi[low:high].T @ (shape[:, None] * phi[low:high]))
    return found


def _each_alone(products: Array) -> Complexes:
    """Return a - i b of each frequency from the weighted products of all columns, (f,).

    The columns are the f cosines, the f sines, one, and the samples.
    """
    count = (len(products) - 2) // 2
    index = np.arange(count)[:, None] + np.array([0, count, 0])
    index[:, 2] = 2 * count
    gram = products[index[:, :, None], index[:, None, :]]
    # a frequency that the samples do not show has a singular matrix: the least solution
    solution = np.linalg.pinv(gram, hermitian=True) @ products[index, -1][:, :, None]
    return np.asarray(solution[:, 0, 0] - 1j * solution[:, 1, 0])


def _floor(
    record: Record, magnitude: Array, frequencies: Array, k: int, window: float, method: Method
) -> Array:
    """Level that leakage of other modes and noise can reach at mode k's frequency."""
    samples = max(window / record.step, 1.0)
    floor = np.full(len(magnitude), sample_noise(record.y) * np.sqrt(3.0 / samples))
    for j in range(frequencies.size):
        if j != k:
            bins = abs(frequencies[j] - frequencies[k]) * window
            hann = 1.0 / (np.pi * bins * abs(bins**2 - 1.0)) if bins > 1.5 else 1.0
            side = 1.0 / (np.pi * bins) if method == 'book' and bins > 1.0 else hann
            floor = floor + magnitude[:, j] * side
    return np.asarray(floor)


def _slope(
    decay: SpectralDecay, amplitudes: Complexes, used: Mask, method: Method
) -> SpectralDecay:
    time, height = decay.time[used], np.log(np.abs(amplitudes[used]))
    weight = decay.magnitude[used] ** 2 if method == 'weighted' else np.ones(time.size)
    slope, deviation = _line(time, height, weight, decay.window)
    omega = 2.0 * np.pi * decay.frequency
    if method == 'book':
        zeta, rate, factor = -slope / omega, omega, 1.0 / omega
    else:
        turn, _ = _line(time, np.unwrap(np.angle(amplitudes[used])), weight, decay.window)
        rate = float(np.hypot(omega + turn, slope))
        zeta, factor = -slope / rate, 1.0 / rate
    half = deviation * factor
    interval = np.array([zeta - half, zeta + half])
    return replace(decay, frequency=rate / (2.0 * np.pi), reading=zeta, interval=interval)


def _line(x: Array, y: Array, weight: Array, window: float) -> tuple[float, float]:
    """Return weighted slope and the half width of its 95 % interval, overlap considered."""
    middle = weight @ x / weight.sum()
    away = x - middle
    slope = float(weight @ (away * y) / (weight @ away**2))
    rest = y - weight @ y / weight.sum() - slope * away
    independent = min(float(x.size), (x[-1] - x[0]) / (0.5 * window) + 1.0)
    freedom = max(independent - 2.0, 1.0)
    spread = weight @ rest**2 / weight.sum() * independent / freedom
    variance = spread / independent / (weight @ away**2 / weight.sum())
    return slope, float(stdtrit(freedom, 0.975) * np.sqrt(variance))


def _checked(decay: SpectralDecay, shortest: float) -> SpectralDecay:
    reasons = []
    cycles = decay.window * decay.frequency
    if decay.window < shortest * (1.0 - 1e-9):
        reasons.append(
            f'window must be at least 3/df = {shortest:.3g} s, got {decay.window:.3g} s '
            f'({cycles:.2g} cycles)'
        )
    tau = _time_constant(decay)
    if not decay.window <= LONGEST * tau:
        reasons.append(
            f'window must be at most 2 tau = {LONGEST * tau:.3g} s, got {decay.window:.3g} s'
        )
    clear = int(np.count_nonzero(decay.used))
    if clear < FEWEST_WINDOWS:
        reasons.append(
            f'peak must be {CLEAR:.0f} times leakage and noise in at least {FEWEST_WINDOWS} '
            f'windows, got {clear}'
        )
    elif np.ptp(decay.time[decay.used]) < FEWEST_FOLDS * tau:
        reasons.append(
            f'clear windows must span {FEWEST_FOLDS} tau = {FEWEST_FOLDS * tau:.3g} s, got '
            f'{np.ptp(decay.time[decay.used]):.3g} s'
        )
    zeta = np.nan if reasons or not np.isfinite(decay.reading) else decay.reading
    return replace(decay, damping_ratio=zeta, reasons=tuple(reasons))
