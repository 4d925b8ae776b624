"""Joint feedback inside the implicit step."""

from __future__ import annotations

import numpy as np
import pytest
from planar_chains import FLEXIBLE, planar_chain

from denoc_ros.dynamics.robot import load_robot
from denoc_ros.dynamics.stepper import Stepper, with_joint_feedback
from denoc_ros.errors import StateError

KP, KD = np.array([300.0, 200.0]), np.array([20.0, 10.0])


def test_it_is_the_torque_of_the_feedback() -> None:
    robot = load_robot(planar_chain((FLEXIBLE, FLEXIBLE)))
    held = with_joint_feedback(robot, robot.joint_indices, KP, KD)
    q, qd = np.random.default_rng(3).normal(scale=0.1, size=(2, robot.n))
    wanted, rate = np.array([0.4, -0.2]), np.array([0.1, 0.3])
    tau, outer = np.zeros((2, robot.n))
    index = robot.joint_indices
    outer[index] = KP * (wanted - q[index]) + KD * (rate - qd[index])
    tau[index] = KP * wanted + KD * rate
    np.testing.assert_allclose(
        held.forward_dynamics(q, qd, tau), robot.forward_dynamics(q, qd, outer), rtol=1e-9
    )


def test_gains_far_beyond_an_explicit_step_stay_stable() -> None:
    robot = load_robot(planar_chain((FLEXIBLE, FLEXIBLE)), gravity=(0, 0, 0))
    index = robot.joint_indices
    stepper = Stepper(with_joint_feedback(robot, index, 1e6 * KP, 1e4 * KD), 2e-3)
    q, qd, tau = np.zeros((3, robot.n))
    tau[index] = 1e6 * KP * 0.3
    q[index] = 0.3, 0.3 + 1e-4
    for _ in range(2000):
        stepper.free(q, qd, tau)
    np.testing.assert_allclose(q[index], 0.3, atol=1e-7)


def test_gains_must_be_positive_numbers() -> None:
    robot = load_robot(planar_chain((FLEXIBLE,)))
    with pytest.raises(StateError, match='gains kp, kd must be finite'):
        with_joint_feedback(robot, robot.joint_indices, -1.0, 0.0)
