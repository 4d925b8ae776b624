"""Laws of the fixed step of the real-time side, against the adaptive integrator."""

from __future__ import annotations

import numpy as np
import pytest
from planar_chains import PlanarLink, planar_chain

import denoc_ros as dn
from denoc_ros.types import Array

DOWN = (0.0, -9.81, 0.0)
SOFT = (PlanarLink(1.0, 2.0, 150.0), PlanarLink(0.8, 1.0, 60.0))


def soft_arm(damping_ratio: float = 0.02) -> dn.Robot:
    return dn.load_robot(planar_chain(SOFT, 2, damping_ratio=damping_ratio), gravity=DOWN)


def start(robot: dn.Robot) -> Array:
    q0 = np.zeros(robot.n)
    q0[robot.joint_indices] = [-1.0, 0.5]
    return q0


def march(robot: dn.Robot, step: float, end: float, q: Array, qd: Array, tau: Array) -> Array:
    """States (k, 2 n) of steps under a constant torque."""
    stepper = dn.Stepper(robot.copy(), step)
    states = [np.concatenate([q, qd])]
    q, qd = q.copy(), qd.copy()
    for _ in range(round(end / step)):
        stepper.free(q, qd, tau)
        states.append(np.concatenate([q, qd]))
    return np.array(states)


def test_free_step_converges_with_order_two() -> None:
    robot = soft_arm()
    q0, tau = start(robot), np.zeros(robot.n)
    tau[robot.joint_indices] = [3.0, 1.0]
    exact = dn.simulate(
        robot, q0, np.zeros(robot.n), np.array([0.0, 0.2]), torque=lambda *_: tau, rtol=1e-11
    ).q[-1]
    errors = [
        np.max(np.abs(march(robot, step, 0.2, q0, np.zeros(robot.n), tau)[-1, : robot.n] - exact))
        for step in (4e-4, 2e-4, 1e-4)
    ]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(orders > 1.8), errors
    assert errors[-1] < 1e-4


def test_driven_step_converges_with_order_two() -> None:
    robot = soft_arm()
    joints = np.asarray(robot.joint_indices)

    def law(t: float) -> tuple[float, float, float]:
        return 0.25 * t * t, 0.5 * t, 0.5

    laws = dict.fromkeys(robot.joint_names, law)
    rest = np.zeros(robot.n)
    exact = dn.simulate(robot, rest, rest, np.array([0.0, 0.2]), prescribed=laws, rtol=1e-11).q[-1]
    errors = []
    for step in (4e-4, 2e-4, 1e-4):
        stepper = dn.Stepper(robot.copy(), step)
        q, qd = np.zeros(robot.n), np.zeros(robot.n)
        for _ in range(round(0.2 / step)):
            stepper.driven(q, qd, np.full(len(joints), 0.5))
        np.testing.assert_allclose(q[joints], exact[joints], atol=1e-12)
        errors.append(np.max(np.abs(q - exact)))
    assert np.all(np.log2(np.array(errors[:-1]) / errors[1:]) > 1.8), errors


@pytest.mark.parametrize('damping_ratio', [0.0, 0.01, 2.0])
def test_mode_far_faster_than_the_step_stays_stable(damping_ratio: float) -> None:
    # 5 kHz in the first bending mode, a step of 1 ms: 31 radians of the mode per step.
    length, mass = 0.5, 1.0
    ei = (2 * np.pi * 5000.0) ** 2 * mass * length**3 / 1.8751**4
    link = PlanarLink(length, mass, ei)
    robot = dn.load_robot(planar_chain([link, link], 2, damping_ratio=damping_ratio), gravity=DOWN)
    assert robot.natural_frequencies(np.zeros(robot.n))[-1] > 5000.0
    rigid = dn.load_robot(planar_chain([PlanarLink(length, mass)] * 2), gravity=DOWN)
    q0, joints = start(robot), np.asarray(robot.joint_indices)
    states = march(robot, 1e-3, 2.0, q0, np.zeros(robot.n), np.zeros(robot.n))
    truth = dn.simulate(rigid, q0[joints], np.zeros(2), np.linspace(0.0, 2.0, 2001))
    # Stiff links fall as rigid ones do; the step's own error grows to milliradians in 2 s.
    assert np.max(np.abs(states[:, joints] - truth.q)) < 2e-2
    amplitudes = np.setdiff1d(np.arange(robot.n), joints)
    assert np.max(np.abs(states[:, amplitudes])) < 1e-5  # m


def test_step_neither_adds_nor_loses_much_energy() -> None:
    robot = soft_arm(damping_ratio=0.0)
    states = march(robot, 1e-3, 2.0, start(robot), np.zeros(robot.n), np.zeros(robot.n))
    q, qd = np.split(states, 2, axis=1)
    energy = robot.energy(np.ascontiguousarray(q), np.ascontiguousarray(qd))
    total = energy.sum(axis=1)
    drift = (total - total[0]) / np.max(energy[:, 0])
    assert np.max(drift) < 1e-5
    assert np.min(drift) > -5e-5


def test_free_decay_is_that_of_the_adaptive_integrator() -> None:
    robot = soft_arm(damping_ratio=0.1)
    rest = robot.static_deflection([-1.0, 0.5])
    stepper = dn.Stepper(robot.copy(), 1e-3)
    q, qd = rest.copy(), np.zeros(robot.n)
    q[1] += 0.02
    held = {
        name: (lambda _t, at=float(rest[index]): (at, 0.0, 0.0))
        for name, index in zip(robot.joint_names, robot.joint_indices, strict=True)
    }
    exact = dn.simulate(robot, q, qd, np.array([0.0, 3.0]), prescribed=held).q[-1]
    for _ in range(3000):
        stepper.driven(q, qd, np.zeros(2))
    assert abs(exact[1] - rest[1]) < 0.01
    assert np.max(np.abs(q - exact)) < 1e-5


def test_rest_stays_at_rest() -> None:
    robot = soft_arm()
    rest = robot.static_deflection([-1.0, 0.5])
    q, qd = rest.copy(), np.zeros(robot.n)
    stepper = dn.Stepper(robot.copy(), 1e-3)
    for _ in range(100):
        stepper.driven(q, qd, np.zeros(2))
    np.testing.assert_allclose(q, rest, atol=1e-10)


def test_state_is_untouched_by_a_step_that_is_refused() -> None:
    robot = soft_arm()
    q, qd = start(robot), np.zeros(robot.n)
    tau = np.full(robot.n, np.nan)
    with pytest.raises(dn.StateError, match='must be finite'):
        dn.Stepper(robot.copy(), 1e-3).free(q, qd, tau)
    np.testing.assert_array_equal(q, start(robot))
