"""A seven-axis position-controlled arm with a steel strip in its hand, 0.25 m in 0.44 s."""

from __future__ import annotations

import numpy as np
import pytest
from panda_strip import ACCELERATION, DURATION, JERK, panda_strip, plain_motion
from shaped_runs import swing_after

from denoc_ros.dynamics.driven.joint_limits import JointLimits, joint_limits
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import StateError
from denoc_ros.planning.rest.rest_problem import RestMotion
from denoc_ros.planning.rest.rest_to_rest import rest_to_rest
from denoc_ros.planning.shapers.joint_servo import joint_servo
from denoc_ros.types import Array

TIP = 'strip_tip'


@pytest.fixture(scope='module')
def robot() -> Robot:
    return panda_strip()


@pytest.fixture(scope='module')
def plain(robot: Robot) -> tuple[Array, Array]:
    return plain_motion(robot)


@pytest.fixture(scope='module')
def limits(robot: Robot) -> JointLimits:
    return joint_limits(robot, acceleration=ACCELERATION, jerk=JERK)


@pytest.fixture(scope='module')
def motion(robot: Robot, plain: tuple[Array, Array], limits: JointLimits) -> RestMotion:
    rows = plain[1]
    return rest_to_rest(robot, rows[0], rows[-1], DURATION, limits, robustness=0.1)


def off(robot: Robot, share: float) -> Robot:
    return robot.with_overrides({'beam.strip.y.ei': 1.4 * (1.0 + share) ** 2})


@pytest.mark.parametrize(('share', 'most'), [(0.0, 0.05), (-0.1, 0.15), (0.1, 0.15)])
def test_swing_is_gone_in_the_plain_motions_time(
    robot: Robot, plain: tuple[Array, Array], motion: RestMotion, share: float, most: float
) -> None:
    t, q = plain
    true = off(robot, share)
    assert robot.natural_frequencies(robot.static_deflection(q[0]))[0] == pytest.approx(3.09, 0.01)
    before, after = swing_after(true, t, q, TIP), swing_after(true, t, motion.joints(t), TIP)
    assert before > 0.06
    assert after <= most * before  # measured: 0.0004, 0.11 and 0.01


def test_arms_limits_are_kept(motion: RestMotion, limits: JointLimits) -> None:
    t = np.linspace(0.0, DURATION, 2001)
    for order, limit in ((1, limits.velocity), (2, limits.acceleration), (3, limits.jerk)):
        assert (np.abs(motion.joints(t, order)).max(axis=0) <= 1.005 * limit).all()
    torque, _ = motion_torque(motion)
    assert (np.abs(torque).max(axis=0) <= 1.01 * limits.effort).all()


def motion_torque(motion: RestMotion) -> tuple[Array, Array]:
    states = motion.states
    return panda_strip().hybrid_dynamics(states.q, states.qd, motion.joints(motion.t, 2))


def test_known_servo_between_plan_and_joints_changes_little(
    robot: Robot, plain: tuple[Array, Array], motion: RestMotion
) -> None:
    servo = joint_servo(7, 5.0, 0.5, 0.004)
    step = 5e-4
    t = np.arange(-servo.preaction, DURATION + 1.0, step)
    command, rate, change = servo.command(t, motion.joints)
    np.testing.assert_allclose(np.gradient(command, step, axis=0)[1:-1], rate[1:-1], atol=0.05)
    # but where the spline's fourth derivative jumps, at knots
    off = np.abs(np.gradient(rate, step, axis=0) - change)
    assert np.quantile(off, 0.99) < 0.01 * np.abs(change).max()
    reached = servo.response(t, command)
    np.testing.assert_allclose(reached, motion.joints(t), atol=2e-4)
    # a lag adds nothing to a quiet mode, but its own transient outlasts the motion
    before = swing_after(robot, *plain, TIP)
    assert swing_after(robot, t, reached, TIP, since=DURATION) <= 0.10 * before
    unknown = servo.response(t, motion.joints(t))
    assert swing_after(robot, t, unknown, TIP, since=DURATION) > 0.1 * before


def test_wrong_servos_are_refused() -> None:
    with pytest.raises(StateError, match='bandwidth must be > 0, got'):
        joint_servo(2, 0.0)
    with pytest.raises(StateError, match='delay must be >= 0 s, got'):
        joint_servo(2, 5.0, 0.5, -0.1)
    with pytest.raises(StateError, match='damping must have 1 or 2 elements'):
        joint_servo(2, 5.0, (0.5, 0.5, 0.5))
    assert joint_servo(3).is_exact
    assert not joint_servo(3, delay=0.01).is_exact
