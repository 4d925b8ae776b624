"""Springs behind measured joints are estimated: the motors' side against simulated truth."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from geared_arm import arm_text

import denoc_ros as dn
from denoc_ros.dynamics.driven.measured_side import MeasuredStates, measured_robot
from denoc_ros.dynamics.springs import GearSprings, next_deflection
from denoc_ros.estimation.observer import Observer
from denoc_ros.estimation.observer_settings import ObserverSettings
from denoc_ros.model.tree import Spring
from denoc_ros.types import Array

STEP = 1e-3
TICKS, SETTLED = 800, 100
NOISE = 1e-5, 1e-3  # rad, rad/s


class Found(NamedTuple):
    """Coordinates and rates (2, k, n): estimated, and as they are."""

    estimated: Array
    true: Array

    def error(self, columns: Array, rates: bool = False) -> Array:
        """Rms errors of coordinates, or of their rates, over their ranges."""
        part = int(rates)
        off = self.estimated[part][SETTLED:, columns] - self.true[part][SETTLED:, columns]
        rms = np.sqrt(np.mean(off**2, axis=0))
        return np.asarray(rms / np.ptp(self.true[part][SETTLED:, columns], axis=0))


def observe(robot: dn.Robot, noise: bool = False, commanded: bool = False, **how: str) -> Found:
    """Return what an observer says of an arm whose motors are driven by smooth torques."""
    seen = measured_robot(robot)
    settings = ObserverSettings(step=STEP, motor_effort=commanded, **how)  # type: ignore[arg-type]
    observer, states = Observer(seen, settings), MeasuredStates(robot)
    assert observer.springs.whole.names == robot.coordinate_names
    stepper, rng = dn.Stepper(robot, 0.5 * STEP), np.random.default_rng(4)
    q = robot.static_deflection([0.2, 0.4])
    qd, tau, before = np.zeros((3, robot.n))
    still = robot.inverse_dynamics(q, qd, qd)[robot.joint_indices]
    position, rate, effort = np.zeros((3, 2))
    found = np.zeros((4, TICKS, robot.n))
    for k in range(TICKS):
        t = k * STEP
        tau[robot.joint_indices] = still + np.array([30.0, -12.0]) * np.sin(9.0 * t) ** 3
        states.positions(q, position)
        states.positions(qd, rate)
        effort[:] = before[robot.joint_indices] if k else still
        if not commanded:
            states.efforts(q, qd, effort)
        errors = rng.standard_normal((2, 2)) if noise else np.zeros((2, 2))
        measured = position + NOISE[0] * errors[0], rate + NOISE[1] * errors[1]
        observer.measure(t, *measured, effort)
        observer.tick(t)
        observer.modal_state((found[0, k], found[1, k]))
        found[2, k], found[3, k] = q, qd
        before[:] = tau
        for _ in range(2):
            stepper.free(q, qd, tau)
    return Found(found[:2], found[2:])


SPRINGS, MOTORS = np.array([1, 3]), np.array([0, 2])


def test_springs_are_estimated_by_the_motion_of_the_links() -> None:
    found = observe(dn.load_robot(arm_text('link')))
    assert np.ptp(found.true[0][:, SPRINGS], axis=0).min() > 5e-4  # rad
    # found: 0.1 and 0.4 % of their ranges, the rates 2 and 7 %: half a step of the torque
    assert found.error(SPRINGS).max() < 0.01
    assert found.error(SPRINGS, rates=True).max() < 0.15
    assert found.error(MOTORS).max() < 1e-4
    # the links' own rates are those of the motors to 1 %; the springs' are the rest
    assert found.error(MOTORS, rates=True).max() < 3e-3


def test_noise_of_the_joints_enters_as_the_torque_that_it_would_take() -> None:
    robot = dn.load_robot(arm_text('link'))
    clean, noisy = observe(robot), observe(robot, noise=True)
    inertia = measured_robot(robot).inertia_matrix(np.array([0.2, 0.4]))
    # white noise of rates through a filter of bandwidth w: accelerations off by up to
    # noise w sqrt(w step) or so, from which the torque, and so the spring
    w = 2.0 * np.pi * 50.0
    acceleration = NOISE[1] * w * np.sqrt(w * STEP)
    bound = np.abs(inertia).sum(axis=1) * acceleration / robot.stiffness[SPRINGS]
    off = (noisy.estimated[0] - clean.estimated[0])[SETTLED:, SPRINGS]
    rms = np.sqrt(np.mean(off**2, axis=0))
    assert (rms < 2.0 * bound).all()
    assert (rms > 0.02 * bound).all()
    assert noisy.error(SPRINGS).max() < 0.05


@pytest.mark.parametrize('commanded', [False, True])
def test_springs_are_estimated_by_effort(commanded: bool) -> None:
    robot = dn.load_robot(arm_text('link'))
    found = observe(robot, commanded=commanded, source='torque')
    # measured behind the gear: the torque itself; of the motors: that of the links' motion
    assert found.error(SPRINGS).max() < (0.02 if commanded else 0.005)


def test_one_joint_may_be_measured_behind_its_spring_and_another_before() -> None:
    text = arm_text('link').replace('damping="3" measured="link"', 'damping="3"')
    found = observe(dn.load_robot(text))
    assert found.error(SPRINGS).max() < 0.02
    assert found.error(MOTORS).max() < 1e-3


def test_a_stiffening_spring_with_play_is_estimated() -> None:
    more = 'stiffness="5e3" stiffness3="4e8" backlash="0.002" damping="3" '
    text = arm_text('link').replace('stiffness="5e3" damping="3" ', more)
    found = observe(dn.load_robot(text))
    # within the play, which it crosses quickly, only its corners are known
    assert found.error(SPRINGS).max() < 0.03


@pytest.mark.parametrize('damping', [0.0, 3.0, 500.0])
def test_springs_follow_a_torque_for_any_damping(damping: float) -> None:
    spring = Spring(stiffness=5e3, damping=damping)
    springs, w = GearSprings([spring]), 10.0
    for k in range(2000):
        springs.follow(np.array([20.0 * np.sin(w * k * STEP)]), STEP)
    t = 1999 * STEP
    answer = -20.0 * np.exp(1j * w * t) / (5e3 + 1j * w * damping)
    size = abs(answer)
    # the filter's second order, (2 pi 10 / 100)^2 / 40, and half a step of the implicit balance
    assert springs.deflection[0] == pytest.approx(answer.imag, abs=0.02 * size)
    assert springs.rate[0] == pytest.approx((1j * w * answer).imag, abs=0.02 * w * size)
    assert springs.acceleration[0] == pytest.approx((-w * w * answer).imag, abs=0.1 * w * w * size)


@pytest.mark.parametrize('force', [-80.0, 1.0, 0.0])
@pytest.mark.parametrize('drag', [0.0, 50.0, 3e4])
def test_the_next_deflection_keeps_the_balance(force: float, drag: float) -> None:
    spring, before = Spring(stiffness=2e3, stiffness3=4e6, backlash=0.01), 0.001
    s = next_deflection(spring, before, force, drag)
    e = np.sign(s) * max(abs(s) - 0.005, 0.0)
    assert 2e3 * e + 4e6 * e**3 + drag * (s - before) == pytest.approx(force, rel=1e-9, abs=1e-9)
