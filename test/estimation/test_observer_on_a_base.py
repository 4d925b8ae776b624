"""The observer on a base that moves: amplitudes from joints and a base's late readings."""

from __future__ import annotations

import numpy as np
import pytest
from base_robots import description, floating, spacecraft

import denoc_ros as dn
from denoc_ros.dynamics.base.base_motion import BaseMotion
from denoc_ros.dynamics.robot import load_robot
from denoc_ros.errors import StateError
from denoc_ros.estimation.base_track import BaseTrack
from denoc_ros.estimation.fusion import FusionSettings
from denoc_ros.estimation.observer import Observer
from denoc_ros.estimation.observer_settings import ObserverSettings
from denoc_ros.types import Array

GRAVITY = (0.0, -9.81, 0.0)
STEP = 2e-3
LATE = 5e-3  # s from a reading to when it is known


def heaving(t: float) -> tuple[Array, Array]:
    """Twist and acceleration of a base that heaves and rolls about the arm's axis."""
    w = 4.0
    twist, acceleration = np.zeros((2, 6))
    acceleration[1], twist[1] = 1.5 * np.sin(w * t), 1.5 / w * (1.0 - np.cos(w * t))
    twist[5], acceleration[5] = 0.1 * np.sin(w * t), 0.1 * w * np.cos(w * t)
    return twist, acceleration


def test_deflections_on_a_moving_base_by_an_imu_that_is_late() -> None:
    """Joints braked, so all that bends the links comes from the base."""
    robot = dn.load_robot(description('two_link_ff'), GRAVITY)
    for link in ('link_1', 'link_2'):
        robot = robot.with_overrides({f'beam.{link}.y.damping_ratio': 0.02})
    start = robot.static_deflection(np.zeros(2), base=heaving(0.0))
    times = np.arange(0.0, 2.0 + 1e-9, STEP)
    still = dict.fromkeys(robot.joint_names, lambda t: (0.0, 0.0, 0.0))
    run = dn.simulate(robot, start, 0 * start, times, prescribed=still, base=heaving)
    track = BaseTrack(30.0, 0.1, np.array(GRAVITY))
    settings = ObserverSettings(step=STEP, source='joints')
    with_base, without = Observer(robot, settings), Observer(robot, settings)
    with_base.base = track.at
    sent = 0
    errors: list[tuple[float, float]] = []
    zero = np.zeros(2)
    for k, t in enumerate(times):
        while sent <= k and times[sent] + LATE <= t + 1e-9:
            twist, acceleration = heaving(times[sent])
            # gravity stays as it is in base axes here, as the simulation has it
            track.take_imu(times[sent], twist[3:], acceleration[:3] - np.array(GRAVITY))
            sent += 1
        if track.at(t) is None:
            continue
        for observer in (with_base, without):
            observer.measure(t, zero, zero)
            observer.tick(t)
        true = robot.tip_deflection('link_2', run.q[k])[1]
        found, blind = (robot.tip_deflection('link_2', o.q)[1] for o in (with_base, without))
        errors.append((abs(found - true), abs(blind - true)))
    motion = np.ptp(robot.tip_deflection('link_2', run.q)[:, 1])
    found, blind = np.array(errors)[250:].max(axis=0)  # after a transient of 0.5 s
    # 5 ms of a base that moves at 4 rad/s are 2 % of its acceleration; links ring on from a start
    # that knows the base for as long
    assert found < 0.05 * motion, (found, motion)
    assert blind > 5.0 * found


def test_the_base_is_asked_for_its_motion_at_the_time_of_each_step() -> None:
    robot = dn.load_robot(description('two_link_ff'), GRAVITY)
    observer = Observer(robot, ObserverSettings(step=STEP, source='joints', horizon=0.01))
    asked: list[float] = []

    def base(t: float) -> BaseMotion:
        asked.append(t)
        return BaseMotion(np.zeros(6), np.zeros(6))

    observer.base = base
    zero = np.zeros(2)
    observer.measure(10.0, zero, zero)
    observer.measure(10.0 + STEP, zero, zero)
    observer.tick(10.0 + 2 * STEP)
    observer.predict()
    assert min(asked) >= 10.0
    assert 10.01 < max(asked) <= 10.0 + 2 * STEP + 0.01


def test_a_base_that_floats_and_is_not_measured_is_predicted() -> None:
    """Braked from a swing, the arm's links and its spacecraft move as simulated."""
    robot = load_robot(floating(description('canadarm'), spacecraft(500.0, 1.0)), (0, 0, 0))
    start = np.zeros(robot.n)

    def swing(t: float) -> tuple[float, float, float]:
        return 0.1 * (1 - np.cos(3 * t)), 0.3 * np.sin(3 * t), 0.9 * np.cos(3 * t)

    times = np.arange(0.0, 1.0 + 1e-9, STEP)
    prescribed = dict.fromkeys(robot.joint_names, swing)
    run = dn.simulate(robot, start, start, times, prescribed=prescribed)
    for source in ('joints', 'torque'):
        observer = Observer(robot, ObserverSettings(step=STEP, source=source))
        errors = []
        joints = robot.joint_indices
        for k, t in enumerate(times):
            observer.measure(t, run.q[k, joints], run.qd[k, joints], run.torque[k, joints])
            observer.tick(t)
            errors.append(np.abs(observer.q - run.q[k])[robot.flexible_indices].max())
        bent = np.abs(run.q[:, robot.flexible_indices]).max()
        assert max(errors[50:]) < 0.1 * bent, source
    with pytest.raises(StateError, match='the base must be fixed or its motion measured'):
        Observer(robot, ObserverSettings(step=STEP, fusion=FusionSettings()))
