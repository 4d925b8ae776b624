"""The free decay within a record, by the signal and by the rest of the joints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from denoc_ros.bags.joint_state import JOINT_STATE
from denoc_ros.bags.reader import bag_topics
from denoc_ros.bags.series import read_joint_states
from denoc_ros.bags.tables import is_table
from denoc_ros.identification.channel import Reading
from denoc_ros.identification.quality import Mask
from denoc_ros.identification.records import FEWEST_SAMPLES, Record
from denoc_ros.identification.segments import Segment, find_segments
from denoc_ros.types import Array

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
    t = series.since(reading.origin_ns).t
    moving = [_moving(t, series.position[:, k]) for k in range(len(series.names))]
    told = [one for one in moving if one is not None]
    if not told:
        return []
    still = ~np.any(told, axis=0)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], still.astype(int), [0]))))
    spans = [(float(t[a]), float(t[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]
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
