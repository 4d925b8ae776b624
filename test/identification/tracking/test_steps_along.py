"""Steps along a motion of the joints in one call are those taken one by one."""

from __future__ import annotations

import math

import numpy as np
import pytest
from truth_robots import truth_case

import denoc_ros as dn
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.stepper import Stepper, StepsAlong
from denoc_ros.errors import ModelError, StateError
from denoc_ros.types import Array

STEP = 5e-4
ROWS = 6


@pytest.fixture(scope='module')
def robot() -> Robot:
    """Two joints, one of them elastic, and a link that bends."""
    return truth_case(99).robot


def motion(robot: Robot) -> tuple[Array, Array, Array]:
    """Return states with joints alone, intervals, and accelerations of the joints."""
    draw = np.random.default_rng(3)
    states, accelerations = np.zeros((2, 2, ROWS, robot.n))
    index = robot.joint_indices
    states[:, :, index] = draw.uniform(-1.0, 1.0, (2, ROWS, len(index)))
    states[0, 0] += 1e-3 * draw.standard_normal(robot.n)
    accelerations[:, :, index] = draw.uniform(-5.0, 5.0, (2, ROWS, len(index)))
    # 1, 10 and 11 steps; the first interval leads to no row
    return states, STEP * np.array([0.0, 0.7, 10.0, 10.0 + 1e-8, 10.3, 11.0]), accelerations


def one_by_one(robot: Robot, states: Array, intervals: Array, accelerations: Array) -> Array:
    """Return the states by a call for each step."""
    stepper, index = Stepper(robot.copy(), STEP), robot.joint_indices
    found: Array = states.copy()
    for row in range(1, ROWS):
        q, qd = found[:, row - 1].copy()
        count = math.ceil(intervals[row] / STEP - 1e-6)
        stepper.step = intervals[row] / count
        for k in range(count):
            middle = (k + 0.5) * stepper.step - 0.5 * intervals[row]
            mean, slope = accelerations[:, row, index]
            stepper.driven(q, qd, mean + middle * slope)
        free = np.setdiff1d(np.arange(robot.n), index)
        found[0, row, free], found[1, row, free] = q[free], qd[free]
    return found


def test_steps_along_a_motion_are_those_taken_one_by_one(robot: Robot) -> None:
    states, intervals, accelerations = motion(robot)
    wanted = one_by_one(robot, states, intervals, accelerations)
    assert np.abs(wanted[:, 1:, robot.flexible_indices]).min() > 1e-6
    StepsAlong(robot.copy(), STEP).write(states, intervals, accelerations, 1, ROWS)
    # sums and products in another order
    np.testing.assert_allclose(states, wanted, rtol=1e-9, atol=1e-12)


def test_rows_that_are_not_asked_for_stay(robot: Robot) -> None:
    states, intervals, accelerations = motion(robot)
    given = states.copy()
    StepsAlong(robot.copy(), STEP).write(states, intervals, accelerations, 2, 4)
    stays = np.array([0, 1, 4, 5])
    np.testing.assert_array_equal(states[:, stays], given[:, stays])
    assert (states[:, 2:4] != given[:, 2:4]).any()


@pytest.mark.parametrize(('first', 'last'), [(0, 3), (1, ROWS + 1)])
def test_rows_beyond_the_motion_are_refused(robot: Robot, first: int, last: int) -> None:
    steps = StepsAlong(robot.copy(), STEP)
    with pytest.raises(StateError, match=rf'rows be in 1 \.\. {ROWS}, got .* {first} \.\. {last}'):
        steps.write(*motion(robot), first, last)


def test_other_shapes_are_refused(robot: Robot) -> None:
    states, intervals, accelerations = motion(robot)
    with pytest.raises(StateError, match='states and accelerations must have shape'):
        StepsAlong(robot.copy(), STEP).write(states[:, 1:].copy(), intervals, accelerations, 1, 3)


@pytest.mark.parametrize('interval', [np.nan, 0.0, -1e-3])
def test_an_interval_that_is_none_is_refused(robot: Robot, interval: float) -> None:
    states, intervals, accelerations = motion(robot)
    intervals[3] = interval
    with pytest.raises(StateError, match='must be finite'):
        StepsAlong(robot.copy(), STEP).write(states, intervals, accelerations, 1, ROWS)


def test_robots_with_mimic_joints_are_refused() -> None:
    text = (
        '<robot name="r"><link name="a"/><link name="b"><inertial><mass value="1"/>'
        '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>'
        '<link name="c"><inertial><mass value="1"/>'
        '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>'
        '<joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint>'
        '<joint name="k" type="continuous"><parent link="b"/><child link="c"/>'
        '<mimic joint="j"/></joint></robot>'
    )
    with pytest.raises(ModelError, match='must have no loops or mimic joints'):
        StepsAlong(dn.load_robot(text), STEP)
