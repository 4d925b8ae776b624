"""Minimum time along a path: against TOPP-RA, and the limits of flexible robots."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from control_runs import ROBOTS, cycloid
from scipy.interpolate import make_interp_spline
from timed_paths import rigid_arm

import denoc_ros as dn
from denoc_ros.cli.session.phase_plans import motion_of
from denoc_ros.dynamics.driven.torque_feedforward import TorqueFeedforward
from denoc_ros.planning.timing.limit_rows import LimitRows, Moments, motion_limits
from denoc_ros.planning.timing.path_timing import Timing, TimingBasis
from denoc_ros.planning.tip.asked_motion import AskedMotion
from denoc_ros.planning.tip.targets import Target
from denoc_ros.planning.tip.tip_grid import TipGrids
from denoc_ros.planning.tip.tip_minimum_time import TipMinimumTime
from denoc_ros.planning.tip.tip_options import TipOptions
from denoc_ros.types import Array

TIMES = np.linspace(0.0, 10.0, 201)
CANADARM = cycloid(np.radians([10.0, 40.0, 30.0]), np.radians([60.0, 45.0, 30.0]), 10.0)
EFFORT = {'joint_1': 1500.0, 'joint_2': 700.0, 'joint_3': 180.0}


@pytest.fixture(scope='module')
def canadarm() -> dn.Robot:
    return dn.load_robot(ROBOTS / 'canadarm.urdf', gravity=(0, 0, 0))


@pytest.fixture(scope='module')
def plan(canadarm: dn.Robot) -> dn.Plan:
    return dn.shape_motion(canadarm, TIMES, CANADARM(TIMES), effort=EFFORT, time='minimum')


@pytest.mark.parametrize(('name', 'seed'), [('ur10', 2), ('panda', 0)])
def test_a_rigid_robot_takes_the_time_of_toppra(name: str, seed: int) -> None:
    arm = rigid_arm(name)
    plan = arm.fastest(seed)
    assert plan.t[-1] == pytest.approx(arm.toppra_duration(seed), rel=0.01)
    assert arm.largest_share(plan) <= 1.001


def test_friction_makes_a_rigid_robot_no_slower_than_toppra() -> None:
    arm = rigid_arm('ur10', friction=True)
    plan = arm.fastest(1)
    assert plan.t[-1] <= arm.toppra_duration(1)
    assert arm.largest_share(plan) <= 1.001


def test_a_flexible_arm_is_a_fifth_faster_than_stretched_as_a_whole(
    canadarm: dn.Robot, plan: dn.Plan
) -> None:
    stretched = dn.shape_motion(canadarm, TIMES, CANADARM(TIMES), effort=EFFORT)
    assert plan.stretch < 0.82 * stretched.stretch
    assert (np.abs(plan.torque) <= 1.001 * np.array(list(EFFORT.values()))).all()
    assert plan.tip_error.max() < 5e-5
    assert np.abs(plan.qd[[0, -1]]).max() < 1e-15


@pytest.mark.long_cases('0.008')
@pytest.mark.parametrize('step', [0.008, 0.02])
def test_the_least_time_does_not_depend_on_the_grid(
    canadarm: dn.Robot, plan: dn.Plan, step: float
) -> None:
    other = dn.shape_motion(
        canadarm, TIMES, CANADARM(TIMES), effort=EFFORT, time='minimum', step=step
    )
    assert other.stretch == pytest.approx(plan.stretch, rel=1e-3)


@pytest.mark.parametrize(
    ('options', 'least'),
    [
        pytest.param({}, 0.591, marks=pytest.mark.long),
        pytest.param({'preaction': 0.5, 'postaction': 0.5}, 0.591, marks=pytest.mark.long),
        ({'moment': 60.0}, 0.690),
    ],
)
def test_a_path_from_a_straight_arm_has_one_least_time(
    options: dict[str, Any], least: float
) -> None:
    """A bent arm does not reach as far as a straight one, so that an error stays at its start."""
    arm = dn.load_robot(ROBOTS / 'two_link_ff.urdf', gravity=(0, 0, 0))
    arm = arm.with_overrides({f'joint.{name}.armature': 0.5 for name in arm.joint_names})
    way = cycloid(np.zeros(2), np.full(2, 0.5), 1.0)(0.1 * TIMES)
    effort = dict(zip(arm.joint_names, (100.0, 40.0), strict=True))
    plans = [
        dn.shape_motion(
            arm, 0.1 * TIMES, way, time='minimum', turn=0.0, effort=effort, step=step, **options
        )
        for step in (0.0025, 0.004)
    ]
    for plan in plans:
        assert plan.stretch == pytest.approx(least, rel=7e-3)
        assert plan.limits is not None
        assert max(plan.limits.largest.values()) <= 1.001


@pytest.mark.long
def test_a_timing_of_more_pieces_follows_fast_modes() -> None:
    """By torques alone the least time drives the links' second modes to and fro."""
    arm = dn.load_robot(ROBOTS / 'two_link_ff.urdf', gravity=(0, 0, 0))
    arm = arm.with_overrides({f'joint.{name}.armature': 0.5 for name in arm.joint_names})
    way = cycloid(np.array([0.3, 0.6]), np.full(2, 0.5), 1.0)(0.1 * TIMES)
    few, more = (
        dn.shape_motion(
            arm, 0.1 * TIMES, way, time='minimum', turn=0.0, effort=[100.0, 40.0], pieces=pieces
        )
        for pieces in (14, 28)
    )
    assert more.stretch < 0.992 * few.stretch
    assert more.limits is not None
    assert max(more.limits.largest.values()) <= 1.001
    assert more.tip_error.max() < 2e-6
    with pytest.raises(dn.StateError, match='pieces'):
        dn.shape_motion(arm, 0.1 * TIMES, way, time='minimum', pieces=2)


def test_torques_of_a_short_motion_hold_at_the_ticks_of_a_loop() -> None:
    """They have peaks of a millisecond, between the nodes of the grid."""
    arm = dn.load_robot(ROBOTS / 'two_link_ff.urdf', gravity=(0, 0, 0))
    arm = arm.with_overrides({f'joint.{name}.armature': 0.5 for name in arm.joint_names})
    way = cycloid(np.array([0.3, 0.6]), np.full(2, 0.5), 1.0)(0.1 * TIMES)
    effort = np.array([100.0, 40.0])
    plan = dn.shape_motion(arm, 0.1 * TIMES, way, time='minimum', turn=0.0, effort=effort)
    ticks = np.arange(plan.t[0], plan.t[-1], 1e-3)
    motion = (make_interp_spline(plan.t, rows, k=3)(ticks) for rows in (plan.q, plan.qd, plan.qdd))
    torque = arm.inverse_dynamics(*motion)[:, arm.joint_indices]
    assert (np.abs(torque).max(axis=0) <= 1.001 * effort).all()


def test_limits_that_are_passed_between_nodes_are_made_narrower_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    beyond: list[float] = []
    narrow = LimitRows.narrow

    def count(rows: LimitRows, where: Array, shares: Array) -> None:
        beyond.append(float(shares.max()))
        narrow(rows, where, shares)

    monkeypatch.setattr(LimitRows, 'narrow', count)
    arm = dn.load_robot(ROBOTS / 'two_link_ff.urdf', gravity=(0, 0, 0))
    arm = arm.with_overrides({f'joint.{name}.armature': 0.5 for name in arm.joint_names})
    way = cycloid(np.array([0.3, 0.6]), np.array([0.8, 1.1]), 1.0)(0.1 * TIMES)
    effort = np.array([100.0, 40.0])
    plan = dn.shape_motion(
        arm, 0.1 * TIMES, way, time='minimum', turn=0.0, effort=effort, moment=60.0
    )
    assert len(beyond) == 1
    assert plan.limits is not None
    assert max(plan.limits.largest.values()) <= 1.001


def test_steps_near_singular_postures_settle_quickly() -> None:
    """Elastic turns that a wrist can hardly make are left, not followed to and fro."""
    arm = dn.load_robot(ROBOTS / 'ssrms.urdf', gravity=(0, 0, 0))
    random = np.random.default_rng(3)
    first = np.array([0.2, 0.5, -0.9, 0.4, 0.3, 0.2]) + random.uniform(-0.3, 0.3, 6)
    way = 0.5 * random.uniform(0.5, 1.1, 6)
    asked = AskedMotion(arm, 1.6 * TIMES, cycloid(first, way, 16.0)(1.6 * TIMES))
    grid = TipGrids(arm, arm.frame_names[-1:], arm.joint_indices, TipOptions()).solve(asked, 2.0)
    assert not grid.problem.curved
    assert grid.solved.iterations <= 3


def test_errors_that_stay_have_their_second_derivatives(canadarm: dn.Robot) -> None:
    random = np.random.default_rng(0)
    q = 0.2 * random.normal(size=(1, canadarm.n))
    pose = canadarm.frame_pose('tool', q)
    pose[:, :3, 3] += 1e-3 * random.normal(size=3)
    target = Target('tool', pose, 1.5, 0.3)

    def slope(at: Array) -> Array:
        errors = target.weighed(canadarm, at)
        return np.asarray(target.derivative(canadarm, at, errors)[0].T @ errors[0])

    ahead = np.array([slope(q + row) - slope(q - row) for row in 1e-5 * np.eye(canadarm.n)])
    jacobian = target.derivative(canadarm, q, target.weighed(canadarm, q))[0]
    expected = ahead / 2e-5 - jacobian.T @ jacobian
    found = target.curvature(canadarm, q, target.weighed(canadarm, q))[0]
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())


def test_torques_of_all_ticks_keep_the_limits_and_leave_the_arm_at_rest(
    canadarm: dn.Robot, plan: dn.Plan
) -> None:
    """Held for 2 ms each, as drives hold them, on an arm whose joints nothing else holds."""
    period, motion = 2e-3, motion_of(plan, canadarm.joint_names)
    feedforward, arm = TorqueFeedforward(canadarm.copy()), canadarm.copy()
    stepper, ticks = dn.Stepper(arm, 0.5 * period), int((motion.duration + 2.0) / period)
    wanted, rate, acceleration = np.zeros((3, 3))
    torque = np.zeros((ticks, arm.n))
    q, qd = plan.q[0].copy(), np.zeros(arm.n)
    for k, tau in enumerate(torque):
        motion.sample((k + 0.5) * period, wanted, rate, acceleration)
        tau[arm.joint_indices] = feedforward.update(
            wanted, rate, acceleration, period if k else 0.0
        )
        for _ in range(2):
            stepper.free(q, qd, tau)
    most = np.abs(torque[:, arm.joint_indices]).max(axis=0)
    assert (most <= 1.001 * np.array(list(EFFORT.values()))).all()
    stands = arm.frame_pose('tool', q)[:3, 3] - arm.frame_pose('tool', plan.q[-1])[:3, 3]
    assert np.linalg.norm(stands) < 5e-5


def test_what_binds_and_what_it_gains_is_told(canadarm: dn.Robot, plan: dn.Plan) -> None:
    assert plan.limits is not None
    assert {'effort joint_1', 'effort joint_2'} <= set(plan.limits.binding())
    # without gravity all efforts k times larger make it sqrt(k) times faster, but for the links
    assert sum(plan.limits.gains.values()) == pytest.approx(0.005, rel=0.2)
    more = {name: 1.05 * effort for name, effort in EFFORT.items()}
    faster = dn.shape_motion(
        canadarm, TIMES, CANADARM(TIMES), effort=more, time='minimum', near=plan
    )
    gained = 1.0 - faster.stretch / plan.stretch
    assert gained == pytest.approx(5.0 * sum(plan.limits.gains.values()), rel=0.35)


def test_the_best_plan_so_far_is_returned_when_asked_to_stop(canadarm: dn.Robot) -> None:
    asked: list[int] = []

    def stop() -> bool:
        asked.append(0)
        return len(asked) > 2

    found = dn.shape_motion(
        canadarm, TIMES, CANADARM(TIMES), effort=EFFORT, time='minimum', cancel=stop
    )
    assert found.limits is not None
    assert not found.limits.settled
    assert max(found.limits.largest.values()) <= 1.001


REST_TO_REST = cycloid(np.array([0.3, 0.6]), np.array([0.8, 1.0]), 10.0)(TIMES)


@pytest.mark.parametrize(
    ('given', 'message'),
    [
        ({'effort': 20.0, 'gravity': -9.81}, 'joint_1 must keep its limit of effort at rest'),
        ({'effort': np.inf, 'velocity': np.inf}, 'minimum time needs a limit'),
        ({'effort': 0.0}, 'effort must be > 0, got'),
        ({'effort': np.nan}, 'effort must be > 0, got'),
        ({'effort': 'much'}, "effort must have one element, .* got 'much'"),
        ({'power': np.nan}, 'power must be a number > 0 W, got nan'),
        ({'margin': np.nan}, 'margin must be a number >= 0 and < 1, got nan'),
        ({'strain': 1e-3}, r'strain .* must come with a <section>'),
        ({'effort': 1e-3}, r'times that of effort joint_1 in .* that stretch 10 allows'),
        (
            {'effort': {'joint_1': 1e6, 'joint_2': 1e-4}},
            r'times that of effort joint_2 in .* that stretch 10 allows',
        ),
        ({'q': np.where(TIMES[:, None] > 5.0, np.nan, 0.6 + REST_TO_REST)}, 'at 5.05 s'),
        ({'q': np.full((len(TIMES), 2), 0.6)}, 'q_joints must move for minimum time'),
    ],
)
def test_what_has_no_motion_in_minimum_time_is_told(given: dict[str, Any], message: str) -> None:
    options = dict(given)
    gravity = (0.0, options.pop('gravity', 0.0), 0.0)
    q = options.pop('q', REST_TO_REST)
    arm = dn.load_robot(ROBOTS / 'two_link_ff.urdf', gravity=gravity)
    with pytest.raises(dn.DenocError, match=message):
        dn.shape_motion(arm, TIMES, q, time='minimum', **options)


@pytest.mark.long_cases('joint_22-two_link_rr')
@pytest.mark.parametrize('robot', ['two_link_rr', 'two_link_ff'])
@pytest.mark.parametrize(
    'joint_2',
    [
        pytest.param((0.6, 1.2, 0.4), marks=pytest.mark.long),
        pytest.param((0.0, 0.0, 0.0), marks=pytest.mark.long),
        (-0.6, 0.0, 0.6),
    ],
)
def test_kinks_straight_arms_and_singularities_are_passed_within_limits(
    robot: str, joint_2: tuple[float, float, float]
) -> None:
    """A kink is rounded between the rows of the motion, as its spline goes."""
    arm = dn.load_robot(ROBOTS / f'{robot}.urdf', gravity=(0, 0, 0))
    share = cycloid(np.zeros(1), np.ones(1), 10.0)(TIMES)[:, 0]
    rows = [np.interp(share, [0.0, 0.5, 1.0], row) for row in ((0.3, 0.7, 1.1), joint_2)]
    plan = dn.shape_motion(arm, TIMES, np.stack(rows, 1), effort=50.0, time='minimum')
    assert plan.limits is not None
    assert 0.95 <= max(plan.limits.largest.values()) <= 1.001
    assert plan.tip_error.max() < 5e-5


def test_equal_shares_of_the_asked_coefficients_stretch_the_motion_as_a_whole() -> None:
    basis = TimingBasis.spline(2.0, lambda t: np.sin(0.5 * np.pi * t) ** 2, 6)
    np.testing.assert_allclose(basis.design @ basis.asked, 1.0, rtol=1e-12)
    stretched = Timing(basis, basis.asked / 1.5**2)
    np.testing.assert_allclose(stretched.t, 1.5 * basis.stations, rtol=1e-12, atol=1e-12)


def test_shares_of_limits_have_their_derivatives_by_the_timing(canadarm: dn.Robot) -> None:
    driven, frames = canadarm.joint_indices, ('tool',)
    sizes = dict.fromkeys(('velocity', 'effort', 'effort_rate'), 10.0)
    beyond = {'tip_speed': 1.0, 'tip_acceleration': 0.1}
    rows = LimitRows(canadarm, driven, frames, motion_limits(canadarm, sizes, beyond))
    basis = TimingBasis.spline(10.0, lambda t: np.sin(0.1 * np.pi * t) ** 2, 8)
    asked = AskedMotion(canadarm, TIMES, CANADARM(TIMES))
    problem = TipMinimumTime(TipGrids(canadarm, frames, driven, TipOptions()), asked, basis, rows)
    c = basis.asked * np.linspace(0.8, 1.2, len(basis.asked))
    here = problem.solve(c, None)
    change = 1e-2 * c * np.cos(np.arange(len(c)))
    told = (problem.jacobian(here) @ change).reshape(here.shares.shape)
    ahead, behind = (
        problem.shares_at(problem.solve(c + s * change, (here, s * change)), here)
        for s in (1.0, -1.0)
    )
    apart = 0.5 * (ahead - behind)
    assert (np.std(told - apart, axis=0) < 0.01 * np.std(apart, axis=0)).all()


def test_a_path_along_singular_postures_has_calm_joints() -> None:
    """The wrist can hardly make some turns, down to 0.001 rad per rad of its joints."""
    arm = dn.load_robot(ROBOTS / 'ssrms.urdf', gravity=(0, 0, 0))
    first = np.array([0.2, 0.5, -0.9, 0.4, 0.3, 0.2])
    way = np.array([0.5, 0.5, 0.5, 0.5, -0.6, 0.5])  # through joint_5 = 0
    times = np.linspace(0.0, 20.0, 201)
    motion = cycloid(first, first + way, 20.0)
    plan = dn.shape_motion(arm, times, motion(times))
    asked = motion(np.clip(plan.t, 0.0, 20.0))
    assert plan.tip_error.max() < 5e-6
    assert np.abs(plan.q[:, arm.joint_indices] - asked).max() < 0.1


def test_times_of_stations_have_their_derivatives() -> None:
    basis = TimingBasis.spline(2.0, lambda t: np.sin(0.5 * np.pi * t) ** 2, 6)
    c = np.linspace(1.0, 2.0, basis.design.shape[1])
    change = 1e-5 * np.cos(np.arange(len(c)))
    apart = Timing(basis, c + change).t - Timing(basis, c - change).t
    np.testing.assert_allclose(
        0.5 * apart, Timing(basis, c).by_coefficients @ change, rtol=1e-6, atol=1e-12
    )


@pytest.mark.parametrize('all_stations', [False, True])
def test_limit_rows_have_their_derivatives(canadarm: dn.Robot, all_stations: bool) -> None:
    names = ('velocity', 'acceleration', 'jerk', 'effort', 'effort_rate')
    beyond = {
        'moment': 100.0,
        'deflection': 0.1,
        'tip_speed': 1.0,
        'tip_acceleration': 1.0,
        'power': 50.0,
    }
    limits = motion_limits(canadarm, dict.fromkeys(names, 2.0), beyond)
    rows = LimitRows(canadarm, canadarm.joint_indices, ('tool',), limits, all_stations)
    assert len(set(rows.row_names)) == len(rows.names)
    random = np.random.default_rng(0)
    t = np.linspace(0.0, 1.0, 30)[:, None]
    wave = np.sin(3.0 * t + random.uniform(size=canadarm.n)) ** 2
    at = Moments(wave, 0.3 + wave**2, wave - 0.5, 4.0 * wave[:, :3] - 1.0)
    by = Moments(*(random.normal(size=(*part.shape, 1)) for part in at))
    step = 1e-6
    ahead, behind = (
        Moments(*(part + s * step * d[..., 0] for part, d in zip(at, by, strict=True)))
        for s in (1.0, -1.0)
    )
    expected = (rows.values(ahead, 0.04) - rows.values(behind, 0.04)) / (2.0 * step)
    found = rows.changes(at, 0.04, by)[..., 0]
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)
    largest = LimitRows(canadarm, canadarm.joint_indices, ('tool',), limits).shares(at, 0.04)
    np.testing.assert_allclose(rows.shares(at, 0.04), largest, rtol=1e-12)
