"""Detection of faulty sensors on a few draws: the short form of `bench.sensor_faults`."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from bench.sensor_faults import (
    CASES,
    FAULT_BEGIN_S,
    SAMPLE_S,
    TICK_S,
    Trial,
    faults_of,
    faulty_gauges,
    observed,
)
from fault_draws import Draw, faulty_streams, in_order

SEEDS = range(8)  # two arms, and all truths
DURATION_S = 6.0
FAULTY_FACTOR = 3.0  # times the error without the faulty sensor
# A seed for each case in which the arm moves soon after the fault.
SEED_OF = {
    'inverted': 5, 'frozen': 5, 'gain 10': 7, 'gain 0.1': 0, 'offset': 1, 'drift': 2, 'noise': 1,
    'delayed': 0, 'full scale': 3, 'unit': 2, 'swapped': 3, 'both of a link': 0,
}  # fmt: skip


@cache
def trial(seed: int) -> Trial:
    return Trial(seed, DURATION_S)


@pytest.mark.parametrize('seed', SEEDS)
def test_no_healthy_sensor_is_excluded_where_the_model_is_off_by_a_fifth(seed: int) -> None:
    alarms = trial(seed).alarms()
    assert alarms.excluded == 0.0
    assert alarms.by_joints == 0.0


@pytest.mark.parametrize('case', CASES)
def test_the_faulty_sensor_is_excluded_and_the_error_is_that_without_it(case: str) -> None:
    finding = trial(SEED_OF[case]).finding(case)
    assert finding.is_named
    assert finding.ratio <= FAULTY_FACTOR


@pytest.mark.parametrize('case', ['inverted', 'offset'])
def test_a_sensor_is_used_again_when_its_fault_has_ended(case: str) -> None:
    own, end = trial(0), 2.5
    faults = faults_of(case, own.scene, own.seed)
    draw = Draw(own.seed, 1.0 / SAMPLE_S, faults)
    (gauge,) = faulty_gauges(faults)
    streams = faulty_streams(draw, own.good, own.scene.signals, own.scene.noise)
    both = zip(streams[gauge], own.good[gauge], strict=True)
    streams[gauge] = [bad if bad.stamp < end else good for bad, good in both]
    excluded = observed(own.scene, in_order(streams)).excluded
    ticks = TICK_S * np.arange(1, len(excluded) + 1)
    place = list(own.scene.noise).index(gauge)
    assert not excluded[ticks < FAULT_BEGIN_S].any()
    assert excluded[(ticks > end - 0.5) & (ticks < end), place].all()
    assert not excluded[-1].any()
