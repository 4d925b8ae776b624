"""Verdict on one mode of a record, with reasons."""

from __future__ import annotations

import numpy as np

from denoc_ros.identification.components import Component
from denoc_ros.identification.curves import NORMAL_95
from denoc_ros.identification.modes import DOUBTFUL, GOOD, NOT_IDENTIFIABLE
from denoc_ros.identification.quality import Quality
from denoc_ros.identification.records import Record

WIDEST = 0.05  # relative standard deviation of zeta of a good mode
USELESS = 0.35  # relative standard deviation that says nothing
FEWEST_CYCLES = 1.5
HEAVIEST = 0.3  # damping ratio with which the amplitude falls to 5 % in one and a half cycles
MOST_CLIPPED = 0.4
FEWEST_FOLDS = 0.25  # e-folds of amplitude that a decay must fall by in its window
WEAK = 0.1  # of the strongest, for a mode beside a coloured residual
NEAR_NYQUIST = 0.8  # of half the sample rate


def judge(
    part: Component, record: Record, quality: Quality, coloured: bool, left_out: float
) -> tuple[str, tuple[str, ...]]:
    """Return the verdict on a mode and the reasons.

    Parameters
    ----------
    part : Component
    record : Record
    quality : Quality
    coloured : bool
        Whether the residual of the fit is.
    left_out : float
        Share of the samples that the fit did not use.
    """
    doubts = _doubts(part, record, quality, coloured, left_out)
    if part.zeta <= 0.0:
        return NOT_IDENTIFIABLE, (f'does not decay: damping ratio {part.zeta:.3g}', *doubts)
    if part.no_decay:
        return NOT_IDENTIFIABLE, (part.no_decay, *doubts)
    relative = max(part.deviation, _half_width(part) / NORMAL_95) / part.zeta
    spread = f'standard deviation of the damping ratio is {100.0 * relative:.1f} % of it'
    if relative > USELESS:
        return NOT_IDENTIFIABLE, (spread, *doubts)
    if relative > WIDEST:
        return DOUBTFUL, (f'{spread}, more than {100.0 * WIDEST:.0f} %', *doubts)
    return (DOUBTFUL, tuple(doubts)) if doubts else (GOOD, ())


def _half_width(part: Component) -> float:
    low, high = part.interval
    return float(0.5 * (high - low)) if np.isfinite(high - low) else 0.0


def _doubts(
    part: Component, record: Record, quality: Quality, coloured: bool, left_out: float
) -> list[str]:
    reasons = []
    folds = 2.0 * np.pi * part.frequency * part.zeta * record.duration
    if 0.0 < folds < FEWEST_FOLDS:
        reasons.append(
            f'falls by {-100.0 * np.expm1(-folds):.2g} % in the window: a driven vibration whose '
            f'strength drifts looks the same; give a window in which it falls by '
            f'{-100.0 * np.expm1(-FEWEST_FOLDS):.0f} % or more'
        )
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
    if left_out > MOST_CLIPPED:
        reasons.append(f'{100.0 * left_out:.0f} % of the samples are left out as clipped')
    return reasons
