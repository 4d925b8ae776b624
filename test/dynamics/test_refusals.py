"""What has no answer is said with the name and the number that is wrong."""

from __future__ import annotations

import numpy as np
import pytest
from strategies import seeded_robot

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import SolverError, StateError


@pytest.fixture(scope='module')
def robot() -> Robot:
    return load_robot(seeded_robot(3))


def flexible(robot: Robot) -> tuple[str, float]:
    """A flexible link and its length."""
    for body in robot.tree.bodies:
        if body.beam is not None and any(body.beam.modes):
            return body.name, body.beam.length
    raise AssertionError('the robot must have a flexible link')


def test_massless_chain_is_singular() -> None:
    text = """<robot name="r"><link name="a"/><link name="b"/>
      <joint name="j" type="continuous"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
      </joint></robot>"""
    robot = load_robot(text)
    with pytest.raises(SolverError, match='inertia must be positive definite'):
        robot.forward_dynamics(np.zeros(1), np.zeros(1), np.ones(1))


def test_payload_must_be_possible(robot: Robot) -> None:
    with pytest.raises(StateError, match='mass must be >= 0'):
        robot.set_payload('l1', -1.0)
    with pytest.raises(StateError, match='mass must be >= 0'):
        robot.set_payload('l1', np.nan)
    with pytest.raises(StateError, match='com must'):
        robot.set_payload('l1', 1.0, (0.0, np.inf, 0.0))
    with pytest.raises(StateError, match='inertia must be symmetric'):
        robot.set_payload('l1', 1.0, (0, 0, 0), np.diag([1.0, 1.0, -1.0]))
    with pytest.raises(StateError, match='nowhere'):
        robot.set_payload('nowhere', 1.0)


def test_refused_payload_changes_nothing(robot: Robot) -> None:
    before = robot.inertia_matrix(np.zeros(robot.n))
    with pytest.raises(StateError):
        robot.set_payload('l1', -1.0)
    np.testing.assert_array_equal(robot.inertia_matrix(np.zeros(robot.n)), before)


def test_payload_on_the_base_is_refused() -> None:
    robot = load_robot('<robot name="r"><link name="a"/></robot>')
    with pytest.raises(StateError, match="'a' must be a link that moves"):
        robot.set_payload('a', 1.0)


def test_station_off_the_beam_is_refused(robot: Robot) -> None:
    link, length = flexible(robot)
    q = np.zeros(robot.n)
    for station in (-0.1, length + 0.1, np.nan):
        with pytest.raises(StateError, match=f'station of {link!r} must be in'):
            robot.tip_deflection(link, q, station=station)
    with pytest.raises(StateError, match='link must be a flexible one'):
        robot.tip_deflection('nowhere', q)


def test_hybrid_takes_one_acceleration_per_joint(robot: Robot) -> None:
    q, count = np.zeros(robot.n), len(robot.joint_names)
    with pytest.raises(StateError, match=rf'qdd_joints must have shape \({count},\)'):
        robot.hybrid_dynamics(q, q, np.zeros(count + 1))
    with pytest.raises(StateError, match='qdd_joints must be finite'):
        robot.hybrid_dynamics(q, q, np.full(count, np.nan))


def test_wrench_must_be_six_finite_numbers(robot: Robot) -> None:
    q = np.zeros(robot.n)
    with pytest.raises(StateError, match='wrench must have shape'):
        robot.forward_dynamics(q, q, q, wrenches={'l1': np.zeros(3)})
    with pytest.raises(StateError, match='wrench must be finite'):
        robot.forward_dynamics(q, q, q, wrenches={'l1': np.full(6, np.nan)})


def test_gravity_must_be_three_finite_numbers() -> None:
    with pytest.raises(StateError, match='gravity must'):
        load_robot(seeded_robot(3), gravity=(0, 0))
    with pytest.raises(StateError, match='gravity must'):
        load_robot(seeded_robot(3), gravity=(0, 0, np.nan))


def test_overflow_is_not_returned(robot: Robot) -> None:
    q = np.zeros(robot.n)
    with pytest.raises(StateError, match='result must be finite'):
        robot.inverse_dynamics(q, np.full(robot.n, 1e200), q)
