"""What a tick does in one compiled call is what the verbs that it stands for do one by one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from denoc_ros.dynamics.driven.torque_feedforward import Terms, TorqueFeedforward
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.dynamics.stepper import Stepper
from denoc_ros.errors import StateError
from denoc_ros.estimation.joint_tracker import TrackingFilter, joining_acceleration
from denoc_ros.estimation.observer import Observer
from denoc_ros.estimation.observer_settings import ObserverSettings
from denoc_ros.types import Array

ROBOTS = Path(__file__).parents[3] / 'config' / 'robots'
STEP = 1e-3  # s
TICKS = 120


@pytest.fixture(scope='module', params=['ssrms', 'canadarm'])
def robot(request: pytest.FixtureRequest) -> Robot:
    return load_robot(ROBOTS / f'{request.param}.urdf', gravity=(0.3, -1.0, -9.0))


def moving(robot: Robot, t: float) -> tuple[Array, Array, Array]:
    """Return positions, rates and accelerations of the joints at a time [s]."""
    phase = np.arange(len(robot.joint_names))
    q, qd = 0.2 * np.sin(3.0 * t + phase), 0.6 * np.cos(3.0 * t + phase)
    return q, qd, -9.0 * q


def intervals(seed: int) -> Array:
    """Return times between ticks [s], of a loop that is late now and then."""
    generator = np.random.default_rng(seed)
    late = generator.integers(0, 8, TICKS) == 0
    jitter = generator.uniform(0.7, 1.3, TICKS)
    return np.asarray(STEP * np.where(late, generator.integers(2, 6, TICKS), jitter))


def require_same(found: Sequence[Array], expected: Sequence[Array]) -> None:
    """Require states to be the same but for the rounding of their accelerations.

    A compiler may take `first + share * change` as one operation, which rounds once.
    """
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-12 * np.abs(other).max())


def test_several_steps_are_as_many_single_ones(robot: Robot) -> None:
    count, first = 7, moving(robot, 0.1)[2]
    change = 0.3 * moving(robot, 0.4)[0]
    tau = np.linspace(-2.0, 2.0, robot.n)
    together, one_by_one = Stepper(robot.copy(), STEP), Stepper(robot.copy(), STEP)
    q, qd = 0.01 * np.ones(robot.n), 0.1 * np.ones(robot.n)
    expected, expected_rate = q.copy(), qd.copy()
    together.drive(q, qd, first, change, count * STEP, count, tau)
    one_by_one.step = count * STEP / count
    for k in range(count):
        given = first + (k + 0.5) / count * change
        one_by_one.driven(expected, expected_rate, given, tau)
    require_same((q, qd), (expected, expected_rate))


def test_steps_take_lists_and_refuse_other_lengths(robot: Robot) -> None:
    stepper, (_, _, qdd) = Stepper(robot.copy(), STEP), moving(robot, 0.1)
    q, qd, listed, listed_rate = np.zeros((4, robot.n))
    stepper.driven(q, qd, qdd)
    stepper.driven(listed, listed_rate, qdd.tolist())  # type: ignore[arg-type]
    assert np.array_equal(q, listed)
    assert np.array_equal(qd, listed_rate)
    with pytest.raises(StateError, match='must be float64 arrays'):
        stepper.driven(q, qd, qdd[:-1])
    with pytest.raises(StateError, match='must be finite'):
        stepper.driven(q, qd, np.full(len(qdd), np.nan))


def test_torque_at_once_is_that_of_the_dynamics(robot: Robot) -> None:
    joints = robot.joint_indices
    motion = moving(robot, 0.3)
    q, qd = 0.01 * np.ones(robot.n), 0.02 * np.ones(robot.n)
    qdd, torque = np.zeros(robot.n), np.zeros(len(joints))
    Stepper(robot.copy(), STEP).torque(motion, q, qd, qdd, torque)
    expected, accelerations = np.zeros(robot.n), np.zeros(robot.n)
    for rows, values in zip((q, qd, qdd), motion, strict=True):
        assert np.array_equal(rows[joints], values)
    Stepper(robot.copy(), STEP).accelerations(q, qd, motion[2], accelerations)
    require_same((qdd,), (accelerations,))
    robot.inverse_dynamics(q, qd, qdd, out=expected)
    # the same sum in another order
    np.testing.assert_allclose(torque, expected[joints], rtol=1e-11, atol=1e-9)
    assert np.abs(expected[robot.flexible_indices]).max() < 1e-8 * np.abs(torque).max()


def test_feedforward_is_the_composition_of_its_verbs(robot: Robot) -> None:
    source = TorqueFeedforward(robot.copy(), step=STEP)
    plain, stepper = robot.copy(), Stepper(robot.copy(), STEP)
    joints, elapsed, t = robot.joint_indices, intervals(1), 0.0
    source.update(*moving(robot, t), 0.0)
    q, qd, before = source.q.copy(), source.qd.copy(), moving(robot, t)[2]
    qdd = np.zeros(robot.n)
    for duration in elapsed:
        t += duration
        motion = moving(robot, t)
        torque = source.update(*motion, duration)
        count = max(1, round(duration / STEP))
        stepper.step = duration / count
        middle, most = 0.5 * (before + motion[2]), np.abs(before) + np.abs(motion[2])
        # the joints' rates change as the motion's do
        mean = np.clip((motion[1] - qd[joints]) / duration, middle - most, middle + most)
        for k in range(count):
            stepper.driven(q, qd, mean + ((k + 0.5) / count - 0.5) * (motion[2] - before))
        before = motion[2]
        q[joints], qd[joints] = motion[:2]
        stepper.accelerations(q, qd, motion[2], qdd)
        require_same((source.q, source.qd, source.qdd), (q, qd, qdd))
        expected = plain.inverse_dynamics(q, qd, qdd)[joints]
        np.testing.assert_allclose(torque, expected, rtol=1e-11, atol=1e-9)


def test_terms_sum_up_to_the_torque_at_once(robot: Robot) -> None:
    motion = moving(robot, 0.2)
    still = (motion[0], np.zeros(len(motion[0])), np.zeros(len(motion[0])))

    def torque(terms: Terms) -> Array:
        source = TorqueFeedforward(robot.copy(), terms=terms, step=STEP)
        source.update(*still, 0.0)
        return np.array(source.update(*motion, STEP))

    without = torque(Terms(friction=False))
    friction = torque(Terms(inertia=False, coriolis=False, gravity=False))
    np.testing.assert_allclose(torque(Terms()), without + friction, rtol=1e-9, atol=1e-7)


@pytest.mark.parametrize('has_rate', [True, False])
def test_observer_is_the_composition_of_filter_and_steps(robot: Robot, has_rate: bool) -> None:
    settings = ObserverSettings(step=STEP)
    observer = Observer(robot.copy(), settings)
    stepper = Stepper(robot.copy(), STEP)
    tracked = TrackingFilter(len(robot.joint_names), settings.cutoff)
    joints, t = robot.joint_indices, 0.0

    def measured(t: float) -> tuple[Array, Array | None]:
        q, qd, _ = moving(robot, t)
        return q, qd if has_rate else None

    observer.measure(t, *measured(t))
    tracked.reset(*measured(t))
    q, qd = observer._q.copy(), observer._qd.copy()
    for interval in intervals(2):
        before, t = t, t + interval
        observer.measure(t, *measured(t))
        interval = t - before  # as the observer has it, to the last digit
        tracked.update(*measured(t), interval)
        states = (q[joints], qd[joints]), (tracked.q, tracked.qd)
        way = joining_acceleration(interval, *states, 2.5 * STEP)
        count = max(1, int(np.ceil(interval / STEP - 1e-6)))
        stepper.step = interval / count
        for k in range(count):
            stepper.driven(q, qd, way((k + 0.5) * stepper.step))
        q[joints], qd[joints] = tracked.q, tracked.qd
        require_same((observer._q, observer._qd), (q, qd))
        observer.tick(t + 0.4 * STEP)
        ahead, ahead_rate = observer._q.copy(), observer._qd.copy()
        stepper.step = t + 0.4 * STEP - t
        stepper.driven(ahead, ahead_rate, tracked.qdd)
        require_same((observer.q, observer.qd), (ahead, ahead_rate))
