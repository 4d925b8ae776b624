"""The planar four-bar: wherever it is cut, whatever drives it, and where it is singular."""

from __future__ import annotations

import numpy as np
import pytest
from looped_robots import GROUND, LENGTHS, MASSES, four_bar, turning

import denoc_ros as dn
from denoc_ros.types import Array

CUTS = ('two', 'three', 'four')
G = 9.81


def angles(crank: float) -> Array:
    """Angles of the bars in the plane, crank's given, the coupler above."""
    a, b, c = LENGTHS.values()
    x, y = a * np.cos(crank) - GROUND, a * np.sin(crank)
    r = np.hypot(x, y)
    rocker = np.arctan2(y, x) - np.arccos((r**2 + c**2 - b**2) / (2 * r * c))
    tip = np.array([GROUND + c * np.cos(rocker) - a * np.cos(crank), c * np.sin(rocker) - y])
    return np.array([crank, np.arctan2(tip[1], tip[0]), rocker])


def state(robot: dn.Robot, crank: float, rate: float) -> tuple[Array, Array]:
    """Closed coordinates and rates with the crank's angle and rate."""
    T = turning(robot)
    q = robot.assemble(np.linalg.solve(T, angles(crank)))
    # the crank hangs on joint one in every cut
    qd = np.zeros(robot.n)
    qd[robot.coordinate_names.index('one')] = rate
    return q, robot.assemble_rates(q, qd, fixed=['one'])


def driven(robot: dn.Robot, torque: float) -> Array:
    tau = np.zeros(robot.n)
    tau[robot.coordinate_names.index('one')] = torque
    return tau


def test_every_cut_moves_alike() -> None:
    expected: dict[str, Array] = {}
    for cut in CUTS:
        robot = four_bar(cut)
        q, qd = state(robot, 0.8, 2.0)
        T = turning(robot)
        qdd, _ = robot.constrained_forward_dynamics(q, qd, driven(robot, 1.5))
        torque, _ = robot.constrained_inverse_dynamics(q, qd, qdd, ['one'])
        assert torque[0] == pytest.approx(1.5, abs=1e-9)
        for name, value in (('angle', T @ q), ('rate', T @ qd), ('acceleration', T @ qdd)):
            value = np.mod(value + np.pi, 2 * np.pi) if name == 'angle' else value
            # three ways to write the same numbers: rounding, through a 2 x 2 solve
            np.testing.assert_allclose(value, expected.setdefault(name, value), atol=1e-9)


def newton_euler(theta: Array, omega: Array, alpha: Array, torque: float) -> Array:
    """Forces (4, 2) that joints one to four put on the bar after them, by free bodies."""
    lengths, masses = np.array(list(LENGTHS.values())), np.array(list(MASSES.values()))
    along = np.stack([np.cos(theta), np.sin(theta)], axis=1)
    across = np.stack([-np.sin(theta), np.cos(theta)], axis=1)
    reach = lengths[:, None] * (alpha[:, None] * across - omega[:, None] ** 2 * along)
    start = np.array([[0.0, 0.0], reach[0], [0.0, 0.0]])
    centre = start + reach / 2
    A, b = np.zeros((9, 8)), np.zeros(9)
    # joints act on: crank at its start, coupler at its start (and crank's end), rocker's end (and
    # coupler's), rocker at its start
    acts = {
        0: ((0, 1.0, -0.5), (1, -1.0, 0.5)),
        1: ((1, 1.0, -0.5), (2, -1.0, 0.5)),
        2: ((2, 1.0, 0.5), (3, 1.0, -0.5)),
    }
    for bar, ends in acts.items():
        for joint, sign, place in ends:
            arm = place * lengths[bar] * along[bar]
            A[3 * bar : 3 * bar + 2, 2 * joint : 2 * joint + 2] = sign * np.eye(2)
            A[3 * bar + 2, 2 * joint : 2 * joint + 2] = sign * np.array([-arm[1], arm[0]])
        b[3 * bar : 3 * bar + 2] = masses[bar] * (centre[bar] + [0.0, G])
        b[3 * bar + 2] = masses[bar] * lengths[bar] ** 2 / 12 * alpha[bar]
    b[2] -= torque
    forces, _, rank, _ = np.linalg.lstsq(A, b, rcond=None)
    assert rank == 8
    np.testing.assert_allclose(A @ forces, b, atol=1e-9)
    return np.asarray(forces.reshape(4, 2))


@pytest.mark.parametrize(('cut', 'index'), [('two', 1), ('three', 2), ('four', 3)])
def test_multipliers_are_the_forces_of_free_bodies(cut: str, index: int) -> None:
    robot = four_bar(cut)
    q, qd = state(robot, 0.8, 2.0)
    qdd, multipliers = robot.constrained_forward_dynamics(q, qd, driven(robot, 1.5))
    T = turning(robot)
    forces = newton_euler(T @ q, T @ qd, T @ qdd, 1.5)
    parent = robot.frame_pose(f'{cut}/parent', q)[:3, :3]
    np.testing.assert_allclose((parent @ multipliers[:3])[:2], forces[index], atol=1e-9)
    # a planar loop does not say what its axis carries out of the plane: least norm is none
    np.testing.assert_allclose(multipliers[2:], 0.0, atol=1e-12)


def test_friction_of_a_cut_joint_is_that_of_a_joint() -> None:
    accelerations = []
    for cut in CUTS:
        robot = four_bar(cut, dynamics='damping="0.4" friction="0.3"')
        q, qd = state(robot, 0.8, 2.0)
        qdd, _ = robot.constrained_forward_dynamics(q, qd, driven(robot, 1.5))
        torque, _ = robot.constrained_inverse_dynamics(q, qd, qdd, ['one'])
        assert torque[0] == pytest.approx(1.5, abs=1e-9)
        accelerations.append(turning(robot) @ qdd)
    np.testing.assert_allclose(accelerations[1:], accelerations[:1] * 2, atol=1e-9)
    free = four_bar('two')
    q, qd = state(free, 0.8, 2.0)
    without, _ = free.constrained_forward_dynamics(q, qd, driven(free, 1.5))
    assert np.abs(turning(free) @ without - accelerations[0]).max() > 0.1


def test_any_joint_may_drive_and_more_share_with_the_least_torques() -> None:
    robot = four_bar('three')
    q, qd = state(robot, 0.8, 2.0)
    qdd, _ = robot.constrained_forward_dynamics(q, qd, driven(robot, 1.5))
    # work of every way to drive is the same: torque times rate
    power = 1.5 * qd[robot.coordinate_names.index('one')]
    alone = {}
    for joint in robot.joint_names:
        torque, _ = robot.constrained_inverse_dynamics(q, qd, qdd, [joint])
        rate = qd[robot.coordinate_names.index(joint)]
        # friction and gravity are the same in each, so all power differences are the drive's
        assert torque[0] * rate == pytest.approx(power, abs=1e-9)
        alone[joint] = torque[0]
    every, _ = robot.constrained_inverse_dynamics(q, qd, qdd, robot.joint_names)
    rates = qd[robot.joint_indices]
    # of all torques of this power the least are along the rates
    np.testing.assert_allclose(every, power * rates / (rates @ rates), atol=1e-9)
    tau = np.zeros(robot.n)
    tau[robot.joint_indices] = every
    again, _ = robot.constrained_forward_dynamics(q, qd, tau)
    np.testing.assert_allclose(again, qdd, atol=1e-9)


def test_impossible_accelerations_are_refused_with_the_residual() -> None:
    robot = four_bar('three')
    q, qd = state(robot, 0.8, 2.0)
    qdd, _ = robot.constrained_forward_dynamics(q, qd, np.zeros(robot.n))
    with pytest.raises(dn.StateError, match=r"qdd must keep 'three' closed, got [-0-9.]+ m/s\^2"):
        robot.constrained_inverse_dynamics(q, qd, qdd + 1.0, ['one'])
    qdd, _ = robot.constrained_forward_dynamics(q, qd, driven(robot, 1.5))
    with pytest.raises(dn.StateError, match=r'actuated joints can give, got .* left on'):
        robot.constrained_inverse_dynamics(q, qd, qdd, [])
    with pytest.raises(dn.SolverError, match=r"'three' must not contradict .* rank 0 of 5 rows"):
        robot.constrained_hybrid_dynamics(q, qd, np.ones(3), robot.joint_names)


def test_assembly_says_which_loop_stays_open_and_by_how_much() -> None:
    robot = four_bar('three', ground=2.5)
    with pytest.raises(dn.SolverError, match=r"'three' must close to 1e-10 .* got 0\.[0-9]+ at"):
        robot.assemble(np.zeros(3))
    robot = four_bar('three')
    with pytest.raises(dn.StateError, match=r"fixed must be some of .*, got \['five'\]"):
        robot.assemble(np.zeros(3), fixed=['five'])
    q, qd = state(robot, 0.8, 2.0)
    with pytest.raises(dn.SolverError, match="'three' must close"):
        robot.assemble_rates(q, qd + 1.0, fixed=robot.joint_names)


def test_axes_with_too_few_digits_are_suspected() -> None:
    text = four_bar('three').tree.source
    # the axis is the same on both sides only where the bars are in line
    tilted = text.replace('<axis xyz="0 0 1"/></loop>', '<axis xyz="0 1e-5 1"/></loop>')
    robot = dn.load_robot(tilted)
    with pytest.raises(dn.SolverError, match=r"'three' must close .* enough digits"):
        robot.assemble(np.full(3, 0.5))


def test_assembly_keeps_what_is_fixed_and_what_is_closed() -> None:
    robot = four_bar('three')
    q, _ = state(robot, 0.8, 2.0)
    np.testing.assert_allclose(robot.assemble(q), q, atol=1e-13)
    near = robot.assemble(q + [0.05, -0.1, 0.08], fixed=['one'])
    one = robot.coordinate_names.index('one')
    assert near[one] == q[one] + 0.05
    np.testing.assert_allclose(robot.closure(near), 0.0, atol=1e-12)


PARALLEL = {'crank': 0.4, 'coupler': 0.9, 'rocker': 0.4}


def swing(angle: float, torque: float) -> float:
    """Acceleration of a parallelogram's crank: the coupler does not turn."""
    r, (crank, coupler, rocker) = PARALLEL['crank'], MASSES.values()
    spin = (crank + rocker) * r**2 / 3 + coupler * r**2
    weight = G * r * np.cos(angle) * ((crank + rocker) / 2 + coupler)
    return float((torque - weight) / spin)


def parallelogram(crank: float, rate: float) -> tuple[dn.Robot, Array, Array]:
    robot = four_bar('three', PARALLEL, ground=0.9)
    T = turning(robot)
    q, qd = np.linalg.solve(T, [[crank, rate], [0.0, 0.0], [crank, rate]]).T
    return robot, q.astype(np.float64), qd.astype(np.float64)


@pytest.mark.parametrize('angle', [0.3, 1e-2, 1e-4, 1e-6, 1e-9, 0.0, -1e-5])
def test_a_parallelogram_passes_its_flat_position(angle: float) -> None:
    # flat, the rows of both cranks say the same and the bars could fold
    robot, q, qd = parallelogram(angle, 2.0)
    qdd, _ = robot.constrained_forward_dynamics(q, qd, driven(robot, 1.5))
    acceleration = turning(robot) @ qdd
    # while the rows count they have the solution to rounding over the angle; below 1e-6 of it
    # they are left out, and the bars are free to fold with whatever their own dynamics give
    if abs(angle) > 1e-5:
        expected = [swing(angle, 1.5), 0.0, swing(angle, 1.5)]
        np.testing.assert_allclose(acceleration, expected, atol=1e-8 / abs(angle))
    residual = robot.closure_jacobian(q) @ qdd + robot.closure_bias(q, qd)
    np.testing.assert_allclose(residual, 0.0, atol=1e-5)


def test_a_singular_configuration_that_cannot_move_on_is_named() -> None:
    robot, q, _ = parallelogram(0.0, 2.0)
    # the rates of both ways out at once: to first order the loop allows it
    T = turning(robot)
    qd = np.linalg.solve(T, [2.0, 1.0, 2.0 + 1.0 * 0.9 / 0.4])
    np.testing.assert_allclose(robot.closure_jacobian(q) @ qd, 0.0, atol=1e-12)
    with pytest.raises(dn.SolverError, match=r"'three' .* singular .* rank 1 of 5 rows, .* left"):
        robot.constrained_forward_dynamics(q, qd, np.zeros(robot.n))


def test_steps_keep_the_loop_closed_and_the_energy() -> None:
    robot = four_bar('three')
    q, qd = state(robot, 0.8, 8.0)
    start = sum(robot.energy(q, qd))
    drifts = []
    for step in (1e-3, 5e-4):
        here, rates, stepper = q.copy(), qd.copy(), dn.Stepper(robot.copy(), step)
        for _ in range(round(0.5 / step)):
            stepper.free(here, rates, np.zeros(robot.n))
            assert np.abs(robot.closure(here)).max() < 1e-12
            assert np.abs(robot.closure_jacobian(here) @ rates).max() < 1e-11
        drifts.append(abs(sum(robot.energy(here, rates)) - start) / start)
    assert drifts[1] < drifts[0] / 3 < 1e-4  # order 2


def test_every_cut_steps_alike() -> None:
    ends = []
    for cut in CUTS:
        robot = four_bar(cut, dynamics='damping="0.4" friction="0.3"')
        q, qd = state(robot, 0.8, 2.0)
        stepper = dn.Stepper(robot, 2.5e-4)
        for _ in range(400):
            stepper.free(q, qd, driven(robot, 1.5))
        ends.append(np.concatenate([turning(robot) @ q, turning(robot) @ qd]))
    # the steps differ in what is implicit and in the way back to the loop: by their errors
    ends = [np.where(np.arange(6) < 3, np.mod(end + np.pi, 2 * np.pi), end) for end in ends]
    np.testing.assert_allclose(ends[1:], ends[:1] * 2, atol=2e-5)


def test_stiff_damping_of_a_loop_is_no_danger_to_the_step() -> None:
    robot = four_bar('three', dynamics='damping="1e5" friction="20"')
    q, qd = state(robot, 0.8, 2.0)
    stepper = dn.Stepper(robot, 1e-3)
    for _ in range(200):
        stepper.free(q, qd, np.zeros(robot.n))
    # 1e5 N m s/rad on a few N m of weight: 1e-4 rad/s
    assert np.abs(qd).max() < 1e-3
    np.testing.assert_allclose(robot.closure(q), 0.0, atol=1e-12)


def test_driven_joints_move_as_told_and_the_others_follow() -> None:
    robot = four_bar('three')
    q, qd = state(robot, 0.8, 2.0)
    one = robot.coordinate_names.index('one')
    stepper = dn.Stepper(robot, 1e-3, driven=['one'])
    for _ in range(100):
        stepper.driven(q, qd, np.array([3.0]))
    assert q[one] == pytest.approx(0.8 + 0.2 + 0.015, abs=1e-12)
    assert qd[one] == pytest.approx(2.3, abs=1e-12)
    np.testing.assert_allclose(q, robot.assemble(q, fixed=['one']), atol=1e-12)
    out = np.zeros(robot.n)
    stepper.accelerations(q, qd, np.array([3.0]), out)
    _, expected, _ = robot.constrained_hybrid_dynamics(q, qd, np.array([3.0]), ['one'])
    np.testing.assert_allclose(out, expected, atol=1e-12)


def test_a_step_from_an_open_loop_is_refused_and_changes_nothing() -> None:
    robot = four_bar('three', ground=2.5)
    q, qd = np.zeros(robot.n), np.zeros(robot.n)
    with pytest.raises(dn.SolverError, match="'three' must"):
        dn.Stepper(robot, 1e-3).free(q, qd, np.zeros(robot.n))
    np.testing.assert_array_equal(q, 0.0)


def test_rows_of_states_that_include_a_singular_one_say_so() -> None:
    robot, q, _ = parallelogram(0.0, 2.0)
    T = turning(robot)
    good = np.linalg.solve(T, [2.0, 0.0, 2.0])
    bad = np.linalg.solve(T, [2.0, 1.0, 2.0 + 1.0 * 0.9 / 0.4])
    with pytest.raises(dn.SolverError, match='singular'):
        robot.constrained_forward_dynamics(q, np.array([good, bad]), np.zeros(robot.n))
