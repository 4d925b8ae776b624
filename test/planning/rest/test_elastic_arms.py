"""Tip-exact motions of arms with elastic joints: the link side goes as asked by torque alone."""

from __future__ import annotations

import mujoco_arm
import numpy as np
import pytest
from control_runs import Reference, carried_out, strayed
from geared_arm import arm_text

import denoc_ros as dn
from denoc_ros.types import Array

ARMS = {
    'tool': (arm_text(), np.array([0.2, 0.5]), np.array([0.8, 0.5])),
    'link6': (mujoco_arm.urdf(), np.linspace(0.2, 0.5, 6), np.linspace(0.8, 0.5, 6)),
}


def smooth(start: Array, way: Array) -> Reference:
    """Motion of 1 s that has four derivatives: so many does a torque behind a spring need."""

    def sample(t: Array) -> Array:
        s = np.clip(np.asarray(t), 0.0, 1.0)[:, None]
        share = s**5 * (126 - 420 * s + 540 * s**2 - 315 * s**3 + 70 * s**4)
        return np.asarray(start + way * share)

    return sample


@pytest.mark.parametrize('tip', ARMS)
def test_links_behind_springs_go_as_asked_by_torque_alone(tip: str) -> None:
    text, start, way = ARMS[tip]
    robot = dn.load_robot(text).with_overrides(
        # Coulomb friction turns within 1 mrad/s: no grid of a plan resolves that
        {f'joint.{joint}.friction': 0.0 for joint in dn.load_robot(text).joint_names}
    )
    asked = smooth(start, way)
    times = np.linspace(0.0, 1.0, 201)
    plan = dn.shape_motion(robot, times, asked(times), tip=tip, step=1e-3, output_step=1e-3)
    assert plan.tip_error.max() < 1e-6  # m
    run = carried_out(robot, plan, after=0.2, step=0.02)
    moving = run.t <= 1.0
    behind = run.q[:, robot.joint_indices] + run.q[:, robot.flexible_indices]
    # found 4e-5 rad: torques between the rows of the plan; the motors themselves are off by 2 mrad
    assert np.abs(behind - asked(run.t))[moving].max() < 1e-4
    assert np.abs(run.q[:, robot.joint_indices] - asked(run.t))[moving].max() > 5e-4
    assert strayed(robot, tip, run, asked(run.t))[moving].max() < 1e-4  # m, of 0.5 m and more
