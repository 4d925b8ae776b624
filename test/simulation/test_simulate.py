"""Laws of `dn.simulate`."""

from __future__ import annotations

import numpy as np
import pytest
from planar_chains import FLEXIBLE, RIGID, planar_chain

import denoc_ros as dn
from denoc_ros.types import Array

DOWN = (0.0, -9.81, 0.0)
MIMIC = """<robot name="tied"><link name="base"/>
<link name="a"><inertial><origin xyz="0.5 0 0"/><mass value="2"/>
  <inertia ixx="0" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="b"><inertial><origin xyz="0.3 0 0"/><mass value="1"/>
  <inertia ixx="0" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="lead" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
  <limit lower="-9" upper="9" effort="9" velocity="9"/></joint>
<joint name="follow" type="revolute"><parent link="a"/><child link="b"/><origin xyz="1 0 0"/>
  <axis xyz="0 0 1"/><limit lower="-9" upper="9" effort="9" velocity="9"/>
  <mimic joint="lead" multiplier="-2" offset="0.3"/></joint></robot>"""


def swing(t: float) -> tuple[float, float, float]:
    return 0.3 * np.sin(2.0 * t), 0.6 * np.cos(2.0 * t), -1.2 * np.sin(2.0 * t)


@pytest.fixture(scope='module')
def arm() -> dn.Robot:
    return dn.load_robot(planar_chain([FLEXIBLE, RIGID]), gravity=DOWN)


def start(robot: dn.Robot) -> Array:
    q0 = np.zeros(robot.n)
    q0[robot.joint_indices] = [-1.2, 0.4]
    return q0


def test_pendulum_falls_as_its_energy_says() -> None:
    robot = dn.load_robot(planar_chain([RIGID]), gravity=DOWN)
    run = dn.simulate(robot, np.zeros(1), np.zeros(1), np.linspace(0.0, 1.0, 51))
    # A rod about its end: l thetadot^2 / 3 = -g sin(theta).
    rate = np.sqrt(np.maximum(0.0, -3.0 * 9.81 * np.sin(run.q[:, 0])))
    np.testing.assert_allclose(np.abs(run.qd[:, 0]), rate, atol=1e-6)


def test_output_does_not_depend_on_the_output_times(arm: dn.Robot) -> None:
    fine = dn.simulate(arm, start(arm), np.zeros(arm.n), np.linspace(0.0, 0.5, 51))
    coarse = dn.simulate(arm, start(arm), np.zeros(arm.n), np.linspace(0.0, 0.5, 6))
    np.testing.assert_allclose(fine.q[::10], coarse.q, atol=1e-12)


def test_work_of_the_torque_is_the_gain_of_energy(arm: dn.Robot) -> None:
    joints = np.asarray(arm.joint_indices)

    def torque(t: float, _q: Array, _qd: Array) -> Array:
        tau = np.zeros(arm.n)
        tau[joints] = [20.0 * np.sin(3.0 * t), -5.0]
        return tau

    run = dn.simulate(
        arm, start(arm), np.zeros(arm.n), np.linspace(0.0, 0.5, 2001), torque=torque, rtol=1e-10
    )
    power = np.sum(run.torque * run.qd, axis=1)
    work = np.sum(0.5 * (power[1:] + power[:-1]) * np.diff(run.t))
    total = run.energy.sum(axis=1)
    assert total[-1] - total[0] == pytest.approx(work, rel=1e-4)  # trapezoids of 0.25 ms


@pytest.mark.long
def test_prescribed_joint_moves_as_prescribed_and_its_torque_reproduces_the_motion(
    arm: dn.Robot,
) -> None:
    q0, qd0 = start(arm), np.zeros(arm.n)
    first = int(arm.joint_indices[0])
    q0[first], qd0[first] = swing(0.0)[:2]
    times = np.linspace(0.0, 0.4, 401)
    run = dn.simulate(arm, q0, qd0, times, prescribed={'joint_1': swing}, rtol=1e-10)
    np.testing.assert_allclose(run.q[:, first], [swing(t)[0] for t in times], atol=1e-15)
    needed = np.zeros((len(times), arm.n))
    needed[:, first] = run.torque[:, first]
    assert np.ptp(needed[:, first]) > 1.0

    def torque(t: float, _q: Array, _qd: Array) -> Array:
        tau = np.zeros(arm.n)
        tau[first] = np.interp(t, times, needed[:, first])
        return tau

    again = dn.simulate(arm, q0, qd0, times, torque=torque)
    np.testing.assert_allclose(again.q, run.q, atol=2e-5)  # torque interpolated over 1 ms


def test_all_joints_prescribed_leave_the_amplitudes_free(arm: dn.Robot) -> None:
    q0, qd0 = np.zeros(arm.n), np.zeros(arm.n)
    for index in arm.joint_indices:
        q0[index], qd0[index] = swing(0.0)[:2]
    run = dn.simulate(
        arm, q0, qd0, np.linspace(0.0, 0.3, 31), prescribed=dict.fromkeys(arm.joint_names, swing)
    )
    for row in (5, 17, 30):
        qdd = np.zeros(arm.n)
        qdd[:] = arm.forward_dynamics(run.q[row], run.qd[row], run.torque[row])
        np.testing.assert_allclose(
            qdd[arm.joint_indices], swing(run.t[row])[2], atol=1e-8, rtol=1e-8
        )


def test_mimic_joint_stays_tied_and_energy_is_conserved() -> None:
    robot = dn.load_robot(MIMIC, gravity=DOWN)
    lead, follow = robot.joint_names.index('lead'), robot.joint_names.index('follow')
    q0 = np.zeros(2)
    q0[lead], q0[follow] = 0.2, -0.1
    run = dn.simulate(robot, q0, np.zeros(2), np.linspace(0.0, 1.0, 101), rtol=1e-10)
    np.testing.assert_allclose(run.q[:, follow], 0.3 - 2.0 * run.q[:, lead], atol=1e-14)
    assert np.ptp(run.q[:, lead]) > 0.1
    assert run.energy_drift < 1e-8


def test_prescribed_leader_takes_its_mimic_along() -> None:
    robot = dn.load_robot(MIMIC, gravity=DOWN)
    lead, follow = robot.joint_names.index('lead'), robot.joint_names.index('follow')
    q0, qd0 = np.zeros(2), np.zeros(2)
    q0[lead], qd0[lead] = swing(0.0)[:2]
    q0[follow], qd0[follow] = 0.3 - 2.0 * q0[lead], -2.0 * qd0[lead]
    run = dn.simulate(robot, q0, qd0, np.linspace(0.0, 0.5, 11), prescribed={'lead': swing})
    np.testing.assert_allclose(run.q[:, follow], 0.3 - 2.0 * run.q[:, lead], atol=1e-14)
    power = run.torque[:, lead] * run.qd[:, lead]
    assert np.all(run.torque[:, follow] == 0.0)
    fine = dn.simulate(robot, q0, qd0, np.linspace(0.0, 0.5, 5001), prescribed={'lead': swing})
    gain = np.gradient(fine.energy.sum(axis=1), fine.t)[::500]
    np.testing.assert_allclose(power[1:-1], gain[1:-1], atol=1e-4)


def test_mimic_that_starts_off_its_tie_is_refused() -> None:
    robot = dn.load_robot(MIMIC, gravity=DOWN)
    with pytest.raises(dn.StateError, match=r"'follow' at the start must be 0.3 as"):
        dn.simulate(robot, np.zeros(2), np.zeros(2), np.linspace(0.0, 1.0, 3))


def test_implicit_method_agrees_with_the_explicit_one(arm: dn.Robot) -> None:
    times = np.linspace(0.0, 0.05, 6)
    explicit = dn.simulate(arm, start(arm), np.zeros(arm.n), times)
    implicit = dn.simulate(arm, start(arm), np.zeros(arm.n), times, method='Radau')
    np.testing.assert_allclose(implicit.q, explicit.q, atol=1e-7)


def test_torque_that_blows_up_is_a_solver_error_with_the_time_reached(arm: dn.Robot) -> None:
    def push(_t: float, _q: Array, qd: Array) -> Array:
        return 1e4 * qd * np.abs(qd) + 1.0

    with pytest.raises(dn.SolverError, match=r'must reach t = 1 s, got to [0-9.e-]+ s after'):
        dn.simulate(arm, start(arm), np.zeros(arm.n), np.linspace(0.0, 1.0, 3), torque=push)


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'q0': np.zeros(3)}, r'q0 must have shape \(4,\), got \(3,\)'),
        ({'qd0': np.full(4, np.nan)}, 'qd0 must be finite'),
        ({'t': np.array([0.0, 0.0])}, 'strictly increasing'),
        ({'t': np.zeros(0)}, 'k >= 1'),
        ({'torque': lambda *_: np.zeros(2)}, r'torque must have shape \(4,\), got \(2,\)'),
        ({'torque': lambda *_: np.full(4, np.inf)}, 'torque must be finite'),
        ({'prescribed': {'elbow': swing}}, "must be one of joint_1, joint_2, got 'elbow'"),
        ({'method': 'Euler'}, "method must be one of DOP853.*got 'Euler'"),
    ],
)
def test_bad_arguments_are_refused_with_what_must_hold(
    arm: dn.Robot, change: dict[str, object], message: str
) -> None:
    arguments: dict[str, object] = {
        'q0': start(arm),
        'qd0': np.zeros(arm.n),
        't': np.linspace(0.0, 0.1, 2),
    }
    with pytest.raises(dn.StateError, match=message):
        dn.simulate(arm, **{**arguments, **change})  # type: ignore[arg-type]
