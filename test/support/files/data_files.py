"""Files of test/data: records of others and reference solutions; its README has the sources."""

from __future__ import annotations

from pathlib import Path

DATA = Path(__file__).resolve().parents[2] / 'data'

# exciting trajectories of real arms, bare SQLite bags: 3441 messages of 6 joints, 727 of 7
UR10_BAG = DATA / 'ros2_bags' / 'ur10_exciting_trajectory.db3'
PANDA_BAG = DATA / 'ros2_bags' / 'panda_exciting_trajectory.db3'
SERVO_SWING = DATA / 'servo_pendulum' / 'lift_and_drop.json'
FLEXIBLE_ARM = DATA / 'daisy' / 'robot_arm_dat.mat'
RIG_RECORDS = DATA / 'two_flexible_links'

# the Canadarm with gauges, two clamped-free shapes a beam and no rotors, as it was shipped once
CLAMPED_FREE_CANADARM = DATA / 'canadarm_clamped_free.urdf'


def rig_run(name: str) -> Path:
    """Return the record of a step of the rig of two flexible links, as `30deg_run01`."""
    return RIG_RECORDS / f'lqg_step_{name}.mat'
