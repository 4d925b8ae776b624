"""`dn.shape_motion` by input shapers and from rest to rest."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from shaped_runs import cycloid, swing_after

import denoc_ros as dn
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError, StateError

T = np.linspace(0.0, 0.8, 101)
Q = cycloid(T, 0.8)[:, None] * [0.5, 0.8]


def two_links() -> Robot:
    return dn.load_robot('config/robots/two_link_ff.urdf', gravity=(0, -9.81, 0))


@pytest.mark.long_cases('rest_to_rest')
@pytest.mark.parametrize('method', ['zv', 'zvd', 'ei', 'rest_to_rest'])
def test_plan_is_consistent_and_ends_quietly(method: str) -> None:
    robot = two_links()
    more: dict[str, Any] = {'effort': 400.0}
    plan = dn.shape_motion(robot, T + 2.0, Q, method, 'tool', **more)
    joints = robot.joint_indices
    assert plan.method == method
    assert plan.t[0] == pytest.approx(2.0)
    assert plan.t[-1] == pytest.approx(2.8 + plan.delay)
    assert (plan.delay == 0.0) == (method == 'rest_to_rest')
    torque = robot.inverse_dynamics(plan.q, plan.qd, plan.qdd)
    np.testing.assert_allclose(torque[:, joints], plan.torque, atol=1e-6)
    np.testing.assert_allclose(torque[:, robot.flexible_indices], 0.0, atol=1e-6)
    step = plan.t[1] - plan.t[0]
    slope = np.gradient(plan.q, step, axis=0)[2:-2]
    assert np.abs(slope - plan.qd[2:-2]).max() < 0.02 * np.abs(plan.qd).max()
    left = swing_after(robot, plan.t, plan.q[:, joints], 'tool')
    assert left < 0.08 * swing_after(robot, T, Q, 'tool')
    # under gravity the tip hangs below where the undeformed robot has it
    sag = robot.frame_pose('tool', robot.static_deflection(Q[-1]))
    rigid = np.zeros(robot.n)
    rigid[joints] = Q[-1]
    apart = np.linalg.norm((sag - robot.frame_pose('tool', rigid))[:3, 3])
    assert plan.tip_error[-1] == pytest.approx(apart, rel=0.2)
    if method != 'rest_to_rest':  # late, but on its way: half the delay later it is near
        way = np.ptp(robot.frame_pose('tool', plan.q)[:, :3, 3], axis=0)
        assert plan.tip_error.max() < 0.3 * np.linalg.norm(way)


def test_shortest_rest_to_rest_may_be_shorter_than_what_was_asked_for() -> None:
    robot = two_links()
    plan = dn.shape_motion(
        robot, T * 4.0, Q, 'rest_to_rest', duration=0.0, acceleration=20.0, effort=400.0
    )
    assert plan.t[-1] < 3.2
    assert plan.delay == 0.0


def test_what_a_method_does_not_have_is_refused() -> None:
    robot = two_links()
    with pytest.raises(StateError, match=r"options of 'zv' must be of .*'modes'.*, got"):
        dn.shape_motion(robot, T, Q, 'zv', robustness=0.1)
    with pytest.raises(StateError, match='method must be one of tip, zv, zvd, ei, rest_to_rest'):
        dn.shape_motion(robot, T, Q, 'zzz')
    with pytest.raises(SolverError, match="times the velocity limit of 'joint_2'"):
        dn.shape_motion(robot, T, Q, 'zv', velocity={'joint_2': 0.5})
    with pytest.raises(SolverError, match='got cancelled'):
        dn.shape_motion(robot, T, Q, 'rest_to_rest', cancel=lambda: True)
    with pytest.raises(StateError, match='output_step must be > 0 s'):
        dn.shape_motion(robot, T, Q, 'zv', output_step=0.0)
