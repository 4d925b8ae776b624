"""Every verb against the dense oracle, on random flexible trees."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from oracles import Oracle
from scipy.linalg import block_diag
from strategies import law, random_state, robots, seeds

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.types import Array

Close = Callable[[Array, Array, float], None]
GRAVITY = (0.7, -1.3, -9.6)
ROUNDING = 1e-10  # of modal integrals in two ways, over a chain of six bodies


def pair(text: str, geometric_stiffness: bool = True) -> tuple[Robot, Oracle]:
    robot = load_robot(text, gravity=GRAVITY, geometric_stiffness=geometric_stiffness)
    return robot, Oracle(robot.tree, GRAVITY, geometric_stiffness)


@law(20)
@given(text=robots(), seed=seeds, geometric=st.booleans())
def test_inverse_dynamics_are_lagranges(
    close: Close, text: str, seed: int, geometric: bool
) -> None:
    robot, oracle = pair(text, geometric)
    s = random_state(robot.coordinate_names, seed)
    close(
        robot.inverse_dynamics(s.q, s.qd, s.qdd),
        oracle.inverse_dynamics(s.q, s.qd, s.qdd),
        ROUNDING,
    )
    close(robot.bias_forces(s.q, s.qd), oracle.bias_forces(s.q, s.qd), ROUNDING)


@law(20)
@given(text=robots(), seed=seeds, geometric=st.booleans())
def test_inertia_matrix_and_energy_are_lagranges(
    close: Close, text: str, seed: int, geometric: bool
) -> None:
    robot, oracle = pair(text, geometric)
    s = random_state(robot.coordinate_names, seed)
    close(robot.inertia_matrix(s.q), oracle.inertia_matrix(s.q), ROUNDING)
    close(np.array(robot.energy(s.q, s.qd)), np.array(oracle.energy(s.q, s.qd)), ROUNDING)


@law(20)
@given(text=robots(), seed=seeds)
def test_forward_dynamics_solve_the_dense_equation(close: Close, text: str, seed: int) -> None:
    robot, oracle = pair(text)
    s = random_state(robot.coordinate_names, seed)
    tau = np.random.default_rng(seed).uniform(-5, 5, robot.n)
    residual = oracle.inertia_matrix(s.q) @ robot.forward_dynamics(s.q, s.qd, tau)
    close(residual, tau - oracle.bias_forces(s.q, s.qd), ROUNDING)


@law(20)
@given(text=robots(), seed=seeds)
def test_recursion_is_the_dense_natural_orthogonal_complement(
    close: Close, text: str, seed: int
) -> None:
    robot, oracle = pair(text)
    s = random_state(robot.coordinate_names, seed)
    N_l, N_d = robot.denoc_matrices(s.q)
    close(N_l @ N_d @ s.qd, oracle.twists(s.q, s.qd), ROUNDING)
    assert N_l.shape == (len(N_l), len(N_l))
    np.testing.assert_array_equal(np.triu(N_l, 1), 0)
    np.testing.assert_array_equal(np.diag(N_l), 1)
    M = block_diag(*oracle.mass_matrices(s.q))
    armature = np.diag(oracle.joint_terms('armature'))
    close(robot.inertia_matrix(s.q), N_d.T @ N_l.T @ M @ N_l @ N_d + armature, ROUNDING)


@law(20)
@given(text=robots(), seed=seeds)
def test_frames_move_with_the_deflection(close: Close, text: str, seed: int) -> None:
    robot, oracle = pair(text)
    s = random_state(robot.coordinate_names, seed)
    for frame in robot.tree.frames:
        close(robot.frame_pose(frame, s.q), oracle.frame_pose(frame, s.q), 1e-12)
        close(robot.frame_jacobian(frame, s.q), oracle.frame_jacobian(frame, s.q), ROUNDING)
    for body in robot.tree.bodies:
        if body.beam is None or not any(body.beam.modes):
            continue
        length = body.beam.length
        for station in (0.37 * length, length):
            np.testing.assert_allclose(
                robot.tip_deflection(body.name, s.q, station),
                oracle.deflection(body.name, s.q, station),
                rtol=1e-12,
                atol=1e-15 * length,  # of the oracle's position less the station
            )


@law(20)
@given(text=robots(), seed=seeds)
def test_wrenches_enter_by_the_jacobian(close: Close, text: str, seed: int) -> None:
    robot, oracle = pair(text)
    s = random_state(robot.coordinate_names, seed)
    rng = np.random.default_rng(seed)
    wrenches = {frame: rng.uniform(-3, 3, 6) for frame in robot.tree.frames}
    loads = np.zeros(robot.n)
    for frame, wrench in wrenches.items():
        loads += robot.frame_jacobian(frame, s.q).T @ wrench
    free = robot.inverse_dynamics(s.q, s.qd, s.qdd)
    loaded = robot.inverse_dynamics(s.q, s.qd, s.qdd, wrenches=wrenches)
    close(loaded, free - loads, ROUNDING)
    close(loaded, oracle.inverse_dynamics(s.q, s.qd, s.qdd, wrenches), ROUNDING)
    tau = rng.uniform(-5, 5, robot.n)
    close(
        robot.forward_dynamics(s.q, s.qd, tau, wrenches=wrenches),
        robot.forward_dynamics(s.q, s.qd, tau + loads),
        1e-9,
    )
    flexible = np.setdiff1d(np.arange(robot.n), robot.joint_indices)
    qdd_joints = s.qdd[robot.joint_indices]
    _, amplitudes = robot.hybrid_dynamics(s.q, s.qd, qdd_joints, wrenches=wrenches)
    qdd = s.qdd.copy()
    qdd[flexible] = amplitudes
    rows = robot.inverse_dynamics(s.q, s.qd, qdd, wrenches=wrenches)[flexible]
    scale = max(1.0, float(np.abs(oracle.stiffness @ s.q).max()), float(np.abs(free).max()))
    np.testing.assert_allclose(rows, 0, atol=ROUNDING * scale)
