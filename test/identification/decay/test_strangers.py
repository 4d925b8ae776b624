"""Records as strangers make them: the short form of `python -m campaigns strangers`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bench.identify.identify_strangers import judged, judged_file
from strange_files import PHYSICS, SHAPES
from strange_records import CLEAN, STRANGE, Ring

from denoc_ros.identification.decay.analysis import analyse_decay
from denoc_ros.identification.decay.modes import GOOD
from denoc_ros.identification.decay.modes_fit import identify_modes
from denoc_ros.identification.decay.records import Record

KINDS = len(CLEAN) + len(STRANGE)


# driven and clipped tones that were called good, with intervals of a few per mille
@pytest.mark.parametrize('seed', [6, 38, 39, 54, 55, 86])
def test_a_driven_vibration_whose_strength_drifts_is_not_good(seed: int) -> None:
    assert judged(seed).verdict != GOOD


@pytest.mark.parametrize('seed', range(2 * KINDS, 3 * KINDS))
def test_each_kind_is_good_only_where_it_is_true(seed: int) -> None:
    one = judged(seed)
    assert not one.is_false_good, one.said
    assert one.verdict == GOOD or not one.record.is_clean, one.said


def test_an_interval_is_never_narrower_than_that_of_the_windows() -> None:
    t = np.arange(0.0, 10.0, 0.005)
    draw = np.random.default_rng(3)
    for change in (0.0, 0.02, 0.2):
        rate = 12.0 * 0.01 * (t + change * t**2 / 10.0)
        y = np.exp(-rate) * np.cos(12.0 * t) + 1e-3 * draw.normal(size=t.size)
        found = identify_modes(t, y)
        low, high = found.interval[0]
        for other in (found.window_interval[0], found.formal_interval[0]):
            assert low <= other[0]
            assert high >= other[1]


def test_a_window_that_is_looked_for_ends_before_the_next_step() -> None:
    """A window from 2.458 to 7.465 s contained a step at 7.305 s."""
    t = np.arange(0.0, 7.5, 0.005)
    rate, zeta, second = 2.0 * np.pi * 1.776, 0.0125, 7.1
    y = 1e-3 * np.random.default_rng(1).normal(size=t.size)
    for begin, height in ((2.4, 1.0), (second, 0.8)):
        since = np.maximum(t - begin, 0.0)
        y += height * (1.0 - np.exp(-zeta * rate * since) * np.cos(rate * since)) * (t >= begin)
    found = analyse_decay(Record(t, y, 'two steps'))
    assert found.record.t[-1] < second
    np.testing.assert_allclose(found.modes.frequency[0], 1.776, rtol=2e-3)
    np.testing.assert_allclose(found.modes.damping_ratio[0], zeta, rtol=0.02)


@pytest.mark.parametrize(
    ('ring', 'cycles'),
    [
        (Ring(5.29, 0.0055, 0.0, 0.0124, 0.041), 113),
        (Ring(7.66, 0.0074, 0.0, 0.0, 0.117), 105),
    ],
)
def test_one_mode_that_depends_on_its_amplitude_is_not_split(ring: Ring, cycles: int) -> None:
    """They were two (5.30 and 5.37 Hz) and three (7.69, 7.75 and 7.92 Hz)."""
    t = np.arange(20 * cycles) / (20.0 * ring.frequency)
    noise = 3e-3 * np.random.default_rng(cycles).standard_normal(t.size)
    found = identify_modes(t, ring.values(t) + noise)
    near = np.flatnonzero(np.abs(found.frequency / ring.frequency - 1.0) < 0.08)
    strong = [k for k in near if found.amplitude[k] > 0.03]
    assert len(strong) == 1, found.frequency[near]
    assert found.verdict[strong[0]] != GOOD
    assert any('amplitude dependent' in reason for reason in found.reasons[strong[0]])


# every physics and every shape of a file, and pairs that were refused or wrong
@pytest.mark.parametrize('seed', range(0, 551, 23))
def test_files_of_strangers_are_good_only_where_it_is_true(seed: int, tmp_path: Path) -> None:
    one = judged_file(seed, tmp_path)
    assert not one.is_false_good, one.said
    assert one.verdict != 'refused' or not one.record.is_clean, one.said


def test_a_campaign_has_forty_kinds_and_more() -> None:
    pairs = {(seed % len(PHYSICS), seed % len(SHAPES)) for seed in range(500)}
    assert len(pairs) > 40 + KINDS
