"""Segments of a record: releases, decays, steps, rests; the free decay that is identified."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.signal import find_peaks

from denoc_ros.bags.joint_state import JOINT_STATE
from denoc_ros.bags.reader import bag_topics
from denoc_ros.bags.series import read_joint_states
from denoc_ros.identification.decay.channel import Reading
from denoc_ros.identification.decay.damped import in_gap
from denoc_ros.identification.decay.records import (
    FEWEST_SAMPLES,
    Mask,
    Quality,
    Record,
    assess,
    runs,
)
from denoc_ros.identification.tables.tables import is_table
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
MISSED = 0.1  # of the swing: what a new excitation adds to what the last cycles let expect
SUDDEN = 3.0  # times what they missed before it
PREDICTED, PREDICTING, BEFORE = 0.75, 2.0, 3.0  # cycles: ahead, by these, and compared with these
STRONG_LEFT = 0.1  # of the largest swing: less may be noise
FASTEST_FALL = 2.0  # e-folds in a cycle
ANOTHER = 1.3  # times a frequency: another motion's
LEVEL_OFF = 0.15  # of the swing: from one cycle's mean to the next's, while a step lasts
FINEST = 24  # samples in a cycle that a prediction needs
FEWEST_FOLDS = 0.1  # that a decay must fall
Span = tuple[float, float]  # from when to when [s], on the record's clock

SMALLEST_MOTION = 1e-3  # rad or m: a joint that covers less is held
SLOW = 0.02  # of a joint's largest speed: less is standing
STEP = 0.02  # s, at least, over which a speed is taken
QUIETEST = 10.0  # percent of the speeds, taken for noise
OF_QUIETEST = 0.126  # standard deviations of noise that so many percent are below
NOISY = 4.0  # standard deviations of the speed's noise: less is standing
JOINT_TOPIC = '/joint_states'
SHORTEST = 0.1  # s of standing
SOON = 2.0  # cycles after the joints stop: a decay found there begins with the stop
TOLERANCE = 0.01  # s


@dataclass(frozen=True)
class Segment:
    """A part of a record."""

    # {'decay', 'step', 'rest'}; a decay starts at a release; a step goes from one level to another
    kind: Kind
    # [s], on the record's clock
    start: float
    stop: float
    # decay: half the swing at its start; step: change of level; rest: half the swing [unit]
    amplitude: float
    level: float  # mean at the end [unit]
    frequency: float = 0.0  # of a decay: where its spectrum is largest [Hz]; 0 for the others
    # when the next event begins, however small what follows it is [s]; inf for none
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
    known = ~in_gap(record.t, t)
    tried = []
    for cycle in _cycles(t, y):
        size = min(max(round(cycle / (t[1] - t[0])), 4), y.size // 3)
        tried.append(_with_cycle(t, y, known, quality, size))
        if any(segment.kind == 'decay' for segment in tried[-1]):
            return tried[-1]
    return tried[0]


def _with_cycle(t: Array, y: Array, known: Mask, quality: Quality, size: int) -> list[Segment]:
    ahead, behind = _swings(y, size)
    quiet = max(AT_REST * quality.noise, quality.resolution, SMALLEST * float(ahead.max()))
    found = _rests(t, y, np.maximum(ahead, behind) <= quiet, size)
    edges = [0, *_events(ahead, behind, quiet), y.size - 1]
    for first, last in pairwise(edges):
        found += _after_event(t, y, ahead, known, quiet, first, last, size)
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
    peaks, _ = find_peaks(size, height=STRONG * size.max())
    chosen = peaks[:MOST_CYCLES] if peaks.size else [int(np.argmax(size))]
    return [float(1.0 / frequency[k]) for k in chosen]


def _swings(y: Array, size: int) -> tuple[Array, Array]:
    """Return the swing in the cycle that begins, and in the one that ends, at each sample."""
    half = size // 2
    middle = 0.5 * (maximum_filter1d(y, size) - minimum_filter1d(y, size))
    ahead = np.append(middle[half:], np.full(half, middle[-1]))
    behind = np.append(np.full(half, middle[0]), middle[: middle.size - half])
    return ahead, behind


def _rests(t: Array, y: Array, still: Mask, size: int) -> list[Segment]:
    return [
        Segment(
            'rest',
            float(t[first]),
            float(t[last]),
            0.5 * float(np.ptp(y[first : last + 1])),
            float(y[first : last + 1].mean()),
        )
        for first, last in runs(still)
        if last - first >= size
    ]


def _events(ahead: Array, behind: Array, quiet: float) -> list[int]:
    jump = ahead - behind
    sudden = (jump > max(JUMP * float(ahead.max()), 2.0 * quiet)) & (ahead > RATIO * behind)
    return [first + int(np.argmax(jump[first : last + 1])) for first, last in runs(sudden)]


def _frequency(t: Array, y: Array, size: int) -> float:
    """Return where a decay's spectrum is largest [Hz], from half the rate of a cycle on."""
    padded = 8 * y.size
    power = np.abs(np.fft.rfft((y - y.mean()) * np.hanning(y.size), padded))
    frequency = np.fft.rfftfreq(padded, t[1] - t[0])
    power[frequency < 0.5 / (size * (t[1] - t[0]))] = 0.0
    return float(frequency[int(np.argmax(power))])


def _new_excitation(t: Array, y: Array, swing: Array, known: Mask, frequency: float) -> int:
    """Return the index shortly before something excites a decay anew; 0 where nothing does.

    Parameters
    ----------
    t, y, swing : ndarray, shape (k,)
        Even times from a release on [s], values, and half the range of the cycle that follows.
    known : ndarray of bool, shape (k,)
        Samples that are measured, not filled in.
    frequency : float
        Of the decay [Hz].

    Notes
    -----
    Two cycles predict the next three quarters of one, by an oscillation that decays at the usual
    rate and whose strength and phase change linearly, on a level that does. A free decay is missed
    by a share that changes slowly, whatever its other modes and its damping; a step or a blow at
    once by more.
    """
    cycle = 1.0 / (frequency * float(t[1] - t[0]))
    coarse = max(int(cycle / FINEST), 1)
    count = y.size // coarse
    size = cycle / coarse
    behind, ahead = round(PREDICTING * size), max(round(PREDICTED * size), 2)
    if count < behind + 2 * ahead + 1 or behind < 8:
        return 0
    values = y[: count * coarse].reshape(count, coarse).mean(axis=1)
    whole = known[: count * coarse].reshape(count, coarse).all(axis=1)
    x = np.arange(-behind, ahead) / size
    turn, fall = 2.0 * np.pi * x, np.exp(-_usual_fall(swing, round(cycle)) * x)
    basis = np.column_stack(
        [np.ones(x.size), x, *(f(turn) * fall * g for f in (np.cos, np.sin) for g in (1.0, x))]
    )
    weights = basis[behind:] @ np.linalg.pinv(basis[:behind])
    views = np.lib.stride_tricks.sliding_window_view(values, behind + ahead)
    missed = views[:, behind:] - views[:, :behind] @ weights.T
    error = np.sqrt(np.mean(missed**2, axis=1))
    gaps = np.lib.stride_tricks.sliding_window_view(~whole, behind + ahead).any(axis=1)
    error[gaps] = 0.0
    # at sample k of `error` what is predicted begins at sample k + behind
    usual = _median_before(error, round(BEFORE * size))
    at = np.arange(ahead, error.size)
    swings = swing[(at + behind - ahead) * coarse]
    beyond = np.flatnonzero(
        (error[at] > MISSED * swings) & (error[at] > SUDDEN * usual[at - ahead])
    )
    if not beyond.size:
        return 0
    return int((at[beyond[0]] + behind) * coarse)


def _median_before(values: Array, count: int) -> Array:
    """Return the median of each value and those before it, `count` at most."""
    padded = np.concatenate((np.full(count - 1, np.nan), values))
    return np.asarray(
        np.nanmedian(np.lib.stride_tricks.sliding_window_view(padded, count), axis=1)
    )


def _after_step(t: Array, y: Array, start: int, level: float) -> int:
    """Return the turning point from which on a decay after an event keeps its level.

    The cycle in which the level changes has the largest swing, and is no decay yet.
    """
    if y.size - start < 2 * FIRST_SAMPLES:
        return start
    rate = _frequency_of_speed(t[start:], y[start:]) * float(t[1] - t[0])
    size = max(round(1.0 / max(rate, 1e-9)), 4)
    moved = start
    while moved + 3 * size <= y.size:
        cycles = y[moved : moved + 3 * size].reshape(3, size)
        means = cycles.mean(axis=1)
        usual = max(LEVEL_OFF * 0.5 * float(np.ptp(cycles[1])), SUDDEN * abs(means[2] - means[1]))
        if abs(means[1] - means[0]) <= usual:
            break
        moved += max(size // 8, 1)
    if moved == start:
        return start
    return moved + int(np.argmax(np.abs(y[moved : moved + size // 2 + 1] - level)))


def _usual_fall(swing: Array, cycle: int) -> float:
    """Return the e-folds by which a swing usually falls in a cycle."""
    low = swing[: max(swing.size - 2 * cycle, 0)]  # the last cycle's swing is of less than a cycle
    later = swing[cycle : cycle + low.size]
    seen = (low > 0.0) & (later > STRONG_LEFT * float(swing.max()))
    if not seen.any():
        return 0.0
    return float(np.clip(np.median(np.log(low[seen] / later[seen])), 0.0, FASTEST_FALL))


def _frequency_of_speed(t: Array, y: Array) -> float:
    """Return where the spectrum of a motion's speed is largest [Hz]."""
    speed = np.diff(y) * np.hanning(y.size - 1)
    power = np.abs(np.fft.rfft(speed, 8 * speed.size))
    return float(np.fft.rfftfreq(8 * speed.size, t[1] - t[0])[int(np.argmax(power))])


def _excited_again(t: Array, y: Array, swing: Array, known: Mask, frequency: float) -> int:
    """Return the first new excitation by the slowest and by the fastest strong motion.

    A step is itself the strongest slow motion, and hides the cycle of the ring.
    """
    of_speed = _frequency_of_speed(t, y)
    tried = [frequency, *([of_speed] if of_speed > ANOTHER * frequency else [])]
    found = [_new_excitation(t, y, swing, known, one) for one in tried]
    return min((index for index in found if index), default=0)


def _after_event(
    t: Array, y: Array, ahead: Array, known: Mask, quiet: float, first: int, last: int, size: int
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
    if first > 0:
        start = min(_after_step(t[: stop + 1], y[: stop + 1], start, level), stop)
    found = []
    before = float(y[max(first - size, 0) : first + 1].mean())
    if first > 0 and abs(level - before) > 2.0 * quiet:
        found.append(Segment('step', float(t[first]), float(t[start]), level - before, level))
    height = 0.5 * float(np.ptp(y[start : start + size]))
    left = 0.5 * float(np.ptp(y[max(stop - size, start) : stop + 1]))
    if stop - start >= FEWEST_CYCLES * size and height > np.exp(FEWEST_FOLDS) * left:
        frequency = _frequency(t[start : stop + 1], y[start : stop + 1], size)
        until = np.inf if last == y.size - 1 else float(t[max(last - size // 4, stop)])
        part = slice(start, last + 1)
        again = _excited_again(t[part], y[part], ahead[part], known[part], frequency)
        if again:
            stop = min(stop, start + again)
            until = min(until, float(t[start + again]))
            frequency = _frequency(t[start : stop + 1], y[start : stop + 1], size)
        span = float(t[start]), float(t[stop])
        found.append(Segment('decay', *span, height, level, frequency, until))
        if again:
            later = start + again + size // 2
            found += _after_event(t, y, ahead, known, quiet, later, last, size)
    return found


def standing_spans(reading: Reading) -> list[Span]:
    """Return the time spans in which a bag's joints rest [s], on a record's clock.

    [] where the bag does not say: no joint states, joints that never move or never stand, or a
    record that is itself the motion of the joints. Errors as `read_record`.
    """
    channel = reading.channel
    if channel.topic == JOINT_TOPIC and channel.quantity != 'effort':
        return []
    if is_table(reading.path) or bag_topics(reading.path).get(JOINT_TOPIC) != JOINT_STATE:
        return []
    series = read_joint_states(reading.path, JOINT_TOPIC, stamp=channel.stamp)
    return still_spans(series.since(reading.origin_ns).t, series.position)


def still_spans(t: Array, position: Array) -> list[Span]:
    """Return the time spans in which joints at positions (k, joints) rest [s].

    [] of joints that never move or never stand.
    """
    moving = [_moving(t, column) for column in position.T]
    told = [one for one in moving if one is not None]
    if not told:
        return []
    still = ~np.any(told, axis=0)
    spans = [(float(t[first]), float(t[last])) for first, last in runs(still)]
    return [span for span in spans if span[1] - span[0] > SHORTEST]


def decay_window(record: Record, standing: Sequence[Span] = ()) -> tuple[Record, str]:
    """Return the most informative free decay, with the rest after it, and how it was chosen."""
    found = [_in_span(record, span) for span in standing]
    known = [one for one in found if one is not None]
    if known:
        best = max(known, key=lambda one: one[0])
        return record.part(*best[1]), 'found where the joints stand'
    segments = find_segments(record)
    chosen = _largest(segments)
    if chosen is None:
        return record, 'whole record'
    return record.part(chosen.start, _end(record, segments, chosen)), 'found'


def moving_until(record: Record, standing: Sequence[Span]) -> float:
    """Return when the joints move last in a record [s]; 0 where they stand, as far as known."""
    if not standing:
        return 0.0
    start, stop = float(record.t[0]), float(record.t[-1])
    later = [begin for begin, _ in standing if begin < stop - TOLERANCE]
    last = max(later, default=start)
    ends = [end for begin, end in standing if begin <= start + TOLERANCE and end > start]
    if last > start + TOLERANCE:
        return last
    return stop if not ends or max(ends) < stop - TOLERANCE else 0.0


def _in_span(record: Record, span: Span) -> tuple[float, Span] | None:
    """Return how much the largest decay in a span says, and its window; None without one."""
    inside = (record.t >= span[0]) & (record.t <= span[1])
    if np.count_nonzero(inside) < 4 * FEWEST_SAMPLES:
        return None
    part = record.part(*span)
    segments = find_segments(part)
    chosen = _largest(segments)
    if chosen is None:
        return None
    start = chosen.start
    if start - part.t[0] < SOON / chosen.frequency:
        start = float(part.t[0])
    return chosen.amplitude * (chosen.stop - start), (start, _end(part, segments, chosen))


def _largest(segments: Sequence[Segment]) -> Segment | None:
    decays = [segment for segment in segments if segment.kind == 'decay']
    return max(decays, key=lambda one: one.amplitude * (one.stop - one.start), default=None)


def _end(record: Record, segments: Sequence[Segment], chosen: Segment) -> float:
    later = [one.start for one in segments if one.kind != 'rest' and one.start >= chosen.stop]
    return min([float(record.t[-1]), chosen.until, *later])


def _moving(t: Array, position: Array) -> Mask | None:
    """Return when a joint moves; None for a held joint, or without a recorded motion."""
    if position.size < 4 * FEWEST_SAMPLES or not np.all(np.isfinite(position)):
        return None
    if np.ptp(position) < SMALLEST_MOTION:
        return None
    reach = max(2, round(0.5 * STEP / float(np.median(np.diff(t)))))
    ahead = np.minimum(np.arange(t.size) + reach, t.size - 1)
    behind = np.maximum(np.arange(t.size) - reach, 0)
    speed = np.abs((position[ahead] - position[behind]) / np.maximum(t[ahead] - t[behind], 1e-9))
    noise = float(np.percentile(speed, QUIETEST)) / OF_QUIETEST
    limit = max(SLOW * float(speed.max()), NOISY * noise)
    return None if limit > 0.5 * speed.max() else np.asarray(speed > limit)
