"""What chapter 4 of the book says of its six-link arms; docs/book.md has the figures."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from book_runs import CONFIG, desired, joints, shipped, tips, until
from scipy.integrate import simpson, solve_ivp

from denoc_ros.types import Array

RIGID_SSRMS = {f'beam.link_{k}.{axis}.modes': 0 for k in (2, 3) for axis in 'yz'}
UNDAMPED_SSRMS = {f'beam.link_{k}.{axis}.damping_ratio': 0.0 for k in (2, 3) for axis in 'yz'}


def fall_by_pinocchio(robot: str, times: Array) -> Array:
    """Joint angles (k, n) of a robot that falls from rest at zero, by pin.aba."""
    model = pin.buildModelFromXML((CONFIG / 'robots' / f'{robot}.urdf').read_text())
    data, n = model.createData(), model.nv
    assert model.nq == n

    def rate(_t: float, state: Array) -> Array:
        q, qd = state[:n], state[n:]
        return np.concatenate([qd, pin.aba(model, data, q, qd, np.zeros(n))])

    found = solve_ivp(
        rate, (0.0, times[-1]), np.zeros(2 * n), 'DOP853', times, rtol=1e-10, atol=1e-12
    )
    return np.asarray(found.y[:n].T)


# The motion multiplies the integrators' errors: to 1e-8 per step, by 1e2 in the PUMA's whipping
# link of 20 mm.
@pytest.mark.parametrize(
    ('robot', 'scenario', 'tolerance'),
    [('puma', 'puma_free_fall', 1e-5), ('stanford', 'stanford_free_fall', 1e-6)],
)
def test_rigid_arms_fall_as_pinocchio_says(robot: str, scenario: str, tolerance: float) -> None:
    model, fall = shipped(robot, scenario)
    run = fall.run(model)
    np.testing.assert_allclose(run.q, fall_by_pinocchio(robot, fall.times), rtol=0, atol=tolerance)
    assert run.energy_drift < 1e-8  # the book's runs are "unstable beyond this point"


def test_puma_follows_its_inverse_dynamics() -> None:
    model, forced = shipped('puma', 'puma')
    assert np.max(np.abs(joints(model, forced.run(model)) - desired(forced))) < 1e-8


def test_stanford_arm_with_its_prismatic_joint_follows_its_inverse_dynamics() -> None:
    model, forced = shipped('stanford', 'stanford_forced')
    run = forced.run(model)
    assert np.max(np.abs(joints(model, run) - desired(forced))) < 1e-8
    slide = model.joint_names.index('joint_3')
    assert run.q[-1, slide] == pytest.approx(0.3 * np.pi - 0.5 * np.sin(0.6 * np.pi), abs=1e-8)


@pytest.mark.long
def test_flexible_second_link_carries_the_stanford_arm_off() -> None:
    model, forced = shipped('stanford_flexible', 'stanford_forced')
    run = forced.run(model)
    stray = np.max(np.abs(joints(model, run) - desired(forced)), axis=1)
    # open loop and top heavy: it strays ever faster
    np.testing.assert_allclose(stray[[100, 200]], [0.020, 0.061], rtol=0.05)
    assert stray[300] == pytest.approx(0.27, rel=0.1)
    tip = tips(model, run, 'link_2')
    # a short, stiff link: of 0.43 m, 1 %
    assert np.max(np.abs(tip[:, 1])) == pytest.approx(4.1e-3, rel=0.05)
    assert np.max(np.abs(tip[:, 2])) == pytest.approx(3.4e-3, rel=0.05)


def test_flexible_second_link_changes_the_stanford_arms_fall_a_little() -> None:
    (rigid, fall), (flexible, other) = (
        shipped(robot, 'stanford_free_fall') for robot in ('stanford', 'stanford_flexible')
    )
    run = until(other, 1.0).run(flexible)
    gap = np.abs(joints(flexible, run) - joints(rigid, until(fall, 1.0).run(rigid)))
    np.testing.assert_array_less(np.max(gap, axis=0), [0.03, 0.03, 0.04, 0.05, 0.11, 0.04])
    assert np.max(gap) > 0.05
    assert run.energy_drift < 1e-8


def test_rigid_ssrms_follows_its_inverse_dynamics() -> None:
    robot, forced = shipped('ssrms', 'ssrms', RIGID_SSRMS)
    # outputs between the long steps are the integrator's interpolation
    assert np.max(np.abs(joints(robot, forced.run(robot)) - desired(forced))) < 5e-8


def test_flexible_ssrms_strays_and_bends_in_both_planes() -> None:
    robot, forced = shipped('ssrms', 'ssrms')
    run = forced.run(robot)
    stray = np.max(np.abs(joints(robot, run) - desired(forced)), axis=0)
    np.testing.assert_allclose(stray, [0.046, 0.041, 0.069, 0.137, 0.051, 0.205], rtol=0.03)
    for link, peaks in (('link_2', [0.293, 0.224]), ('link_3', [0.180, 0.145])):
        found = np.max(np.abs(tips(robot, run, link)), axis=0)
        np.testing.assert_allclose(found[1:], peaks, rtol=0.02)


def test_work_of_the_torques_is_the_undamped_ssrms_energy() -> None:
    robot, forced = shipped('ssrms', 'ssrms', UNDAMPED_SSRMS)
    fine = until(forced, 2.0)
    times = np.linspace(0.0, 2.0, 2001)
    run = type(fine)(fine.q0, fine.qd0, times, fine.torque, rtol=1e-10).run(robot)
    work = simpson(np.sum(run.torque * run.qd, axis=1), x=times)
    total = run.energy.sum(axis=1)
    # Simpson's rule on vibrations of 146 rad/s at 1 ms
    assert total[-1] - total[0] == pytest.approx(work, rel=1e-6)
