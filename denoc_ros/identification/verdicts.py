"""Verdict on one mode of a record, with reasons."""

from __future__ import annotations

import numpy as np

from denoc_ros.identification.components import Component
from denoc_ros.identification.damped import Damped
from denoc_ros.identification.modes import DOUBTFUL, GOOD, NOT_IDENTIFIABLE
from denoc_ros.identification.quality import Quality
from denoc_ros.identification.records import Record

WIDEST = 0.05  # relative standard deviation of zeta of a good mode
USELESS = 0.35  # relative standard deviation that says nothing
FEWEST_CYCLES = 1.5
MOST_CLIPPED = 0.4
NEAR_NYQUIST = 0.8  # of half the sample rate


def judge(
    part: Component, record: Record, quality: Quality, fit: Damped
) -> tuple[str, tuple[str, ...]]:
    """Return the verdict on a mode and the reasons."""
    fatal = _fatal(part, record)
    doubts = _doubts(part, record, quality)
    if fatal:
        return NOT_IDENTIFIABLE, (*fatal, *doubts)
    return (DOUBTFUL, tuple(doubts)) if doubts else (GOOD, ())


def _fatal(part: Component, record: Record) -> list[str]:
    reasons = []
    relative = part.deviation / abs(part.zeta) if part.zeta else np.inf
    if part.zeta <= 0.0:
        reasons.append(f'does not decay: damping ratio {part.zeta:.3g}')
    elif relative > USELESS:
        reasons.append(
            f'standard deviation of the damping ratio is {100.0 * relative:.0f} % of it'
        )
    return reasons


def _doubts(part: Component, record: Record, quality: Quality) -> list[str]:
    reasons = []
    relative = part.deviation / abs(part.zeta) if part.zeta else np.inf
    if WIDEST < relative <= USELESS and part.zeta > 0.0:
        reasons.append(
            f'standard deviation of the damping ratio is {100.0 * relative:.1f} % of it, '
            f'more than {100.0 * WIDEST:.0f} %'
        )
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
    clipped = float(np.mean(quality.clipped))
    if clipped > MOST_CLIPPED:
        reasons.append(f'{100.0 * clipped:.0f} % of the samples are clipped')
    return reasons
