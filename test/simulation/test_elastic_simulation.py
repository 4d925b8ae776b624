"""Arms with elastic joints, simulated: MuJoCo, energy, and springs that stiffen without end."""

from __future__ import annotations

import re

import mujoco_arm
import numpy as np
import pytest
from data_files import DATA
from spring_oracle import elastic_robot

import denoc_ros as dn
from denoc_ros.types import Array

REFERENCE = DATA / 'mujoco_elastic_arm.csv'


def driven(robot: dn.Robot, times: Array, until: float = 2.0) -> Array:
    """Coordinates of the arm of MuJoCo's model at some times [s]."""
    q0 = np.zeros(robot.n)
    q0[robot.joint_indices] = mujoco_arm.START
    tau = np.zeros(robot.n)

    def torque(t: float, _q: Array, _qd: Array) -> Array:
        tau[robot.joint_indices] = mujoco_arm.torque(t)
        return tau

    t = times[times <= until]
    return dn.simulate(robot, q0, 0.0 * q0, t, torque, rtol=1e-9, atol=1e-11).q


def test_an_arm_of_six_elastic_joints_moves_as_in_mujoco() -> None:
    robot = dn.load_robot(mujoco_arm.urdf())
    reference = np.loadtxt(REFERENCE, delimiter=',')
    moved = np.ptp(reference, axis=0)
    assert (moved[::2] > 0.05).all()  # rad, every motor
    assert (moved[1::2] > 1e-5).all()  # rad, every spring
    found = driven(robot, mujoco_arm.TIMES)
    # both are converged: halving MuJoCo's step changes 1e-9 rad
    np.testing.assert_allclose(found, reference, rtol=0, atol=1e-6)


def test_the_stiffer_the_springs_the_nearer_the_robot_without() -> None:
    text = mujoco_arm.urdf()
    rigid = dn.load_robot(re.sub('<spring[^>]*/>', '', text))
    times = np.array([0.0, 0.15, 0.3])
    expected = driven(rigid, times)
    errors = []
    for factor in (1.0, 4.0, 16.0):
        # damped alike: the start, from which springs jump to their load, dies out
        sprung = re.sub(
            'stiffness="([^"]*)" damping="([^"]*)"',
            lambda m: (
                f'stiffness="{float(m[1]) * factor}" damping="{float(m[2]) * 8 * np.sqrt(factor)}"'  # noqa: B023
            ),
            text,
        )
        robot = dn.load_robot(sprung)
        q = driven(robot, times)
        link_side = q[:, robot.joint_indices] + q[:, robot.flexible_indices]
        errors.append(np.abs(link_side - expected)[1:].max())
    orders = -np.diff(np.log(errors)) / np.log(4.0)
    assert errors[-1] < 2e-4  # rad
    # the springs carry the load of the rigid motion: deflections go with 1 / k
    np.testing.assert_allclose(orders, 1.0, atol=0.25)


@pytest.mark.parametrize('seed', [4, 15])
def test_energy_is_conserved_through_springs_play_and_beams(seed: int) -> None:
    text = elastic_robot(seed, 3, conservative=True)
    text = re.sub(r'<dynamics[^>]*/>|damping_ratio="[^"]*"', '', text)
    robot = dn.load_robot(text)
    assert any(name.endswith('/spring') for name in robot.coordinate_names)
    q0 = np.zeros(robot.n)
    q0[robot.joint_indices] = 0.5
    run = dn.simulate(robot, q0, 0.0 * q0, np.linspace(0.0, 0.5, 6), rtol=1e-11, atol=1e-13)
    total = run.energy.sum(axis=1)
    exchanged = np.ptp(run.energy[:, 0])
    assert exchanged > 0.1  # J
    assert np.abs(total - total[0]).max() <= 1e-8 * exchanged


def test_a_fixed_step_keeps_up_with_stiff_springs() -> None:
    robot = dn.load_robot(mujoco_arm.urdf())
    reference = np.loadtxt(REFERENCE, delimiter=',')[:4]
    errors = []
    for step in (1e-3, 5e-4):
        stepper = dn.Stepper(robot, step)
        q = np.zeros(robot.n)
        q[::2] = mujoco_arm.START
        qd, tau = np.zeros(robot.n), np.zeros(robot.n)
        for _ in range(round(0.3 / step)):
            stepper.free(q, qd, tau)
        errors.append(np.abs(q - reference[3]).max())
    assert errors[1] < 2e-4  # rad
    assert errors[1] < 0.5 * errors[0]  # order 2 where the step resolves the springs
