"""Simulated robots on a base that floats: what physics keeps, whatever the attitude."""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np
import pytest
from base_robots import description, floating, spacecraft
from scipy.spatial.transform import Rotation

import denoc_ros as dn
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import StateError
from denoc_ros.types import Array


def ssrms() -> Robot:
    """The SSRMS on a spacecraft of 10 t, its joints damped."""
    text = re.sub(r'(</joint>)', r'<dynamics damping="20"/>\1', description('ssrms'))
    return load_robot(floating(text, spacecraft(10e3)), gravity=(0, 0, 0))


def flail(robot: Robot, t: float) -> Array:
    """Torques of the joints that throw the arm about."""
    tau = np.zeros(robot.n)
    for k, joint in enumerate(robot.joint_indices):
        tau[joint] = (60.0 - 8.0 * k) * np.sin((0.25 + 0.06 * k) * t + k)
    return tau


def start(robot: Robot) -> tuple[Array, Array]:
    q, qd = np.zeros((2, robot.n))
    q[robot.joint_indices] = 0.3, -0.5, 0.9, 0.4, -0.2, 0.1
    qd[robot.base_indices] = 0.01, -0.02, 0.03, 0.02, -0.01, 0.03
    return q, qd


def test_flailing_arm_keeps_momentum_and_the_centre_of_mass() -> None:
    """60 s: momentum to 1e-10 of what the arm and the spacecraft have, rounding in fact."""
    robot = ssrms()
    q, qd = start(robot)
    t = np.linspace(0.0, 60.0, 61)
    run = dn.simulate(robot, q, qd, t, lambda t, q, qd: flail(robot, t), rtol=1e-11, atol=1e-13)
    momentum = robot.momentum(run.q, run.qd)
    for part in (slice(0, 3), slice(3, 6)):
        scale = np.linalg.norm(momentum[0, part])
        assert np.abs(momentum[:, part] - momentum[0, part]).max() < 1e-10 * scale
    centre = robot.centre_of_mass(run.q)
    straight = centre[0] + np.outer(t, momentum[0, :3] / robot.mass)
    np.testing.assert_allclose(centre, straight, rtol=0, atol=1e-9)
    assert np.abs(run.q[-1, robot.base_indices]).max() > 0.05
    bent = run.q[:, robot.flexible_indices]
    assert np.abs(bent).max() > 1e-4


def test_energy_and_momentum_of_a_tumbling_arm_through_many_turns() -> None:
    """The attitude passes half a turn again and again; what is kept, is kept."""
    text = description('two_link_ff')
    robot = load_robot(floating(text, spacecraft(20.0, 0.5)), gravity=(0, 0, 0))
    q, qd = np.zeros((2, robot.n))
    qd[3:6] = 2.0, 1.3, -1.7
    qd[robot.joint_indices] = 0.5
    t = np.linspace(0.0, 12.0, 241)
    run = dn.simulate(robot, q, qd, t, rtol=1e-11, atol=1e-13)
    momentum = robot.momentum(run.q, run.qd)
    scale = np.abs(momentum).max()
    np.testing.assert_allclose(momentum, np.tile(momentum[0], (241, 1)), rtol=0, atol=1e-8 * scale)
    assert run.energy_drift < 1e-8
    assert np.linalg.norm(run.q[:, 3:6], axis=1).max() <= np.pi + 1e-9
    # the attitude itself never jumps: less than its rate allows between two outputs
    turns = [Rotation.from_rotvec(x) for x in run.q[:, 3:6]]
    steps = [(one.inv() * other).magnitude() for one, other in pairwise(turns)]
    spin = max(np.linalg.norm(robot.frame_motion('base', a, b)[0, 3:]) for a, b in
               zip(run.q, run.qd, strict=True))  # fmt: skip
    assert max(steps) < 1.3 * spin * 0.05
    assert sum(steps) > 6.0 * np.pi  # three turns


def test_scipy_steps_and_compiled_steps_agree_through_turns() -> None:
    robot = load_robot(floating(description('two_link_rr'), spacecraft(20.0, 0.5)), (0, 0, 0))
    q, qd = np.zeros((2, robot.n))
    qd[3:6] = 1.0, 2.3, -0.7
    t = np.linspace(0.0, 6.0, 13)
    compiled = dn.simulate(robot, q, qd, t, rtol=1e-10, atol=1e-12)
    by_scipy = dn.simulate(
        robot, q, qd, t, lambda t, q, qd: np.zeros(robot.n), rtol=1e-10, atol=1e-12
    )
    for one, other in zip(compiled.q, by_scipy.q, strict=True):
        # a rotation vector near pi may have either sign
        turn = Rotation.from_rotvec(one[3:6]).inv() * Rotation.from_rotvec(other[3:6])
        assert turn.magnitude() < 1e-7
    np.testing.assert_allclose(compiled.q[:, :3], by_scipy.q[:, :3], rtol=0, atol=1e-7)


def test_one_output_after_many_turns_is_reached() -> None:
    """Between outputs far apart the attitude is brought back as often as it must."""
    robot = load_robot(floating(description('two_link_rr'), spacecraft(20.0, 0.5)), (0, 0, 0))
    q, qd = np.zeros((2, robot.n))
    qd[3:6] = 3.0, 0.4, -0.7
    run = dn.simulate(robot, q, qd, np.array([0.0, 20.0]), rtol=1e-10, atol=1e-12)
    momentum = robot.momentum(run.q, run.qd)
    np.testing.assert_allclose(
        momentum[1], momentum[0], rtol=0, atol=1e-7 * np.abs(momentum).max()
    )


def test_prescribed_joints_move_the_base() -> None:
    """Free-floating: joints as prescribed, the base reacts, no momentum comes up."""
    robot = load_robot(floating(description('canadarm'), spacecraft(1e4)), (0, 0, 0))
    q, qd = np.zeros((2, robot.n))

    def swing(t: float) -> tuple[float, float, float]:
        return 0.2 * (1 - np.cos(t)), 0.2 * np.sin(t), 0.2 * np.cos(t)

    prescribed = dict.fromkeys(robot.joint_names, swing)
    run = dn.simulate(
        robot, q, qd, np.linspace(0.0, 2.0, 9), prescribed=prescribed, rtol=1e-10, atol=1e-12
    )
    momentum = robot.momentum(run.q, run.qd)
    assert np.abs(momentum).max() < 1e-6  # of 100 kg m/s that the arm alone has
    assert np.abs(run.q[-1, 3:6]).max() > 1e-3
    np.testing.assert_allclose(run.torque[:, robot.base_indices], 0.0, atol=1e-12)


def test_methods_with_a_memory_are_refused() -> None:
    robot = load_robot(floating(description('two_link_rr'), spacecraft()), (0, 0, 0))
    zero = np.zeros(robot.n)
    with pytest.raises(StateError, match=r'method must be one of DOP853, RK45, Radau'):
        dn.simulate(robot, zero, zero, np.array([0.0, 1.0]), method='LSODA')
