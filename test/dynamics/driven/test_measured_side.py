"""Joints measured on either side of their springs: states, feedforward, observer."""

from __future__ import annotations

import pickle
from collections.abc import Callable

import numpy as np
import pytest
from geared_arm import arm_text

import denoc_ros as dn
from denoc_ros.dynamics.driven.measured_side import (
    MeasuredStates,
    measured_equilibrium,
    measured_robot,
)
from denoc_ros.dynamics.driven.torque_feedforward import TorqueFeedforward
from denoc_ros.dynamics.springs import deflection
from denoc_ros.estimation.observer import Observer
from denoc_ros.estimation.observer_settings import ObserverSettings
from denoc_ros.model.tree import Spring
from denoc_ros.types import Array

DURATION = 1.0  # s


def arm(side: str) -> dn.Robot:
    return dn.load_robot(arm_text(side))


def wanted(t: float) -> tuple[Array, Array, Array]:
    """Motion (2,) of both joints from rest to rest, four times differentiable."""
    s = min(max(t / DURATION, 0.0), 1.0)
    p = s**5 * (126 - 420 * s + 540 * s**2 - 315 * s**3 + 70 * s**4)
    rate = 630 * s**4 * (1 - s) ** 4
    change = 2520 * s**3 * (1 - s) ** 3 * (1 - 2 * s)
    start, way = np.array([0.2, 0.4]), np.array([1.0, -0.8])
    return start + way * p, way * rate / DURATION, way * change / DURATION**2


def carried_out(robot: dn.Robot, side: Callable[[Array], Array]) -> float:
    """Largest distance of a side of the joints from the wanted motion, by the torque alone."""
    source = TorqueFeedforward(measured_robot(robot), model='flexible')
    step, substeps = 1e-3, 4
    q = robot.static_deflection(wanted(0.0)[0])
    q[robot.joint_indices] += wanted(0.0)[0] - side(q)
    qd, tau = np.zeros((2, robot.n))
    stepper, worst = dn.Stepper(robot, step / substeps), 0.0
    elapsed = 0.0
    for k in range(round(DURATION / step)):
        # held over the step: what is wanted in its middle
        tau[robot.joint_indices] = source.update(*wanted((k + 0.5) * step), elapsed)
        elapsed = step
        for _ in range(substeps):
            stepper.free(q, qd, tau)
        worst = max(worst, np.abs(side(q) - wanted((k + 1) * step)[0]).max())
    return worst


@pytest.mark.parametrize('side', ['motor', 'link'])
def test_feedforward_moves_the_side_that_is_measured(side: str) -> None:
    robot = arm(side)
    states, out = MeasuredStates(robot), np.zeros(2)

    def measured(q: Array) -> Array:
        states.positions(q, out)
        return out

    # of 1 rad, without any feedback. The other side is off by 2 mrad; without the motors' share
    # it is 0.7 rad. Found: 5e-6 and 3e-5, by torques held over a step and a filter's lag
    assert carried_out(robot, measured) < 1e-4


def test_states_of_the_link_side_are_of_the_link() -> None:
    q, qd = np.array([[0.3, 0.01, -0.2, 0.02], [1.0, 0.1, 2.0, -0.3]])
    position, effort = np.zeros(2), np.array([5.0, 6.0])
    for side, expected in (('motor', [0.3, -0.2]), ('link', [0.31, -0.18])):
        MeasuredStates(arm(side)).positions(q, position)
        np.testing.assert_allclose(position, expected)
    MeasuredStates(arm('motor')).efforts(q, qd, effort)
    np.testing.assert_array_equal(effort, [5.0, 6.0])
    MeasuredStates(arm('link')).efforts(q, qd, effort)
    np.testing.assert_allclose(effort, [-(120.0 + 0.8), -(100.0 - 0.9)])


def test_the_robot_of_link_states_has_no_springs_and_keeps_its_paths() -> None:
    whole = arm('link')
    whole.set_payload('tool', 1.5)
    seen = measured_robot(whole)
    assert seen.coordinate_names == ('shoulder', 'elbow')
    assert measured_robot(seen) is seen
    assert measured_robot(arm('motor')).n == 4
    stiffer = seen.with_overrides({'joint.elbow.stiffness': 9e3})
    joint = stiffer.tree.bodies[1].joint
    assert joint is not None
    assert joint.spring is not None
    assert joint.spring.stiffness == 9e3
    assert stiffer.coordinate_names == seen.coordinate_names
    q, still = np.array([0.3, -0.5]), np.zeros(2)
    load = seen.inverse_dynamics(q, still, still)
    for other in (stiffer, pickle.loads(pickle.dumps(seen)), seen.copy()):
        np.testing.assert_allclose(other.inverse_dynamics(q, still, still), load, rtol=1e-12)
    # what the gears carry, at rest: the weight of the links and of the payload
    bent = whole.static_deflection(q)
    force = whole.inverse_dynamics(bent, 0 * bent, 0 * bent)[whole.joint_indices]
    np.testing.assert_allclose(load, force, rtol=1e-2)


@pytest.mark.parametrize('source', ['joints', 'torque'])
@pytest.mark.parametrize('side', ['motor', 'link'])
def test_an_observer_knows_the_links_from_either_side(side: str, source: str) -> None:
    robot = arm(side)
    states = MeasuredStates(robot)
    seen = measured_robot(robot)
    observer = Observer(seen, ObserverSettings(source=source, step=1e-3))
    step = 1e-3
    stepper = dn.Stepper(robot, step)
    q = robot.static_deflection([0.2, 0.4])
    qd, tau = np.zeros((2, robot.n))
    still = robot.inverse_dynamics(q, qd, qd)[robot.joint_indices]
    position, rate, effort = np.zeros((3, 2))
    errors, moved = [], 0.0
    for k in range(600):
        push = np.array([20.0, -8.0]) * np.sin(9.0 * k * step)
        tau[robot.joint_indices] = still + push
        states.positions(q, position)
        states.positions(qd, rate)
        effort[:] = still + push
        states.efforts(q, qd, effort)
        observer.measure(k * step, position, rate, effort)
        observer.tick(k * step)
        if k > 100:
            true = robot.frame_pose('tool', q)[:3, 3]
            errors.append(np.linalg.norm(seen.frame_pose('tool', observer.q)[:3, 3] - true))
            rigid = q.copy()
            rigid[robot.flexible_indices] = 0.0
            sag = np.linalg.norm(robot.frame_pose('tool', rigid)[:3, 3] - true)
            moved = max(moved, float(sag))
        stepper.free(q, qd, tau)
    assert moved > 2e-3  # m, by the springs
    assert max(errors) < 0.03 * moved


@pytest.mark.parametrize('force', [-80.0, 3.0, 0.0])
def test_a_springs_deflection_gives_the_force(force: float) -> None:
    spring = Spring(stiffness=2e3, stiffness3=4e6, backlash=0.01)
    s = deflection(spring, force)
    e = s - np.sign(force) * 0.005
    assert 2e3 * e + 4e6 * e**3 == pytest.approx(force, rel=1e-12, abs=1e-12)


def test_soft_springs_are_in_equilibrium_where_links_are_measured() -> None:
    text = arm_text('link').replace('stiffness="1.2e4"', 'stiffness="40"')
    robot, wanted_at = dn.load_robot(text), np.array([0.3, -0.5])
    q, still = measured_equilibrium(robot, wanted_at), np.zeros(robot.n)
    seen = np.zeros(2)
    MeasuredStates(robot).positions(q, seen)
    np.testing.assert_allclose(seen, wanted_at, atol=1e-9)
    assert np.abs(q[1]) > 0.3  # rad: rounds by static_deflection went astray
    free = robot.inverse_dynamics(q, still, still)[robot.flexible_indices]
    np.testing.assert_allclose(free, 0.0, atol=1e-9)
