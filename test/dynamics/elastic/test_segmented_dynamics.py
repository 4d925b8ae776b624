"""Dynamics of links of segments, in space: against the dense oracle, references and energy."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from oracles import Oracle
from planar_chains import SINGLE_LINK, planar_chain, reference
from segmented_robots import cable_text, rod, spatial_text
from strategies import random_state

import denoc_ros as dn
from denoc_ros.dynamics.elastic.deflection import TipDeflections
from denoc_ros.types import Array

Close = Callable[[Array, Array, float], None]
GRAVITY = (0.7, -1.3, -9.6)
ROUNDING = 1e-10  # of modal integrals in two ways, over a chain of eight bodies


@pytest.mark.parametrize('segments', [2, 3])
def test_every_verb_is_the_dense_oracle_s(close: Close, segments: int) -> None:
    robot = dn.load_robot(spatial_text(segments), gravity=GRAVITY)
    oracle = Oracle(robot.tree, GRAVITY)
    for seed in (1, 2):
        s = random_state(robot.coordinate_names, seed)
        tau = oracle.inverse_dynamics(s.q, s.qd, s.qdd)
        close(robot.inverse_dynamics(s.q, s.qd, s.qdd), tau, ROUNDING)
        close(robot.inertia_matrix(s.q), oracle.inertia_matrix(s.q), ROUNDING)
        close(robot.energy(s.q, s.qd), np.array(oracle.energy(s.q, s.qd)), ROUNDING)
        residual = oracle.inertia_matrix(s.q) @ robot.forward_dynamics(s.q, s.qd, tau)
        close(residual, tau - oracle.bias_forces(s.q, s.qd), ROUNDING)
        for frame in ('hand', 'side', 'arm', 'middle', 'fore'):
            close(robot.frame_pose(frame, s.q), oracle.frame_pose(frame, s.q), ROUNDING)


def test_undeformed_it_is_the_rigid_robot(close: Close) -> None:
    divided, rigid = dn.load_robot(spatial_text(3)), dn.load_robot(spatial_text(1))
    q = np.random.default_rng(4).uniform(-1.0, 1.0, 3)
    found = []
    for robot in (divided, rigid):
        at = [robot.joint_indices[robot.joint_names.index(n)] for n in rigid.joint_names]
        state, rate = np.zeros((2, robot.n))
        state[at], rate[at] = q, 2.0 * q
        tau = robot.inverse_dynamics(state, rate, rate)
        found.append((tau[at], robot.inertia_matrix(state)[np.ix_(at, at)]))
    close(found[0][0], found[1][0], 1e-11)  # to rounding
    close(found[0][1], found[1][1], 1e-11)


def test_a_falling_cable_keeps_its_energy() -> None:
    robot = dn.load_robot(cable_text(20), gravity=(0.0, -9.81, 0.0))
    zero = np.zeros(robot.n)
    run = dn.simulate(robot, zero, zero, np.linspace(0.0, 1.2, 61), rtol=1e-10, atol=1e-12)
    deflection = [robot.tip_deflection('cable', q)[1] for q in run.q]
    assert np.ptp(deflection) > 1.0  # m, of a length of 2 m
    total = run.energy.sum(axis=1)
    assert np.ptp(total) <= 1e-8 * run.energy[:, 0].max()


def test_the_cable_s_tip_falls_as_that_of_a_finer_one() -> None:
    tips = []
    for segments in (10, 20, 40):
        robot = dn.load_robot(cable_text(segments), gravity=(0.0, -9.81, 0.0))
        zero = np.zeros(robot.n)
        run = dn.simulate(robot, zero, zero, np.linspace(0.0, 0.6, 31), rtol=1e-8)
        turned = robot.joint_indices[0]
        tip = [np.array([2.0, 0.0, 0.0]) + robot.tip_deflection('cable', q) for q in run.q]
        angle = run.q[:, turned]
        tips.append(
            np.array([
                [np.cos(a) * p[0] - np.sin(a) * p[1], np.sin(a) * p[0] + np.cos(a) * p[1]]
                for a, p in zip(angle, tip, strict=True)
            ])
        )  # fmt: skip
    coarse, fine = (np.abs(tips[k] - tips[k + 1]).max() for k in (0, 1))
    assert fine < 0.5 * coarse
    assert fine < 0.01


@pytest.mark.long
def test_single_link_swings_over_ten_seconds_as_finite_segments_do() -> None:
    text = planar_chain(SINGLE_LINK, 2).replace('shape="clamped-free"', 'segments="4"')
    robot = dn.load_robot(text, gravity=(0.0, 0.0, 0.0))
    step = np.zeros(robot.n)
    step[0] = 5.0
    zero, times = np.zeros(robot.n), np.linspace(0.0, 10.0, 1001)
    run = dn.simulate(robot, zero, zero, times, torque=lambda *_: step, rtol=1e-7)
    table, tips = reference('single_link'), TipDeflections(robot)
    v = np.array([tips.evaluate(q, zero)[0][1] for q in run.q])
    # the direction of the tip from the root: the root's tangent is noisy (reference's README)
    seen = run.q[:, 0] + np.arctan2(v, 8.0)
    true = table['th1'] + np.arctan2(table['v1'], 8.0)
    # reached: 2.1e-3 rad over all 10 s, with 8 segments 6.8e-4; one beam: 1.3e-2
    assert np.abs(seen - true).max() <= 2.5e-3


def test_gradients_are_those_of_differences(close: Close) -> None:
    robot = dn.load_robot(spatial_text(2), gravity=GRAVITY)
    s = random_state(robot.coordinate_names, 5)
    by_q = robot.inverse_dynamics_derivatives(s.q, s.qd, s.qdd)[0]
    step = 1e-6
    columns = [
        (
            robot.inverse_dynamics(s.q + e, s.qd, s.qdd)
            - robot.inverse_dynamics(s.q - e, s.qd, s.qdd)
        )
        / (2.0 * step)
        for e in step * np.eye(robot.n)
    ]
    close(by_q, np.array(columns).T, 1e-7)  # of central differences


def test_the_rigidity_s_column_is_that_of_all_segments(close: Close) -> None:
    plain = dn.load_robot(spatial_text(3), gravity=GRAVITY)
    s = random_state(plain.coordinate_names, 6)
    # a damping ratio would change with the stiffness: a coefficient does not
    robot = plain.with_overrides({'beam.upper.y.damping': 0.1})
    values = {
        'beam.upper.y.ei': 11.0,
        'beam.upper.torsion.gj': 6.0,
        'beam.fore.torsion.gj': 3.0,
        'beam.upper.z.damping': 0.3,
        'beam.fore.z.damping_ratio': 0.02,
    }
    for path, value in values.items():
        less, more = (robot.with_overrides({path: v}) for v in (value, 2.0 * value))
        change = more.inverse_dynamics(s.q, s.qd, s.qdd) - less.inverse_dynamics(s.q, s.qd, s.qdd)
        column = less.torque_regressor(s.q, s.qd, s.qdd, [path])[:, 0]
        close(column * value, change, 1e-9)


def test_the_mass_s_columns_are_those_of_all_segments(close: Close) -> None:
    text = spatial_text(3)
    robot = dn.load_robot(text, gravity=GRAVITY)
    s = random_state(robot.coordinate_names, 7)
    # the forearm is a rod: of another mass its rigid rest is none again
    heavy = text.replace(rod('fore', 0.8, 0.5, 1e-3), rod('fore', 0.8, 0.75, 1e-3))
    polar = text.replace('polar_inertia="1e-3"', 'polar_inertia="2e-3"')
    for path, changed, by in (
        ('beam.fore.mass_per_length', heavy, 0.25 / 0.8),
        ('beam.upper.torsion.polar_inertia', polar, 1e-3),
    ):
        other = dn.load_robot(changed, gravity=GRAVITY)
        change = other.inverse_dynamics(s.q, s.qd, s.qdd) - robot.inverse_dynamics(
            s.q, s.qd, s.qdd
        )
        column = robot.torque_regressor(s.q, s.qd, s.qdd, [path])[:, 0]
        # differences of torques a hundred times as large
        close(column * by, change, 1e-9)
