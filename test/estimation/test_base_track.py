"""A base's motion from readings: the derivatives of a known motion, late readings, gaps."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from denoc_ros.estimation.base_track import BaseTrack
from denoc_ros.types import Array

GRAVITY = np.array([0.0, 0.0, -9.81])
W = 1.3  # rad/s, of a ship's roll
STEP = 1e-3


def roll(t: float) -> tuple[Array, Array, Array]:
    """Pose, twist and acceleration in base axes of a base 2 m off the axis it rolls about."""
    angle, rate, up = 0.3 * np.sin(W * t), 0.3 * W * np.cos(W * t), -0.3 * W * W * np.sin(W * t)
    turn = Rotation.from_rotvec([angle, 0.0, 0.0]).as_matrix()
    arm = np.array([0.0, 2.0, 0.5])
    spin, grow = np.array([rate, 0.0, 0.0]), np.array([up, 0.0, 0.0])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, turn @ arm
    velocity = np.cross(spin, arm)
    acceleration = np.cross(grow, arm) + np.cross(spin, velocity)
    return pose, np.append(velocity, spin), np.append(acceleration, grow)


def tracked(kind: str, until: float, cutoff: float = 50.0) -> BaseTrack:
    track = BaseTrack(cutoff, 0.1, GRAVITY)
    for t in np.arange(0.0, until + 1e-9, STEP):
        pose, twist, acceleration = roll(t)
        if kind == 'odometry':
            track.take_odometry(t, pose, twist)
        elif kind == 'odometry_accel':
            track.take_acceleration(t, acceleration, alone=False)
            track.take_odometry(t, pose, twist)
        elif kind == 'imu':
            track.take_imu(t, twist[3:], acceleration[:3] - pose[:3, :3].T @ GRAVITY)
        else:
            track.take_acceleration(t, acceleration, alone=True)
    return track


def test_nothing_is_known_before_the_first_reading() -> None:
    track = BaseTrack(20.0, 0.1, GRAVITY)
    assert track.at(0.0) is None
    track.take_imu(0.0, np.zeros(3), -GRAVITY)
    assert track.at(0.0) is None  # angular acceleration takes two readings
    track.take_imu(STEP, np.zeros(3), -GRAVITY)
    assert track.at(0.0) is not None
    track.reset()
    assert track.at(0.0) is None


@pytest.mark.parametrize('kind', ['odometry', 'odometry_accel'])
def test_odometry_gives_twist_pose_and_acceleration(kind: str) -> None:
    found = tracked(kind, 1.0).at(1.0)
    pose, twist, acceleration = roll(1.0)
    assert found is not None
    assert found.pose is not None
    np.testing.assert_allclose(found.pose, pose, atol=1e-12)
    np.testing.assert_allclose(found.twist, twist, atol=1e-12)
    # differences lag by the filter's 3 ms: of 0.5 m/s^2 that change by 1.3 / s
    atol = 1e-12 if kind == 'odometry_accel' else 0.01
    np.testing.assert_allclose(found.acceleration, acceleration, atol=atol)


def test_an_imu_needs_no_attitude() -> None:
    """Acceleration less gravity is what it shows, whatever the pose: what the recursion needs."""
    found = tracked('imu', 1.0).at(1.0)
    pose, twist, acceleration = roll(1.0)
    assert found is not None
    assert found.pose is None
    np.testing.assert_allclose(found.twist[3:], twist[3:], atol=1e-12)
    shown = acceleration[:3] - pose[:3, :3].T @ GRAVITY
    np.testing.assert_allclose(found.acceleration[:3] - GRAVITY, shown, atol=1e-12)
    np.testing.assert_allclose(found.acceleration[3:], acceleration[3:], atol=0.01)


def test_accelerations_alone_are_taken_as_they_are() -> None:
    found = tracked('accel', 0.5).at(0.5)
    assert found is not None
    np.testing.assert_allclose(found.acceleration, roll(0.5)[2], atol=1e-12)
    np.testing.assert_allclose(found.twist, 0.0)


def test_between_readings_it_interpolates_and_late_ones_are_carried_on() -> None:
    track = tracked('odometry_accel', 1.0)
    between = track.at(1.0 - 0.4 * STEP)
    assert between is not None
    np.testing.assert_allclose(between.acceleration, roll(1.0 - 0.4 * STEP)[2], atol=1e-6)
    late = track.at(1.005)
    assert late is not None
    assert late.pose is not None
    pose, twist, _ = roll(1.005)
    np.testing.assert_allclose(late.pose, pose, atol=2e-5)  # its rate changes meanwhile
    np.testing.assert_allclose(late.twist, twist, atol=1e-4)


def test_after_the_longest_time_the_motion_is_held() -> None:
    track = tracked('odometry_accel', 1.0)
    one, other = track.at(1.1), track.at(5.0)
    assert one is not None
    assert other is not None
    np.testing.assert_allclose(one.twist, other.twist)


def test_a_gap_is_no_acceleration() -> None:
    track = BaseTrack(20.0, 0.1, GRAVITY)
    track.take_odometry(0.0, np.eye(4), np.zeros(6))
    track.take_odometry(3.0, np.eye(4), np.ones(6))
    assert track.at(3.0) is None
    track.take_odometry(3.01, np.eye(4), np.ones(6))
    found = track.at(3.01)
    assert found is not None
    np.testing.assert_allclose(found.acceleration, 0.0)


def test_an_imu_may_be_turned_and_away_from_the_origin() -> None:
    mounting = np.eye(4)
    mounting[:3, :3] = Rotation.from_euler('xyz', [0.4, -0.2, 1.1]).as_matrix()
    mounting[:3, 3] = arm = np.array([0.3, -1.5, 0.8])
    track = BaseTrack(50.0, 0.1, GRAVITY, mounting)
    for t in np.arange(0.0, 1.0 + 1e-9, STEP):
        _, twist, acceleration = roll(t)
        spin, grow = twist[3:], acceleration[3:]
        there = acceleration[:3] + np.cross(grow, arm) + np.cross(spin, np.cross(spin, arm))
        axes = mounting[:3, :3].T
        track.take_imu(t, axes @ spin, axes @ (there - GRAVITY))
    found = track.at(1.0)
    assert found is not None
    # the differentiated rate lags by the filter's 3 ms: 0.66 rad/s^3 over an arm of 1.7 m; taken
    # for the base frame's the reading is off by metres per second squared
    np.testing.assert_allclose(found.twist[3:], roll(1.0)[1][3:], atol=1e-9)
    np.testing.assert_allclose(found.acceleration, roll(1.0)[2], atol=0.01)
