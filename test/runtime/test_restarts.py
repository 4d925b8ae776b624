"""What an estimate that started again says, and until when."""

from __future__ import annotations

import math

import numpy as np
import pytest
from gauge_runs import load
from segmented_robots import strip

from denoc_ros.dynamics.elastic.state_bounds import StateBounds
from denoc_ros.dynamics.robot import Robot
from denoc_ros.runtime.loop.status import ERROR, OK, WARN, Status
from denoc_ros.runtime.safety.restarts import SETTLED_SHARE, Restarts

CAUSE = 'a gap in joint_states'


def restarts_of(robot: Robot) -> Restarts:
    return Restarts(StateBounds(robot, np.zeros(robot.n)))


def report(restarts: Restarts, now: float, values: int = 0, amplitudes: int = 4) -> Status:
    status = Status('observer', message='estimating')
    restarts.worsen(status, now, values, amplitudes)
    return status


def test_an_estimate_that_did_not_start_again_says_nothing() -> None:
    assert report(restarts_of(load('canadarm')), 100.0).level == OK


def test_the_missing_share_is_that_of_the_decay_and_ends_with_it() -> None:
    restarts = restarts_of(load('canadarm'))
    assert restarts.bounds is not None
    decay = restarts.bounds.decay_time
    restarts.note_restart(CAUSE, 10.0)
    for share in (1.0, 0.5, 1.1 * SETTLED_SHARE):
        now = 10.0 - decay * math.log(share)
        assert restarts.missing(now) == pytest.approx(share)
        status = report(restarts, now)
        assert status.level == WARN
        assert f'({CAUSE}): up to {100.0 * share:.0f} % of the vibration' in status.message
        left = decay * math.log(share / SETTLED_SHARE)
        assert status.message.endswith(f'below 5 % in {left:.3g} s')
    assert report(restarts, 10.0 - decay * math.log(0.9 * SETTLED_SHARE)).level == OK
    assert restarts.missing(10.0) == 0.0


def test_without_damping_it_lasts_until_a_reset() -> None:
    restarts = restarts_of(strip(1))
    restarts.note_restart(CAUSE, 0.0)
    assert report(restarts, 1e6).message.endswith('until sensors correct it or ~/reset')
    restarts.clear()
    assert report(restarts, 1e6).level == OK


def test_sensors_correct_it_in_a_period_with_a_value_for_each_amplitude() -> None:
    restarts = restarts_of(strip(1))
    assert restarts.bounds is not None
    period = restarts.bounds.longest_period
    restarts.note_restart(CAUSE, 0.0, values=100)
    assert report(restarts, 0.9 * period, values=200).level == WARN
    assert report(restarts, 2.0 * period, values=103).level == WARN
    assert report(restarts, 2.0 * period, values=104).level == OK


def test_a_failure_is_an_error_in_one_report() -> None:
    restarts = restarts_of(strip(1))
    restarts.note_failure('strip: it bent')
    restarts.note_restart('strip: it bent', 0.0)
    status = report(restarts, 0.5)
    assert status.level == ERROR
    assert status.message.startswith('strip: it bent: not published')
    assert status.message.count('strip: it bent') == 1
    after = report(restarts, 1.5)
    assert after.level == WARN
    assert '(strip: it bent)' in after.message
    assert restarts.failures == 1


def test_what_does_not_vibrate_misses_nothing() -> None:
    restarts = Restarts(None)
    restarts.note_restart(CAUSE, 0.0)
    assert report(restarts, 0.0).level == OK
