"""Circles as references of mechanisms (section 5.5): followed by rigid torques, and refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from book_runs import CONFIG, desired, joints, shipped, until
from mechanism_runs import loaded
from mechanisms import START

import denoc_ros as dn
from denoc_ros.cli.session.session_config import read_yaml
from denoc_ros.errors import ConfigError
from denoc_ros.simulation.reference_motion import Circle, follow
from denoc_ros.simulation.scenario import scenario_from_config

CIRCLE = Circle('tool', np.array([0.25, 0.1443, 0.0]), 0.06, 1.0)


def test_joints_on_the_circle_are_closed_and_consistent() -> None:
    robot, scenario = shipped('planar_3dof_3rr', 'planar_3dof_circle')
    assert scenario.reference is not None
    h = 1e-4
    q, qd, qdd = np.zeros((3, 3, robot.n))
    for k, t in enumerate((0.4 - h, 0.4, 0.4 + h)):
        scenario.reference.sample(t, q[k], qd[k], qdd[k])
        assert np.max(np.abs(robot.closure(q[k]))) <= 1e-8  # quintics between closed knots
        pose = robot.frame_pose('tool', q[k])
        np.testing.assert_allclose(pose[:3, 3], CIRCLE.sample(t)[0], atol=1e-8)
        np.testing.assert_allclose(pose[:2, 0], [np.cos(np.pi / 6), 0.5], atol=1e-8)
    np.testing.assert_allclose((q[2] - q[0]) / (2 * h), qd[1], atol=1e-5)  # h^2 q''' / 6
    np.testing.assert_allclose((qd[2] - qd[0]) / (2 * h), qdd[1], atol=1e-3)


def test_rigid_torques_carry_the_rigid_manipulator_along_the_circle() -> None:
    robot, scenario = shipped('planar_3dof_3rr', 'planar_3dof_circle')
    short = until(scenario, 0.4)
    run = short.run(robot)
    meant = desired(scenario)[: len(run.t)]
    assert np.ptp(meant[:, 0]) > 0.3  # it has moved
    # open loop: errors of the knots' quintics and of the integrator, grown a hundredfold
    assert np.max(np.abs(joints(robot, run) - meant)) <= 1e-6
    passive = [
        k for k, name in enumerate(robot.joint_names) if name[-2:] not in ('11', '12', '13')
    ]
    assert np.all(run.torque[:, passive] == 0.0)


def test_a_circle_out_of_reach_is_a_solver_error_with_the_place() -> None:
    robot = loaded('planar_3dof', '3RR')
    far = Circle('tool', np.array([2.0, 0.0, 0.0]), 0.06, 1.0)
    with pytest.raises(dn.SolverError, match=r"frame 'tool' must reach \[2.06, 0.0, 0.0\] m"):
        follow(robot, far, START['planar_3dof'])


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'actuated': ['elbow']}, 'actuated must be some of joint_11, .*where there are loops'),
        ({'radius': -1.0}, r"circle's radius must be a number \(radius, duration > 0\), got -1.0"),
        ({'turns': 'many'}, "circle's turns must be a number .*, got 'many'"),
        ({'centre': [0.0, 0.0]}, r"circle's centre must be three numbers \[m\], got \[0.0, 0.0\]"),
        ({'frame': 'hand'}, "circle's frame must be one of the robot's, got 'hand'"),
        ({'speed': 1.0}, "circle's keys must be of kind, .*, got 'speed'"),
        ({'guess': {'elbow': 1.0}}, "circle's guess must name some of joint_11, .*, got 'elbow'"),
    ],
)
def test_a_bad_circle_is_refused(change: dict[str, Any], message: str) -> None:
    values = read_yaml(CONFIG / 'scenarios' / 'planar_3dof_circle.yaml')
    torque = values['torque']
    where = torque if 'actuated' in change else torque['reference']
    where.update(change)
    robot = loaded('planar_3dof', '3RR')
    with pytest.raises(ConfigError, match=message):
        scenario_from_config(values, robot, 'circle')


def test_static_amplitudes_are_refused_with_loops() -> None:
    values = {'start': {'amplitudes': 'static'}, 'duration': 1.0}
    with pytest.raises(
        ConfigError, match='amplitudes must be zero or given where there are loops'
    ):
        scenario_from_config(values, loaded('planar_3dof', '3RR'), 'static')
