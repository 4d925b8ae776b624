"""What a record is worth, and where it decays, steps and rests."""

from __future__ import annotations

import numpy as np
import pytest
from book.selftest import Defects, Truth, synthetic_decay
from numpy.typing import NDArray

from denoc_ros.identification.decay.record_segments import find_segments
from denoc_ros.identification.decay.records import Record, assess

Floats = NDArray[np.float64]


def ring(seed: int = 1, clip: float = 0.0, lsb: float = 0.0) -> Record:
    defects = Defects(snr_db=40.0, jitter=0.1, lost=0.05, clip=clip, lsb=lsb)
    return synthetic_decay([Truth(3.0, 0.02)], 200.0, 6.0, defects, seed).record


def test_rate_gaps_jitter_and_noise_are_those_that_were_put_in() -> None:
    quality = assess(ring())
    assert quality.rate == pytest.approx(200.0, rel=0.01)
    # 5 % of 1200 samples lost at random: 60 +- 8
    assert 0.03 < quality.lost < 0.07
    assert 20 < quality.gaps < 80
    # stamps of 10 % each: steps of sqrt(2) of that, clipped by the limit of a gap
    assert quality.jitter == pytest.approx(0.14, abs=0.02)
    # 40 dB; third differences of 3 Hz at 200 Hz add 3 %, lost samples some more
    assert quality.noise == pytest.approx(0.01, rel=0.3)
    assert quality.snr_db == pytest.approx(40.0, abs=3.0)
    assert not quality.clipped.any()
    assert quality.resolution == 0.0


def test_limits_and_levels_of_a_sensor_are_seen() -> None:
    record = ring(clip=0.3, lsb=0.01)
    quality = assess(record)
    at_limit = (record.y == record.y.max()) | (record.y == record.y.min())
    np.testing.assert_array_equal(quality.clipped, at_limit)
    step = 0.01 * np.abs(synthetic_decay([Truth(3.0, 0.02)], 200.0, 6.0).record.y).max()
    assert quality.resolution == pytest.approx(step, rel=0.05)


def test_coarse_levels_alone_are_not_called_clipping() -> None:
    # a crest of 3 Hz at 1 kHz stays on its level of 2 % for twenty samples
    t = np.arange(0.0, 6.0, 0.001)
    y = np.exp(-0.4 * t) * np.cos(2.0 * np.pi * 3.0 * t)
    assert not assess(Record(t, 0.02 * np.round(y / 0.02))).clipped.any()


def test_segments_follow_each_other_as_they_were_made() -> None:
    decay = ring()
    noise = 0.01 * np.random.default_rng(0).standard_normal(400)
    y = np.concatenate((noise, decay.y, 0.5 * decay.y - 0.4))
    t = np.arange(y.size) / 200.0
    found = find_segments(Record(t, y))
    decays = [one for one in found if one.kind == 'decay']
    releases = [2.0, 2.0 + decay.t.size / 200.0]
    cycle = 1.0 / 3.0
    assert [one.start for one in decays] == pytest.approx(releases, abs=cycle)
    assert decays[0].stop == pytest.approx(releases[1], abs=2.0 * cycle)
    assert decays[0].amplitude == pytest.approx(1.0, rel=0.15)
    assert decays[1].level == pytest.approx(-0.4, abs=0.02)
    assert decays[0].frequency == pytest.approx(3.0, rel=0.1)
    rests = [one for one in found if one.kind == 'rest']
    assert rests[0].start == 0.0
    assert rests[0].stop == pytest.approx(2.0, abs=2.0 * cycle)
    steps = [one for one in found if one.kind == 'step']
    assert steps[-1].amplitude == pytest.approx(-0.4, abs=0.05)


def test_noise_is_rest() -> None:
    y = np.random.default_rng(3).standard_normal(1000)
    assert {one.kind for one in find_segments(Record(np.arange(1000.0), y))} <= {'rest'}


def test_part_of_a_record_keeps_its_stamps() -> None:
    record = ring()
    part = record.part(2.0, 3.0)
    assert part.t[0] >= 2.0
    assert part.t[-1] <= 3.0
    assert set(part.t) <= set(record.t)
