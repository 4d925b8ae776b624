"""What keeps a robot safe, without ROS."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from denoc_ros.errors import SolverError
from denoc_ros.runtime.inputs.input_monitor import InputError, InputMonitor
from denoc_ros.runtime.inputs.message_readers import LARGEST_EFFORT
from denoc_ros.runtime.loop.rate_limiter import Backoff
from denoc_ros.runtime.safety.torque import (
    CarryingTorque,
    SafeCommand,
    TorqueLimiter,
    effort_limits,
)

ANY_FLOAT = st.floats(allow_nan=True, allow_infinity=True, width=64)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(ANY_FLOAT, ANY_FLOAT), min_size=1, max_size=20))
def test_only_finite_torque_within_limits_and_rate_ever_leaves(
    torques: list[tuple[float, float]],
) -> None:
    limits = np.array([5.0, 0.5])
    limiter = TorqueLimiter(limits, max_delta=0.3)
    before = np.zeros(2)
    for torque in torques:
        after = limiter.apply(np.array(torque)).copy()
        assert np.isfinite(after).all()
        assert (np.abs(after) <= limits).all()
        assert (np.abs(after - before) <= 0.3 + 1e-12).all()
        before = after


def test_torque_within_everything_passes_unchanged_and_uncounted() -> None:
    limiter = TorqueLimiter(np.array([10.0, 10.0]), max_delta=8.0)
    for torque in ([3.3, -0.1], [-4.4, 7.7]):
        np.testing.assert_allclose(limiter.apply(np.array(torque)), torque, rtol=1e-15)
    assert limiter.clamped.sum() == 0
    limiter.apply(np.array([20.0, 7.7]))
    assert limiter.clamped.tolist() == [1, 0]


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(st.sampled_from('arl'), ANY_FLOAT, ANY_FLOAT), max_size=20))
def test_no_order_of_calls_lets_anything_else_leave(
    calls: list[tuple[str, float, float]],
) -> None:
    limiter = TorqueLimiter(np.full(2, math.inf), max_delta=math.inf)
    for what, *values in calls:
        if what == 'r':
            limiter.reset(np.array(values))
        elif what == 'l' and all(value >= 0.0 for value in values):
            limiter.take_limits(np.array(values))
        left = limiter.apply(np.array(values))
        assert np.isfinite(left).all()
        assert (np.abs(left) <= np.minimum(limiter.limits, LARGEST_EFFORT)).all()
    assert limiter.apply(np.zeros(2)).tolist() == [0.0, 0.0]


def test_a_number_that_is_no_torque_is_not_remembered() -> None:
    limiter = TorqueLimiter(np.full(2, math.inf), math.inf)
    limiter.apply(np.array([2.0, 3.0]))
    for bad in (math.nan, math.inf, 1e301):
        limiter.reset(np.array([bad, 1.0]))
        assert limiter.apply(np.array([1.0, bad])).tolist() == [2.0, 3.0]
    assert limiter.non_finite == 6


def test_new_limits_are_gone_to_by_the_change_per_tick() -> None:
    limiter = TorqueLimiter(np.array([10.0]), max_delta=2.0)
    for _ in range(5):
        limiter.apply(np.array([10.0]))
    limiter.take_limits(np.array([5.0]))
    assert [float(limiter.apply(np.array([9.0]))[0]) for _ in range(4)] == [8.0, 6.0, 5.0, 5.0]
    limiter.take_limits(np.array([4.0]))
    assert limiter.apply(np.array([math.nan]))[0] == 4.0
    for wrong in ([-1.0], [math.nan]):
        with pytest.raises(ValueError, match='effort limits must be >= 0'):
            limiter.take_limits(np.array(wrong))
    with pytest.raises(ValueError, match='max_delta must be > 0'):
        TorqueLimiter(np.array([1.0]), math.nan)


class Weights:
    """Stands for a model whose weight overflows or fails in some postures."""

    looked = 0
    swinging = False

    def gravity(self, posture: Any) -> Any:
        self.looked += 1
        if self.swinging:
            return np.array([math.nan])
        if posture[0] > 1.0:
            raise SolverError('the loops must close')
        return np.array([math.inf if posture[0] < 0.0 else 7.0])


def test_a_posture_without_weight_leaves_the_last_one_that_had_one() -> None:
    carrying, weights = CarryingTorque(1), Weights()
    assert carrying.update(weights, np.array([2.0]), 0.0)  # type: ignore[arg-type]
    assert not carrying.found
    assert not carrying.update(weights, np.array([0.5]), 10.0)  # type: ignore[arg-type]
    for time, posture in ((20.0, 2.0), (30.0, -1.0)):
        assert carrying.update(weights, np.array([posture]), time)  # type: ignore[arg-type]
        assert carrying.found
        assert (carrying.posture[0], carrying.torque[0]) == (0.5, 7.0)
    assert not carrying.update(weights, np.array([-1.0]), 40.0)  # type: ignore[arg-type]
    assert carrying.failure  # the same again
    other = Weights()  # a model that was read anew may carry it
    assert carrying.update(other, np.array([-1.0]), 50.0)  # type: ignore[arg-type]
    assert other.looked == 1


def test_a_robot_that_stands_still_is_carried_again_when_its_model_has_settled() -> None:
    carrying, weights, posture = CarryingTorque(1), Weights(), np.array([0.5])
    weights.swinging = True  # amplitudes beyond all numbers, for a while
    assert carrying.update(weights, posture, 0.0)  # type: ignore[arg-type]
    weights.swinging = False
    assert not carrying.update(weights, posture, 10.0)  # type: ignore[arg-type]
    assert carrying.found
    assert not carrying.failure


def test_failing_attempts_take_a_share_of_the_time() -> None:
    backoff = Backoff(share=0.1, longest=0.25)
    assert backoff.due(1.0)
    backoff.failed(1.0, cost=0.01)
    assert not backoff.due(1.09)
    assert backoff.due(1.11)
    backoff.failed(2.0, cost=5.0)
    assert backoff.due(2.26)


def test_non_finite_torque_is_counted_and_the_last_one_leaves_again() -> None:
    limiter = TorqueLimiter(np.full(1, math.inf), math.inf)
    limiter.apply(np.array([2.0]))
    assert limiter.apply(np.array([np.nan]))[0] == 2.0
    assert limiter.non_finite == 1


@pytest.mark.parametrize(
    ('action', 'at_half', 'at_end'),
    [('hold', 4.0, 4.0), ('zero', 0.0, 0.0), ('ramp_to_gravity', 3.0, 2.0)],
)
def test_safe_command_goes_where_its_action_says(
    action: str, at_half: float, at_end: float
) -> None:
    safe, gravity = SafeCommand(action, 0.5, 1), np.array([2.0])
    safe.begin(10.0, np.array([4.0]))
    safe.begin(10.1, np.array([99.0]))  # already active: no new start
    for time, expected in ((10.25, at_half), (11.0, at_end)):
        torque = safe.torque(time, gravity)
        assert torque is not None
        assert torque[0] == pytest.approx(expected)
    assert safe.settled(10.5)
    safe.end()
    assert not safe.active


def test_stop_publishing_is_silent() -> None:
    safe = SafeCommand('stop_publishing', 0.5, 1)
    safe.begin(0.0, np.array([4.0]))
    assert safe.torque(1.0, np.array([2.0])) is None
    with pytest.raises(ValueError, match='stale_action must be one of'):
        SafeCommand('panic', 0.5, 1)


def test_a_stamp_that_goes_back_is_refused_until_reset() -> None:
    monitor = InputMonitor('joint_states')
    monitor.accept(99, now=1.0)
    monitor.accept(100, now=1.1)
    with pytest.raises(InputError, match='must be new') as repeated:
        monitor.accept(100, now=1.15)
    assert repeated.value.cause == 'duplicate'
    with pytest.raises(InputError, match='must not go back') as caught:
        monitor.accept(99, now=1.2)
    assert caught.value.cause == 'backwards_stamp'
    assert monitor.age(1.3) == pytest.approx(0.2)
    monitor.accept(None, now=1.25)  # it has none: it is for now
    with pytest.raises(InputError, match='after 100 ns'):
        monitor.accept(99, now=1.2)
    monitor.reset()
    assert not monitor.received
    assert monitor.age(1.3) == math.inf
    monitor.accept(1, now=2.0)
    assert monitor.accepted == 4


def test_more_publishers_than_allowed_are_refused() -> None:
    monitor = InputMonitor('reference', max_publishers=2)
    monitor.check_publishers(2)
    with pytest.raises(InputError, match='at most 2 publishers, got 3'):
        monitor.check_publishers(3)


def test_effort_limits_are_the_models_unless_given_or_not_enforced() -> None:
    joints = ['a', 'b']
    assert effort_limits([], [1.0, 2.0], joints, True).tolist() == [1.0, 2.0]
    assert effort_limits([3.0, 4.0], [1.0, 2.0], joints, True).tolist() == [3.0, 4.0]
    assert effort_limits([3.0, 4.0], [1.0, 2.0], joints, False).tolist() == [math.inf] * 2
    with pytest.raises(ValueError, match='must have 2 elements'):
        effort_limits([3.0], [1.0, 2.0], joints, True)
