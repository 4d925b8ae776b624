"""Segments of a record: free decays, steps and rests."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from denoc_ros.identification.peaks import find_peaks
from denoc_ros.identification.quality import Mask, Quality, assess
from denoc_ros.identification.records import Record
from denoc_ros.types import Array

Kind = Literal['decay', 'step', 'rest']

AT_REST = 5.0  # standard deviations of the noise: half of the swing of noise alone
SMALLEST = 0.02  # of the largest swing: less is rest
JUMP = 0.1  # of the largest swing, from one cycle to the next, that an event must have
RATIO = 1.5  # of the swing after an event to that before
MOST_CYCLES = 12  # that are tried
STRONG = 0.3  # of the strongest, that a slower motion must be to set the cycle
SLOWEST = 3.0  # cycles in the record of the motion that sets the cycle
FEWEST_CYCLES = 1.0  # of a decay
FIRST_SAMPLES = 8
RELEASED = 5.0  # standard deviations of the noise from where the record starts
RESTING = 1.0  # cycles
SHIFTED = 0.1  # of the swing, from one cycle's mean to the next: a step
FEWEST_FOLDS = 0.1  # that a decay must fall


@dataclass(frozen=True)
class Segment:
    """A part of a record.

    Attributes
    ----------
    kind : {'decay', 'step', 'rest'}
        A decay starts at a release; a step goes from one level to another.
    start, stop : float
        [s], on the record's clock.
    amplitude : float
        Decay: half the swing at its start; step: change of level; rest: half the swing [unit].
    level : float
        Mean at the end [unit].
    frequency : float
        Of a decay: where its spectrum is largest [Hz]; 0 for the others.
    until : float
        When the next event begins, however small what follows it is [s]; inf for none.
    """

    kind: Kind
    start: float
    stop: float
    amplitude: float
    level: float
    frequency: float = 0.0
    until: float = np.inf


def find_segments(record: Record) -> list[Segment]:
    """Return the free decays, steps and rests of a record, by start.

    Swing is half of largest minus smallest value in a cycle. An event is where the swing of the
    cycle that follows is much larger than that of the cycle before. A decay begins at the turning
    point where the swing after an event is largest, and ends where the noise begins or the next
    event is. Where no decay is found with the cycle of the slowest strong motion (a repeated
    manoeuvre's, say), the next faster ones are tried.
    """
    t = np.linspace(record.t[0], record.t[-1], record.t.size)
    y = np.interp(t, record.t, record.y)
    quality = assess(record)
    tried = []
    for cycle in _cycles(t, y):
        size = min(max(round(cycle / (t[1] - t[0])), 4), y.size // 3)
        tried.append(_with_cycle(t, y, quality, size))
        if any(segment.kind == 'decay' for segment in tried[-1]):
            return tried[-1]
    return tried[0]


def _with_cycle(t: Array, y: Array, quality: Quality, size: int) -> list[Segment]:
    ahead, behind = _swings(y, size)
    quiet = max(AT_REST * quality.noise, quality.resolution, SMALLEST * float(ahead.max()))
    found = _rests(t, y, np.maximum(ahead, behind) <= quiet, size)
    edges = [0, *_events(ahead, behind, quiet), y.size - 1]
    for first, last in pairwise(edges):
        found += _after_event(t, y, ahead, quiet, first, last, size)
    return sorted(found, key=lambda segment: segment.start)


def release_time(record: Record) -> float:
    """Return when a decay begins [s]: the first stamp, unless the record starts with a rest.

    A rest is longer than a cycle within five standard deviations of the noise: a decay, even one
    that starts with no speed, leaves that earlier.
    """
    noise = max(assess(record).noise, 1e-9 * float(np.ptp(record.y)))
    away = np.abs(record.y - record.y[:FIRST_SAMPLES].mean()) > RELEASED * noise
    first = int(np.argmax(away))
    cycle = _cycles(record.t, record.y)[0]
    if not away.any() or record.t[first] - record.t[0] < RESTING * cycle:
        return float(record.t[0])
    level = float(record.y[-max(record.y.size // 10, 2) :].mean())
    soon = (record.t >= record.t[first] - record.step) & (record.t <= record.t[first] + cycle)
    after = np.flatnonzero(soon)
    return float(record.t[after[int(np.argmax(np.abs(record.y[after] - level)))]])


def _cycles(t: Array, y: Array) -> list[float]:
    """Return the lengths of a cycle of the strong motions, the slowest first [s]."""
    speed = np.diff(y) * np.hanning(y.size - 1)
    frequency = np.fft.rfftfreq(4 * speed.size, t[1] - t[0])[1:]
    size = np.abs(np.fft.rfft(speed, 4 * speed.size))[1:] / frequency
    size[frequency < SLOWEST / float(t[-1] - t[0])] = 0.0
    peaks = find_peaks(size, height=STRONG * size.max())
    chosen = peaks[:MOST_CYCLES] if peaks.size else [int(np.argmax(size))]
    return [float(1.0 / frequency[k]) for k in chosen]


def _swings(y: Array, size: int) -> tuple[Array, Array]:
    """Return the swing in the cycle that begins, and in the one that ends, at each sample."""
    half = size // 2
    middle = 0.5 * (maximum_filter1d(y, size) - minimum_filter1d(y, size))
    ahead = np.append(middle[half:], np.full(half, middle[-1]))
    behind = np.append(np.full(half, middle[0]), middle[: middle.size - half])
    return ahead, behind


def _runs(mask: Mask) -> list[tuple[int, int]]:
    """Return first and last index of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], mask.astype(int), [0]))))
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _rests(t: Array, y: Array, still: Mask, size: int) -> list[Segment]:
    return [
        Segment(
            'rest',
            float(t[first]),
            float(t[last]),
            0.5 * float(np.ptp(y[first : last + 1])),
            float(y[first : last + 1].mean()),
        )
        for first, last in _runs(still)
        if last - first >= size
    ]


def _events(ahead: Array, behind: Array, quiet: float) -> list[int]:
    jump = ahead - behind
    sudden = (jump > max(JUMP * float(ahead.max()), 2.0 * quiet)) & (ahead > RATIO * behind)
    return [first + int(np.argmax(jump[first : last + 1])) for first, last in _runs(sudden)]


def _frequency(t: Array, y: Array, size: int) -> float:
    """Return where a decay's spectrum is largest [Hz], from half the rate of a cycle on."""
    padded = 8 * y.size
    power = np.abs(np.fft.rfft((y - y.mean()) * np.hanning(y.size), padded))
    frequency = np.fft.rfftfreq(padded, t[1] - t[0])
    power[frequency < 0.5 / (size * (t[1] - t[0]))] = 0.0
    return float(frequency[int(np.argmax(power))])


def _level_shift(y: Array, swing: Array, quiet: float, cycle: int) -> int:
    """Return the index a cycle before the level of a decay shifts, 0 where it does not.

    The mean over a cycle says so at once, however small the step beside the swing; the first half
    of the decay shows what else moves it, such as a slower mode.
    """
    if y.size < 6 * cycle:
        return 0
    total = np.cumsum(np.concatenate(([0.0], y)))
    means = (total[cycle:] - total[:-cycle]) / cycle
    change = np.abs(means[cycle:] - means[:-cycle])  # at sample k: of the cycles about k + cycle
    usual = float(change[: change.size // 2].max())
    limit = np.maximum(SHIFTED * swing[cycle : cycle + change.size], max(3.0 * usual, quiet))
    beyond = np.flatnonzero(change > limit)
    if not beyond.size:
        return 0
    return int(beyond[0]) + cycle


def _after_event(
    t: Array, y: Array, ahead: Array, quiet: float, first: int, last: int, size: int
) -> list[Segment]:
    if last - first < size:
        return []
    stop = last if last == y.size - 1 else max(last - size, first)
    loud = np.flatnonzero(ahead[first : stop + 1] > quiet)
    if loud.size == 0:
        return []
    stop = min(first + int(loud[-1]) + size // 2, stop)
    level = float(y[max(stop - size, first) : stop + 1].mean())
    largest = first + int(np.argmax(ahead[first : stop + 1]))
    around = slice(largest, min(largest + size, stop) + 1)
    start = largest + int(np.argmax(np.abs(y[around] - level)))
    found = []
    before = float(y[max(first - size, 0) : first + 1].mean())
    if first > 0 and abs(level - before) > 2.0 * quiet:
        found.append(Segment('step', float(t[first]), float(t[start]), level - before, level))
    height = 0.5 * float(np.ptp(y[start : start + size]))
    left = 0.5 * float(np.ptp(y[max(stop - size, start) : stop + 1]))
    if stop - start >= FEWEST_CYCLES * size and height > np.exp(FEWEST_FOLDS) * left:
        frequency = _frequency(t[start : stop + 1], y[start : stop + 1], size)
        until = np.inf if last == y.size - 1 else float(t[max(last - size // 4, stop)])
        cycle = max(round(1.0 / (frequency * (t[1] - t[0]))), 4)
        shift = _level_shift(y[start:last], ahead[start:last], quiet, cycle)
        if shift:
            stop = min(stop, start + shift)
            until = min(until, float(t[start + shift]))
        span = float(t[start]), float(t[stop])
        found.append(Segment('decay', *span, height, level, frequency, until))
    return found
