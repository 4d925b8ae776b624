"""A floating base: six coordinates that nothing drives, its attitude a rotation vector."""

from __future__ import annotations

import re

import numpy as np
import pytest
from base_robots import (
    SIX,
    base_motion,
    description,
    floating,
    on_six_joints,
    root_of,
    spacecraft,
    states,
)
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from small_robots import joint as hinge
from small_robots import link

import denoc_ros as dn
from denoc_ros.dynamics.base.floating_base import wrap_attitude
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.dynamics.rotations import left_jacobians, rotation_vectors
from denoc_ros.errors import StateError
from denoc_ros.feedback.strain_damping import StrainDamping
from denoc_ros.types import Array

GRAVITY = (1.0, -9.0, 3.0)
ORIGIN = '<origin xyz="0.3 -0.2 0.5" rpy="0.4 -0.7 1.1"/>'
RELATIVE = 1e-10  # rounding of two recursions over up to 26 coordinates


def close(value: Array, expected: Array, relative: float = RELATIVE) -> None:
    scale = max(float(np.abs(expected).max(initial=0.0)), 1e-6)
    np.testing.assert_allclose(value, expected, rtol=0, atol=relative * scale)


def afloat(name: str, origin: str = ORIGIN, gravity: tuple[float, ...] = GRAVITY) -> Robot:
    return load_robot(floating(description(name), spacecraft(), origin), gravity)


@pytest.fixture(scope='module', params=['canadarm', 'ssrms', 'stanford_flexible', 'puma'])
def robot(request: pytest.FixtureRequest) -> Robot:
    return afloat(request.param)


def test_coordinates_of_the_base_are_neither_joints_nor_amplitudes(robot: Robot) -> None:
    parts = [f'base/{part}' for part in ('x', 'y', 'z', 'rx', 'ry', 'rz')]
    assert [robot.coordinate_names[k] for k in robot.base_indices] == parts
    assert 'base' not in robot.joint_names
    sets = (robot.joint_indices, robot.base_indices, robot.flexible_indices)
    assert sorted(np.concatenate(sets)) == list(range(robot.n))
    assert set(robot.free_indices) == set(sets[1]) | set(sets[2])


def test_a_base_that_is_not_the_first_in_the_file_is_found() -> None:
    text = f'<robot name="r"><link name="w"/>{link("a")}{link("b")}{hinge("j", "w", "a")}'
    text += '<joint name="f" type="floating"><parent link="w"/><child link="b"/></joint></robot>'
    robot = load_robot(text)
    assert robot.coordinate_names[0] == 'j'
    assert list(robot.base_indices) == [1, 2, 3, 4, 5, 6]


def test_pose_and_twist_are_those_of_the_coordinates(robot: Robot) -> None:
    q, qd, _ = states(robot, np.random.default_rng(1))
    frame = robot.frame_pose('base', q)
    turn = Rotation.from_euler('xyz', [0.4, -0.7, 1.1]).as_matrix()
    attitude = Rotation.from_rotvec(q[3:6]).as_matrix()
    np.testing.assert_allclose(frame[:3, :3], turn @ attitude, rtol=0, atol=1e-14)
    np.testing.assert_allclose(frame[:3, 3], [0.3, -0.2, 0.5] + turn @ q[:3], rtol=0, atol=1e-14)
    twist = robot.frame_motion('base', q, qd)[0]
    np.testing.assert_allclose(twist[:3], turn @ qd[:3], rtol=0, atol=1e-13)
    spin = turn @ left_jacobians(q[3:6]) @ qd[3:6]
    np.testing.assert_allclose(twist[3:], spin, rtol=0, atol=1e-13)
    found, rates = robot.base_coordinates(frame, twist)
    np.testing.assert_allclose(found, q[:6], rtol=0, atol=1e-13)
    np.testing.assert_allclose(rates, qd[:6], rtol=0, atol=1e-12)


def test_verbs_agree_with_each_other(robot: Robot) -> None:
    q, qd, qdd = states(robot, np.random.default_rng(2))
    tau = robot.inverse_dynamics(q, qd, qdd)
    close(robot.inertia_matrix(q) @ qdd + robot.bias_forces(q, qd), tau)
    close(robot.forward_dynamics(q, qd, tau), qdd, 1e-9)  # a heavy base before a light arm
    joints, free = robot.joint_indices, robot.free_indices
    torque, rest = robot.hybrid_dynamics(q, qd, qdd[joints], tau=tau)
    close(torque, tau[joints], 1e-9)
    close(rest, qdd[free], 1e-9)


def test_derivatives_are_differences(robot: Robot) -> None:
    q, qd, qdd = states(robot, np.random.default_rng(3))
    by_q, by_rate, inertia = robot.inverse_dynamics_derivatives(q, qd, qdd)
    step = 1e-5 * np.eye(robot.n)
    ahead = robot.inverse_dynamics(q + step, qd, qdd) - robot.inverse_dynamics(q - step, qd, qdd)
    close(by_q, ahead.T / 2e-5, 1e-7)  # differences of second order
    ahead = robot.inverse_dynamics(q, qd + step, qdd) - robot.inverse_dynamics(q, qd - step, qdd)
    close(by_rate, ahead.T / 2e-5, 1e-7)
    close(inertia, robot.inertia_matrix(q))
    tau = robot.inverse_dynamics(q, qd, qdd)
    inverse = robot.forward_dynamics_derivatives(q, qd, tau)[2]
    close(inverse @ inertia, np.eye(robot.n), 1e-8)


def test_equals_the_same_robot_on_six_joints(robot: Robot) -> None:
    """The same motion of the base in other coordinates: the rows of joints and amplitudes."""
    name = robot.tree.name
    text = description(name if name != 'stanford' else 'stanford_flexible')
    root = root_of(text)
    carried = load_robot(on_six_joints(text), GRAVITY)
    free = load_robot(floating(text, spacecraft()), GRAVITY)
    q6, qd6, qdd6 = states(carried, np.random.default_rng(4))
    pose = carried.frame_pose(root, q6)
    motion = carried.frame_motion(root, q6, qd6, qdd6)
    place, rate = free.base_coordinates(pose, motion[0])
    q, qd = np.append(place, q6[6:]), np.append(rate, qd6[6:])
    # the base's own accelerations from those of its frame
    jacobian = free.frame_jacobian(root, q)[:, :6]
    bias = free.frame_motion(root, q, qd)[1]
    qdd = np.append(np.linalg.solve(jacobian, motion[1] - bias), qdd6[6:])
    close(free.inverse_dynamics(q, qd, qdd)[6:], carried.inverse_dynamics(q6, qd6, qdd6)[6:])
    still = load_robot(text, GRAVITY)
    base = base_motion(carried, root, (q6, qd6, qdd6))
    moved = still.inverse_dynamics(q[6:], qd[6:], qdd[6:], base=base)
    close(free.inverse_dynamics(q, qd, qdd)[6:], moved)
    assert set(SIX) <= set(carried.joint_names)


def test_momentum_is_the_power_of_the_inertia_on_the_base() -> None:
    """Its conjugates of translations and of small turns about the origin, by I(q)."""
    free = load_robot(floating(description('ssrms'), spacecraft()), GRAVITY)
    q, qd, _ = states(free, np.random.default_rng(5))
    linear, angular = np.split(free.momentum(q, qd), 2)
    conjugate = free.inertia_matrix(q) @ qd
    close(linear, conjugate[:3])
    turning = np.linalg.solve(left_jacobians(q[3:6]).T, conjugate[3:6])
    close(angular, turning + np.cross(q[:3], linear))


def test_base_wrench_is_what_the_base_rows_ask_for(robot: Robot) -> None:
    q, qd, qdd = states(robot, np.random.default_rng(6))
    tau = robot.inverse_dynamics(q, qd, qdd)
    wrench = robot.base_wrench(q, tau)
    left = robot.inverse_dynamics(q, qd, qdd, wrenches={'base': wrench})
    np.testing.assert_allclose(left[:6], 0.0, atol=1e-10 * np.abs(tau).max())


def test_held_joints_leave_six_rigid_motions(robot: Robot) -> None:
    weightless = load_robot(robot.tree.source, (0, 0, 0))
    q = np.zeros(robot.n)
    frequencies = weightless.natural_frequencies(q, held=True)
    assert len(frequencies) == 6 + len(robot.flexible_indices)
    np.testing.assert_allclose(frequencies[:6], 0.0, atol=1e-3)
    assert np.all(frequencies[6:] > 0.05)
    everything = weightless.natural_frequencies(q, held=False)
    assert np.sum(np.abs(everything) < 1e-3) == 6 + len(robot.joint_indices)


def test_free_beam_on_a_light_hub() -> None:
    """A clamped-free beam whose clamp floats without mass: the frequencies of a free beam."""
    beam = '<bending direction="y" ei="1e4" modes="10"/>'
    inertial = '<inertial><origin xyz="1.5 0 0"/><mass value="6"/>'
    inertial += '<inertia ixx="0" iyy="4.5" izz="4.5"/></inertial>'
    text = f'<robot name="r"><link name="arm">{inertial}</link><flexibility>'
    text += f'<beam link="arm" length="3">{beam}</beam></flexibility></robot>'
    robot = load_robot(floating(text), (0, 0, 0))
    # no inertia about its axis: that one turn is held
    moving = [k for k in range(robot.n) if robot.coordinate_names[k] != 'base/rx']
    block = np.ix_(moving, moving)
    inertia, stiff = (
        robot.inertia_matrix(np.zeros(robot.n))[block],
        np.diag(robot.stiffness)[block],
    )
    squares = np.linalg.eigvals(np.linalg.solve(inertia, stiff)).real
    lowest = np.sqrt(np.sort(squares)[5])  # after the rigid motions
    exact = 4.730040745**2 * np.sqrt(1e4 / 2.0) / 3.0**2
    # ten clamped-free shapes make up a free one to second order of what they lack
    np.testing.assert_allclose(lowest, exact, rtol=2e-3)


angles = st.tuples(*[st.floats(-1.0, 1.0)] * 3, st.floats(0.0, 3.1)).map(
    lambda x: np.array(x[:3]) / max(float(np.linalg.norm(x[:3])), 1e-9) * x[3]
)


@given(angles)
def test_rotation_vector_undoes_the_exponential(phi: Array) -> None:
    found = rotation_vectors(Rotation.from_rotvec(phi).as_matrix())
    np.testing.assert_allclose(found, phi, rtol=0, atol=1e-7)  # near pi the sine is small


@pytest.mark.parametrize('axis', np.eye(3).tolist() + [[0.6, 0.0, -0.8]])
def test_rotation_vector_of_half_turns(axis: list[float]) -> None:
    matrix = Rotation.from_rotvec(np.pi * np.array(axis)).as_matrix()
    found = rotation_vectors(matrix)
    np.testing.assert_allclose(Rotation.from_rotvec(found).as_matrix(), matrix, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(found), np.pi, rtol=1e-12)


@given(angles, angles, st.integers(1, 3))
def test_wrapping_keeps_attitude_and_angular_velocity(phi: Array, rate: Array, turns: int) -> None:
    angle = float(np.linalg.norm(phi))
    if angle < 1e-3:
        return
    long = phi * (1.0 + 2.0 * np.pi * turns / angle)
    wrapped, rates = wrap_attitude(long, rate)
    assert np.linalg.norm(wrapped) <= np.pi + 1e-12
    one, other = (Rotation.from_rotvec(x).as_matrix() for x in (long, wrapped))
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        left_jacobians(wrapped) @ rates, left_jacobians(long) @ rate, rtol=0, atol=1e-9
    )


def test_states_are_wrapped_row_by_row(robot: Robot) -> None:
    q, qd = np.zeros((2, 2, robot.n))
    q[1, 3:6], qd[1, 3:6] = [0.0, 4.0, 0.0], [1.0, 2.0, 3.0]
    wrapped, rates = robot.wrap_base(q, qd)
    np.testing.assert_allclose(wrapped[1, 3:6], [0.0, 4.0 - 2.0 * np.pi, 0.0])
    for k in range(2):
        one = robot.frame_motion('base', q[k], qd[k])
        np.testing.assert_allclose(
            robot.frame_motion('base', wrapped[k], rates[k])[0], one[0], rtol=0, atol=1e-12
        )


def test_a_fixed_base_has_no_such_coordinates() -> None:
    fixed = dn.load_robot(description('canadarm'))
    assert not len(fixed.base_indices)
    with pytest.raises(StateError, match='must have a floating joint, got a fixed base'):
        fixed.wrap_base(np.zeros(fixed.n), np.zeros(fixed.n))


def with_springs(text: str) -> str:
    """The description with an elastic first joint."""
    name = load_robot(text).joint_names[0]
    text = re.sub(f'<actuator joint="{name}"[^>]*/>', '', text)
    spring = (
        f'<spring joint="{name}" stiffness="1e4" damping="3"/>'
        f'<actuator joint="{name}" armature="2"/>'
    )
    return text.replace('</flexibility>', f'{spring}</flexibility>')


def test_elastic_joints_on_bases_that_move_and_float() -> None:
    """What the link side of a spring sees of the base is what all bodies see."""
    text = with_springs(description('canadarm'))
    free = load_robot(floating(text, spacecraft()), GRAVITY)
    q, qd, qdd = states(free, np.random.default_rng(9))
    tau = free.inverse_dynamics(q, qd, qdd)
    close(free.inertia_matrix(q) @ qdd + free.bias_forces(q, qd), tau)
    close(free.forward_dynamics(q, qd, tau), qdd, 1e-9)
    still, carried = load_robot(text, GRAVITY), load_robot(on_six_joints(text), GRAVITY)
    q6, qd6, qdd6 = states(carried, np.random.default_rng(10))
    base = base_motion(carried, root_of(text), (q6, qd6, qdd6))
    made = still.inverse_dynamics(q6[6:], qd6[6:], qdd6[6:], base=base)
    close(made, carried.inverse_dynamics(q6, qd6, qdd6)[6:])
    by_q = still.inverse_dynamics_derivatives(q6[6:], qd6[6:], qdd6[6:], base=base)[0]
    close(by_q, carried.inverse_dynamics_derivatives(q6, qd6, qdd6)[0][6:, 6:])
    close(still.energy(q6[6:], qd6[6:], base=base), carried.energy(q6, qd6))


def test_what_needs_a_known_base_says_so() -> None:
    robot = afloat('two_link_ff')
    with pytest.raises(StateError, match=r'strain feedback: the base of .* must be fixed'):
        StrainDamping(robot, robot.joint_names, [1.0, 1.0], [9.0, 9.0], 10.0)


def test_weight_does_nothing_to_the_modes_of_a_robot_that_falls(robot: Robot) -> None:
    weightless = load_robot(robot.tree.source, (0, 0, 0))
    q = np.zeros(robot.n)
    np.testing.assert_allclose(
        robot.natural_frequencies(q), weightless.natural_frequencies(q), rtol=1e-6, atol=1e-3
    )
