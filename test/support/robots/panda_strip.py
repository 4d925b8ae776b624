"""The Panda with a steel strip in its hand, and its plain motion along x."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio
from lxml import etree
from shaped_runs import cycloid

import denoc_ros as dn
from denoc_ros.dynamics.robot import Robot
from denoc_ros.types import Array

ROBOTS = Path(pinocchio.__file__).parents[4] / 'share' / 'example-robot-data' / 'robots'
URDF = ROBOTS / 'panda_description' / 'urdf' / 'panda.urdf'
# Franka's data sheet
ACCELERATION = (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0)  # rad/s^2
JERK = (7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0)  # rad/s^3
# the hand down, at the arm's side: there it moves along x within the limits of velocity
SIDE = (-np.pi / 2.0, 0.4, 0.0, -1.7, 0.0, 2.1, -np.pi / 4.0)
WAY = 0.25  # m
DURATION = 0.44  # s

# 520 x 80 x 1 mm of steel, along y of the base; it bends along x
STRIP = """
<more>
  <link name="strip">
    <inertial>
      <origin xyz="0.26 0 0"/>
      <mass value="0.326560"/>
      <inertia ixx="0.000174" ixy="0" ixz="0" iyy="0.00758644" iyz="0" izz="0.00758644"/>
    </inertial>
  </link>
  <link name="strip_tip"/>
  <joint name="grasp" type="fixed">
    <parent link="panda_hand"/><child link="strip"/>
    <origin xyz="0 0 0.1034" rpy="0 0 1.5707963267948966"/>
  </joint>
  <joint name="strip_end" type="fixed">
    <parent link="strip"/><child link="strip_tip"/><origin xyz="0.52 0 0"/>
  </joint>
  <flexibility>
    <beam link="strip" length="0.52" shape="clamped-free">
      <bending direction="y" ei="1.4" modes="2" damping_ratio="0.003"/>
    </beam>
  </flexibility>
</more>
"""


def panda(*more: Any) -> str:
    """Return the URDF of the Panda with its fingers fixed, and with more elements."""
    root = etree.parse(str(URDF)).getroot()
    for joint in root.iter('joint'):
        if 'finger' in joint.get('name'):
            joint.set('type', 'fixed')
            for tag in ('axis', 'limit', 'mimic', 'dynamics'):
                for each in joint.findall(tag):
                    joint.remove(each)
    for each in more:
        root.append(each)
    return str(etree.tostring(root, encoding='unicode'))


def panda_strip() -> Robot:
    """Return the robot with the strip in its hand."""
    return dn.load_robot(panda(*etree.fromstring(STRIP)))


def plain_motion(robot: Robot, points: int = 221) -> tuple[Array, Array]:
    """Return times (k,) and joints (k, 7): the hand straight along x on a cycloid, not turned."""
    t = np.linspace(0.0, DURATION, points)
    q = np.zeros(robot.n)
    joints = robot.joint_indices
    q[joints] = SIDE
    home = robot.frame_pose('panda_hand', q)
    rows = np.zeros((points, len(joints)))
    for k, way in enumerate(WAY * (cycloid(t, DURATION) - 0.5)):
        for _ in range(20):
            pose = robot.frame_pose('panda_hand', q)
            jacobian = robot.frame_jacobian('panda_hand', q)[:, joints]
            off = home[:3, 3] + [way, 0.0, 0.0] - pose[:3, 3]
            turn = 0.5 * np.cross(pose[:3, :3].T, home[:3, :3].T).sum(axis=0)
            q[joints] += np.linalg.pinv(jacobian) @ np.concatenate((off, turn))
            if np.abs(off).max() < 1e-12:
                break
        rows[k] = q[joints]
    return t, rows
