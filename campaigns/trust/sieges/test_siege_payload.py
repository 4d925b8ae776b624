"""The laws of what adapts to a payload under a siege, and the robot that it is carried by."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest
from rcl_interfaces.msg import Parameter, ParameterEvent, ParameterValue
from sensor_msgs.msg import JointState
from trust.sieges.siege import with_rests
from trust.sieges.siege_payload import MIDDLE, PAYLOAD, Estimates, Swing


def estimate(value: float, deviation: float = 0.1, name: str = PAYLOAD) -> JointState:
    return JointState(name=[name], position=[value], effort=[deviation])


def asked(name: str, *values: float) -> ParameterEvent:
    """Return what a predictor says of a parameter that somebody has changed."""
    kind = 8 if name == 'adapt_bounds' else 3
    value = ParameterValue(type=kind, double_array_value=list(values), double_value=values[0])
    return ParameterEvent(
        node='/predictor', changed_parameters=[Parameter(name=name, value=value)]
    )


@pytest.mark.parametrize(
    ('message', 'says'),
    [
        (estimate(math.nan), 'finite'),
        (estimate(1.0, math.nan), 'finite'),
        (estimate(1.9), 'within 0.6 to 1.8 kg, got 1.9'),
        (estimate(0.5), 'within'),
        (estimate(math.inf, name='beam.one.y.ei'), 'finite'),
    ],
)
def test_unlawful_estimates_are_seen(message: JointState, says: str) -> None:
    held = Estimates()
    held.take(estimate(1.0))
    held.take(message)
    told = held.told()
    assert any(says in law for law in told), told
    assert not held.told()


def test_bounds_that_somebody_asked_for_count_until_a_new_process() -> None:
    held = Estimates()
    held.take_event(asked('adapt_bounds', 0.2, 3.0))
    held.take(estimate(2.5))
    held.take(estimate(0.3))
    held.take(estimate(9.0, name='beam.one.y.ei'))
    assert not held.told()
    held.restart()
    held.take(estimate(2.5))
    assert held.told()
    assert (held.count, held.lowest, held.highest) == (4, 0.3, 2.5)


def test_a_drift_at_rest_is_seen() -> None:
    held, begin = Estimates(), time.perf_counter()
    held.judge_rest(begin)
    assert any('must say at rest' in law for law in held.told())
    held.take(estimate(1.1))
    held.take(estimate(1.1 + 1e-4))
    held.judge_rest(begin)
    assert not held.told()
    held.take(estimate(1.13))
    held.judge_rest(begin)
    assert any('must not drift at rest, got 0.03' in law for law in held.told())


def test_the_robot_of_the_payload_scene_rests_where_it_has_swung() -> None:
    swing = Swing(100.0)
    states = {t: swing.state(swing.begin + round(1e9 * t)) for t in (1.25, 6.0, 9.0, 11.9, 13.25)}
    assert swing.rested(swing.begin + 2 * 10**9) == 0.0
    assert swing.rested(swing.begin + 11 * 10**9) == pytest.approx(6.0)
    assert np.allclose(states[6.0].position, MIDDLE, atol=1e-4)  # noise of 1e-5 rad
    assert np.abs(np.array(states[1.25].position) - MIDDLE).max() > 0.05
    assert states[13.25].position == states[1.25].position
    # at rest the joints carry the weight alone; noise is 0.4 N m
    assert np.allclose(states[9.0].effort, states[11.9].effort, atol=4.0)


def test_a_rest_comes_after_each_few_steps() -> None:
    drawn = list(with_rests([{'do': 'join', 'node': 'plant', 'seed': k}] for k in range(13)))
    rests = [k for k, step in enumerate(drawn) if step[0]['do'] == 'rest']
    assert rests == [6, 13]
