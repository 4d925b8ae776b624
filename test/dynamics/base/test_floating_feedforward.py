"""Torque for arms whose base floats: joints follow, and the base reacts as it will."""

from __future__ import annotations

import numpy as np
import pytest
from base_robots import description, floating, spacecraft

import denoc_ros as dn
from denoc_ros.dynamics.base.reacting_base import ReactingBase
from denoc_ros.dynamics.driven.torque_feedforward import TorqueFeedforward
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.types import Array

STEP = 2e-3
END = 1.5


def motion(t: float, joints: int) -> tuple[Array, Array, Array]:
    """A swing of 0.3 rad that starts from rest with no jump of its acceleration."""
    w, size = 2.0 * np.pi / END, 0.3 * (1.0 - 0.2 * np.arange(joints))
    share = t / END - np.sin(w * t) / (2.0 * np.pi)
    rate, up = (1.0 - np.cos(w * t)) / END, w * np.sin(w * t) / END
    return size * share, size * rate, size * up


def torques(robot: Robot, model: str) -> tuple[Array, Array, TorqueFeedforward]:
    source = TorqueFeedforward(robot, model=model, step=STEP)
    times = np.arange(0.0, END + 0.5 * STEP, STEP)
    found = [source.update(*motion(t, len(source.joints)), STEP).copy() for t in times]
    return times, np.array(found), source


def followed(robot: Robot, times: Array, torque: Array) -> float:
    """The joints' largest error, as a share of the motion, under these torques alone."""
    zero = np.zeros(robot.n)
    joints = robot.joint_indices

    def drive(t: float, q: Array, qd: Array) -> Array:
        tau = np.zeros(robot.n)
        tau[joints] = [np.interp(t, times, column) for column in torque.T]
        return tau

    at = np.linspace(0.0, END, 16)
    run = dn.simulate(robot, zero, zero, at, drive, rtol=1e-7, atol=1e-9)
    asked = np.array([motion(t, len(joints))[0] for t in at])
    return float(np.abs(run.q[:, joints] - asked).max() / np.abs(asked).max())


def arm(name: str, mass: float) -> Robot:
    return load_robot(floating(description(name), spacecraft(mass, 1.0)), (0, 0, 0))


def test_flexible_arm_on_a_light_spacecraft_follows() -> None:
    robot = arm('canadarm', 800.0)
    times, torque, source = torques(robot, 'flexible')
    assert followed(robot, times, torque) < 2e-3  # torque held linear over 2 ms
    assert np.abs(source.q[robot.base_indices]).max() > 0.05
    fixed = load_robot(description('canadarm'), (0, 0, 0))
    _, as_if_fixed, _ = torques(fixed, 'flexible')
    assert followed(robot, times, as_if_fixed) > 0.05


@pytest.mark.parametrize('model', ['rigid', 'quasi_static', 'flexible'])
def test_rigid_arm_follows_by_every_model(model: str) -> None:
    robot = arm('puma', 150.0)
    times, torque, source = torques(robot, model)
    assert followed(robot, times, torque) < 2e-3
    np.testing.assert_allclose(robot.momentum(source.q, source.qd), 0.0, atol=0.05)


def test_a_base_that_reacts_has_no_momentum_and_takes_no_force() -> None:
    robot = arm('ssrms', 10e3)
    rng = np.random.default_rng(1)
    q, qd, qdd = 0.1 * rng.normal(size=(3, robot.n))
    base = ReactingBase(robot)
    base.rates(q, qd)
    np.testing.assert_allclose(robot.momentum(q, qd), 0.0, atol=1e-9)
    base.accelerations(q, qd, qdd)
    tau = robot.inverse_dynamics(q, qd, qdd)
    np.testing.assert_allclose(tau[robot.base_indices], 0.0, atol=1e-9 * np.abs(tau).max())
    q[3:6], before = [0.0, 5.0, 0.0], robot.frame_motion('base', q, qd)
    base.wrap(q, qd)
    assert np.linalg.norm(q[3:6]) < np.pi
    assert before.shape == (2, 6)


def test_a_base_that_is_held_takes_the_wrench_it_needs() -> None:
    """Free-flying: the base at rest, its rows are what thrusters give."""
    robot, fixed = arm('canadarm', 1e4), load_robot(description('canadarm'), (0, 0, 0))
    rng = np.random.default_rng(2)
    q, qd, qdd = 0.1 * rng.normal(size=(3, fixed.n))
    spread = [np.append(np.zeros(6), part) for part in (q, qd, qdd)]
    tau = robot.inverse_dynamics(spread[0], spread[1], spread[2])
    np.testing.assert_allclose(tau[6:], fixed.inverse_dynamics(q, qd, qdd), rtol=1e-9, atol=1e-9)
    wrench = robot.base_wrench(spread[0], tau)
    force = robot.inverse_dynamics(spread[0], spread[1], spread[2], wrenches={'base': wrench})
    np.testing.assert_allclose(force[:6], 0.0, atol=1e-9)


@pytest.mark.parametrize('model', ['rigid', 'flexible'])
def test_torque_on_a_tumbling_spacecraft_takes_its_measured_twist(model: str) -> None:
    robot = arm('puma' if model == 'rigid' else 'canadarm', 800.0)
    joints, tumble = robot.joint_indices, np.array([0.1, 0.2, -0.1, 0.15, -0.1, 0.2])

    def joint(t: float, k: int) -> tuple[float, float, float]:
        angle, rate, up = motion(t, len(joints))
        return float(angle[k]), float(rate[k]), float(up[k])

    laws = {name: lambda t, k=k: joint(t, k) for k, name in enumerate(robot.joint_names)}
    q, qd = np.zeros((2, robot.n))
    qd[robot.base_indices] = tumble
    times = np.arange(0.0, END, STEP)
    run = dn.simulate(robot, q, qd, times, prescribed=laws, rtol=1e-8, atol=1e-10)
    measured, blind = (TorqueFeedforward(robot, model=model, step=STEP) for _ in range(2))
    found = np.zeros((2, len(times), len(joints)))
    for k, t in enumerate(times):
        linear, angular = robot.frame_motion('base', run.q[k], run.qd[k])[0].reshape(2, 3)
        turn = robot.frame_pose('base', run.q[k])[:3, :3].T
        measured.move_floating_base(np.append(turn @ linear, turn @ angular))
        for row, source in zip(found, (measured, blind), strict=True):
            row[k] = source.update(*motion(t, len(joints)), STEP)
    truth = run.torque[:, joints] if run.torque.shape[1] == robot.n else run.torque
    share = np.abs(found - truth).max(axis=(1, 2)) / np.abs(truth).max()
    # of the largest torque; what is left is the integration by steps of 2 ms
    assert share[0] < 5e-3
    assert share[1] > 0.03


def test_a_twist_is_that_of_the_base_at_any_attitude() -> None:
    robot = arm('puma', 150.0)
    q, qd = np.random.default_rng(3).normal(size=(2, robot.n))
    linear, angular = robot.frame_motion('base', q, qd)[0].reshape(2, 3)
    turn, base = robot.frame_pose('base', q)[:3, :3].T, ReactingBase(robot)
    base.twist = np.append(turn @ linear, turn @ angular)
    found = qd.copy()
    found[robot.base_indices] = 0.0
    base.rates(q, found)
    np.testing.assert_allclose(found, qd, rtol=1e-9, atol=1e-9)
