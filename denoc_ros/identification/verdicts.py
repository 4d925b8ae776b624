"""Verdict on one mode of a record, with reasons."""

from __future__ import annotations

import numpy as np

from denoc_ros.identification.components import Component
from denoc_ros.identification.modes import DOUBTFUL, GOOD, NOT_IDENTIFIABLE
from denoc_ros.identification.quality import Quality
from denoc_ros.identification.records import Record

WIDEST = 0.05  # relative standard deviation of zeta of a good mode
USELESS = 0.35  # relative standard deviation that says nothing
FEWEST_CYCLES = 1.5
HEAVIEST = 0.3  # damping ratio with which the amplitude falls to 5 % in one and a half cycles
MOST_CLIPPED = 0.4
WEAK = 0.1  # of the strongest, for a mode beside a coloured residual
NEAR_NYQUIST = 0.8  # of half the sample rate


def judge(
    part: Component, record: Record, quality: Quality, coloured: bool
) -> tuple[str, tuple[str, ...]]:
    """Return the verdict on a mode and the reasons."""
    doubts = _doubts(part, record, quality, coloured)
    if part.zeta <= 0.0:
        return NOT_IDENTIFIABLE, (f'does not decay: damping ratio {part.zeta:.3g}', *doubts)
    if part.no_decay:
        return NOT_IDENTIFIABLE, (part.no_decay, *doubts)
    relative = part.deviation / part.zeta
    spread = f'standard deviation of the damping ratio is {100.0 * relative:.1f} % of it'
    if relative > USELESS:
        return NOT_IDENTIFIABLE, (spread, *doubts)
    if relative > WIDEST:
        return DOUBTFUL, (f'{spread}, more than {100.0 * WIDEST:.0f} %', *doubts)
    return (DOUBTFUL, tuple(doubts)) if doubts else (GOOD, ())


def _doubts(part: Component, record: Record, quality: Quality, coloured: bool) -> list[str]:
    reasons = []
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
    clipped = float(np.mean(quality.clipped))
    if clipped > MOST_CLIPPED:
        reasons.append(f'{100.0 * clipped:.0f} % of the samples are clipped')
    return reasons
