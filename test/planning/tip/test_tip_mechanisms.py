"""Tip-exact motions of closed loops, carried out by their torque alone."""

from __future__ import annotations

import numpy as np
import pytest
from control_runs import ROBOTS, carried_out, cycloid

import denoc_ros as dn
from denoc_ros.dynamics.driven.motion_plan import Plan
from denoc_ros.simulation.reference_motion import Circle, follow

LEGS = ('joint_11', 'joint_12', 'joint_13')
CIRCLE = Circle('tool', np.array([0.25, 0.1443, 0.0]), 0.06, 1.0)
NEAR = {
    'joint_11': 1.092, 'joint_21': -1.629, 'platform_joint': 1.0605987755982988,
    'joint_12': 3.307, 'joint_22': -2.291, 'joint_13': 4.198, 'joint_23': 1.938,
}  # fmt: skip


def loaded(name: str, gravity: float = -9.81) -> dn.Robot:
    return dn.load_robot(ROBOTS / f'{name}.urdf', gravity=(0, gravity, 0))


@pytest.fixture(scope='module')
def platform() -> tuple[dn.Robot, Plan]:
    """The platform of section 5.5 with flexible legs, on its circle."""
    rigid, robot = loaded('planar_3dof_3rr'), loaded('planar_3dof_3ff')
    motion = follow(rigid, CIRCLE, rigid.assemble([NEAR[name] for name in rigid.joint_names]))
    times, joints, _, _ = motion.table(0.01)
    return robot, dn.shape_motion(
        robot, times, joints, joints=LEGS, step=0.0025, output_step=0.00125
    )


@pytest.mark.long
def test_the_platform_follows_its_circle_by_torque_alone(
    platform: tuple[dn.Robot, Plan],
) -> None:
    robot, plan = platform
    run = carried_out(robot, plan, after=0.0, rtol=1e-9)
    wanted = np.array([CIRCLE.sample(float(np.clip(t, 0.0, 1.0)))[0] for t in run.t])
    error = np.linalg.norm(robot.frame_pose('tool', run.q)[:, :3, 3] - wanted, axis=1)
    # the torques of rigid legs: 170 mm off; open loop an error grows by exp(7.9 t)
    assert error[run.t <= 1.0].max() < 1e-4


def test_the_torque_makes_the_planned_accelerations(platform: tuple[dn.Robot, Plan]) -> None:
    robot, plan = platform
    tau = np.zeros_like(plan.q)
    tau[:, robot.indices(plan.joint_names)] = plan.torque
    rows = slice(None, None, 50)
    qdd, _ = robot.constrained_forward_dynamics(plan.q[rows], plan.qd[rows], tau[rows])
    assert np.abs(qdd - plan.qdd[rows]).max() < 5e-4 * np.abs(plan.qdd).max()


def test_loops_stay_closed_in_the_plan(platform: tuple[dn.Robot, Plan]) -> None:
    robot, plan = platform
    assert np.abs(robot.closure(plan.q)).max() < 1e-9
    assert plan.joint_names == LEGS
    assert plan.torque.shape == (len(plan.t), 3)


@pytest.mark.long
def test_the_five_bar_brings_its_pin_where_it_should_be() -> None:
    rigid, robot = loaded('five_bar_rrrr', 0.0), loaded('five_bar_ffff', 0.0)
    start = rigid.assemble([1.884956, -1.256637, 1.256637, 1.256637])
    times = np.linspace(0.0, 1.0, 51)
    joints = np.tile(start, (51, 1))
    joints[:, [0, 2]] = cycloid(start[[0, 2]], start[[0, 2]] - [0.25, 0.1], 1.0)(times)
    # the passive joints are those of the start: the plan closes the loop
    plan = dn.shape_motion(
        robot, times, joints, tip='joint_5/parent', joints=['joint_1', 'joint_3']
    )
    closed = np.array([rigid.assemble(row, fixed=['joint_1', 'joint_3']) for row in joints])
    run = carried_out(robot, plan, after=0.2, rtol=1e-8)
    at = rigid.frame_pose('joint_5/parent', closed)[:, :3, 3]
    reached = robot.frame_pose('joint_5/parent', run.q)[:, :3, 3]
    wanted = np.stack([np.interp(run.t, times, column) for column in at.T], axis=1)
    # 1.4e-8 and 3.5e-9 m, of integrator and equations; a torque 0.1 % off leaves 0.2 mm
    assert np.abs(reached - wanted).max() < 1e-6
    assert plan.tip_error.max() < 1e-6


def test_a_simulation_may_begin_in_the_equilibrium_of_a_stiff_mechanism(
    platform: tuple[dn.Robot, Plan],
) -> None:
    """Nothing moves at first, so the integrator's first trial step is a long one."""
    robot, plan = platform
    tau = np.zeros(robot.n)
    tau[robot.indices(plan.joint_names)] = plan.torque[0]
    times = np.linspace(0.0, 0.1, 3)
    run = dn.simulate(robot, plan.q[0], np.zeros(robot.n), times, lambda t, q, qd: tau)
    assert np.abs(run.q - plan.q[0]).max() < 1e-6
