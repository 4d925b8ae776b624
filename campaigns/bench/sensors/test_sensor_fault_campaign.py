"""Detection of faulty sensors on a few draws: the short form of `bench.sensors.sensor_faults`."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from bench.sensors.sensor_faults import CASES, ENDING, FAULT_END_S, Trial

SEEDS = range(8)  # two arms, and all truths
DURATION_S = 6.0
LONG_DURATION_S = 22.0  # longer than the longest finite patience
FAULTY_FACTOR = 3.0  # times the error without the faulty sensor
# A seed for each case in which the arm moves soon after the fault.
SEED_OF = {
    'inverted': 5, 'frozen': 5, 'gain 10': 7, 'gain 0.1': 0, 'offset': 1, 'drift': 2, 'noise': 1,
    'delayed': 0, 'full scale': 3, 'unit': 2, 'swapped': 3, 'both of a link': 0,
    'inverted, ends': 0, 'both of a link, ends': 6,
}  # fmt: skip


@cache
def trial(seed: int) -> Trial:
    return Trial(seed, DURATION_S)


@pytest.mark.parametrize('seed', SEEDS)
def test_no_healthy_sensor_is_excluded_where_the_model_is_off_by_a_fifth(seed: int) -> None:
    alarms = trial(seed).alarms()
    assert alarms.excluded == 0.0
    assert alarms.by_joints == 0.0


@pytest.mark.parametrize('case', [case for case in CASES if case not in ENDING])
def test_the_faulty_sensor_is_excluded_and_the_error_is_that_without_it(case: str) -> None:
    finding = trial(SEED_OF[case]).finding(case)
    assert finding.is_named
    assert finding.ratio <= FAULTY_FACTOR


@pytest.mark.parametrize('case', ENDING)
def test_sensors_are_used_again_when_their_fault_has_ended(case: str) -> None:
    finding = trial(SEED_OF[case]).finding(case)
    assert finding.is_named
    assert finding.again < DURATION_S - FAULT_END_S


def test_a_sensor_without_a_second_chance_stays_excluded() -> None:
    own = Trial(SEED_OF['inverted, ends'], LONG_DURATION_S)
    assert own.finding('inverted, ends').again < LONG_DURATION_S - FAULT_END_S
    assert own.finding('inverted, ends', patience=np.inf).again == np.inf
