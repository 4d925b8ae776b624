"""State feedback of an arm with elastic joints, measured on either side of their springs."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from feedback_runs import PERIOD, Loop, Planned, closed, planned_along
from geared_arm import arm_text

import denoc_ros as dn
from denoc_ros.dynamics.driven.measured_side import measured_robot, whole_robot
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import StateError
from denoc_ros.feedback.feedback_settings import FeedbackSettings
from denoc_ros.feedback.gain_schedule import design
from denoc_ros.feedback.planned_states import state_at
from denoc_ros.trajectories import CycloidalTrajectory, SplineTrajectory

DURATION = 1.5  # s
START, WAY = np.array([0.2, 0.5]), np.array([0.8, -0.6])
EFFORT = 200.0  # N m
SETTINGS = FeedbackSettings(period=PERIOD, tip='tool', delay=1.5 * PERIOD)


@cache
def planned(side: str) -> Planned:
    """Return the plan of a motion of the measured sides."""
    motion = CycloidalTrajectory(START, WAY / DURATION, np.full(2, DURATION))
    times, positions, _, _ = motion.table(0.01)
    robot = dn.load_robot(arm_text(side))
    return planned_along(robot, SplineTrajectory(times, positions), 1.0, EFFORT)


def wrong(robot: Robot) -> Robot:
    """Return the robot with softer springs and a heavier fore arm."""
    springs = {'joint.shoulder.stiffness': 0.9 * 1.2e4, 'joint.elbow.stiffness': 0.9 * 5e3}
    return robot.with_overrides(springs).with_scaled_load('tool', 1.2)


@pytest.mark.parametrize('side', ['motor', 'link'])
def test_tip_stays_with_its_plan_on_a_wrong_model(side: str) -> None:
    plan = planned(side)
    truth = wrong(plan.robot)
    alone, loop = Loop(plan, truth, None).run(), closed(plan, truth)
    good = loop.run()
    # 170 mm, and nothing brings it back
    assert alone.rms > 0.1
    assert (good.share[1000:] == 1.0).all()
    # 9.1 mm, and 0.4 mm from half a second after the stop; the gains of the robot without its
    # springs and rotors, which were shown stable, left 15 and 40 mm, and a swing that stays
    assert good.rms < 0.012
    assert good.after(0.5) < 2e-3


def test_nothing_is_added_to_the_torque_of_a_robot_that_does_as_planned() -> None:
    loop = closed(planned('link'), planned('link').robot)
    loop.noise = 0.0
    run = loop.run()
    plan = planned('link').torque[: len(run.torque)]
    # Coulomb friction is not in the gains, and the spring's rate in the plan is 2 % off
    assert np.abs(run.torque - plan).max() < 0.05 * np.abs(plan).max()
    assert run.rms < 5e-4


def test_gains_mean_the_whole_robot_whichever_is_given() -> None:
    whole = dn.load_robot(arm_text('link'))
    seen = measured_robot(whole)
    assert whole_robot(whole) is whole
    again = whole_robot(seen)
    assert again.coordinate_names == whole.coordinate_names
    limits, joints = np.full(2, EFFORT), whole.joint_names
    schedules = [
        design(robot, joints, limits, np.zeros(1), [state_at(robot, joints, START, 0.1 * limits)],
               SETTINGS)
        for robot in (whole, seen)
    ]  # fmt: skip
    for schedule in schedules:
        # where a reference of the link sides is compared with them
        np.testing.assert_allclose(schedule.postures, [START], atol=1e-12)
        assert schedule.slowest.modulus < 1.0
    known, seen_gain = (schedule.gains[0].gain for schedule in schedules)
    np.testing.assert_allclose(known, seen_gain, rtol=1e-6)
    state = state_at(seen, joints, START, 0.1 * limits)
    np.testing.assert_allclose(state.q[::2] + state.q[1::2], START, atol=1e-12)
    np.testing.assert_allclose(state.q, whole.static_deflection(state.q[::2]), atol=1e-7)


def test_measured_rows_are_those_of_the_link_side() -> None:
    whole = dn.load_robot(arm_text('link'))
    joints, limits = whole.joint_names, np.full(2, EFFORT)
    state = state_at(whole, joints, START, 0.1 * limits)
    measured = design(whole, joints, limits, np.zeros(1), [state], SETTINGS).gains[0].measured
    # of motors and springs in turn, then of their rates
    sides = np.kron(np.eye(4), [1.0, 1.0])
    names = [whole.coordinate_names.index(name) for name in ('shoulder', 'elbow')]
    assert names == [0, 2]
    np.testing.assert_array_equal(measured[:, :8], sides)
    assert not measured[:, 8:].any()  # unknown forces are not measured


def test_a_joint_that_stands_behind_its_spring_is_refused() -> None:
    robot, limits = dn.load_robot(arm_text('link')), np.full(1, EFFORT)
    state = state_at(robot, ['elbow'], START[1:], 0.1 * limits)
    told = 'every joint that is measured behind its spring must be driven, got shoulder that is'
    with pytest.raises(StateError, match=told):
        design(robot, ['elbow'], limits, np.zeros(1), [state], SETTINGS)
