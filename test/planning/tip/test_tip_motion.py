"""Tip-exact motions of open arms: laws, and what a simulation makes of the torque alone."""

from __future__ import annotations

import numpy as np
import pytest
from control_runs import ROBOTS, carried_out, cycloid, strayed

import denoc_ros as dn
from denoc_ros.dynamics.driven.motion_plan import Plan
from denoc_ros.types import Array

TIMES = np.linspace(0.0, 10.0, 501)
CANADARM = cycloid(np.radians([10.0, 40.0, 30.0]), np.radians([60.0, 45.0, 30.0]), 10.0)


@pytest.fixture(scope='module')
def canadarm() -> dn.Robot:
    return dn.load_robot(ROBOTS / 'canadarm.urdf', gravity=(0, 0, 0))


@pytest.fixture(scope='module')
def plan(canadarm: dn.Robot) -> Plan:
    return dn.shape_motion(canadarm, TIMES, CANADARM(TIMES), preaction=0.8, postaction=0.8)


def test_its_torque_alone_brings_the_tip_where_it_should_be(
    canadarm: dn.Robot, plan: Plan
) -> None:
    run = carried_out(canadarm, plan, after=3.0, step=0.05)
    error = strayed(canadarm, 'tool', run, CANADARM(run.t))
    moving = run.t <= 10.0
    assert error[moving].max() < 5e-6  # the same torque of the rigid model: 0.07 m, then 0.74 m
    assert error[~moving].max() < 5e-6


def test_no_force_is_asked_of_the_links(canadarm: dn.Robot, plan: Plan) -> None:
    force = canadarm.inverse_dynamics(plan.q, plan.qd, plan.qdd)[:, canadarm.flexible_indices]
    stiffness = canadarm.inverse_dynamics_derivatives(*plan_rest(canadarm, plan))[0]
    own = np.diag(stiffness)[canadarm.flexible_indices]
    # between nodes the equations hold to the order of the differences
    assert np.abs(force / own).max() < 2e-4
    assert np.sqrt(np.mean((force / own) ** 2)) < 1e-5


def plan_rest(robot: dn.Robot, plan: Plan) -> tuple[Array, Array, Array]:
    return plan.q[0], np.zeros(robot.n), np.zeros(robot.n)


def test_the_plan_rests_at_both_ends_and_moves_before_the_tip(plan: Plan) -> None:
    for rate in (plan.qd, plan.qdd):
        assert np.abs(rate[[0, -1]]).max() < 1e-12
    assert plan.t[0] == pytest.approx(-plan.preaction)
    assert plan.t[-1] == pytest.approx(10.0 + plan.postaction)
    early = plan.q[np.searchsorted(plan.t, 0.0)] - plan.q[0]
    assert 2e-4 < np.abs(early[[0, 3, 6]]).max() < 5e-3


def test_the_way_back_is_the_way_there(canadarm: dn.Robot) -> None:
    """Without damping, time reversed is a motion of the same robot with the same torque."""
    undamped = {f'beam.link_{k}.y.damping_ratio': 0.0 for k in (1, 2)}
    robot = canadarm.with_overrides(undamped)
    way = CANADARM(TIMES)
    there = dn.shape_motion(robot, TIMES, way, preaction=0.8, postaction=0.8)
    back = dn.shape_motion(robot, TIMES, way[::-1], preaction=0.8, postaction=0.8)
    assert np.abs(back.q[::-1] - there.q).max() < 1e-8
    assert np.abs(back.torque[::-1] - there.torque).max() < 1e-3


def test_an_unknown_method_or_option_is_refused(canadarm: dn.Robot) -> None:
    with pytest.raises(dn.StateError, match=r"method must be one of tip.*, got 'magic'"):
        dn.shape_motion(canadarm, TIMES, CANADARM(TIMES), method='magic')
    with pytest.raises(dn.StateError, match=r"options of 'tip' must be of .*, got \['speed'\]"):
        dn.shape_motion(canadarm, TIMES, CANADARM(TIMES), speed=3)


def test_bad_motions_are_refused(canadarm: dn.Robot) -> None:
    with pytest.raises(dn.StateError, match=r'times must be .* increase'):
        dn.shape_motion(canadarm, TIMES[::-1], CANADARM(TIMES))
    with pytest.raises(dn.StateError, match=r'q_joints must have shape \(501, 3\)'):
        dn.shape_motion(canadarm, TIMES, CANADARM(TIMES)[:, :2])
    with pytest.raises(dn.StateError, match=r'tip must be different frames of .*nose'):
        dn.shape_motion(canadarm, TIMES, CANADARM(TIMES), tip='nose')


def test_work_can_be_cancelled_and_says_how_far_it_is(canadarm: dn.Robot) -> None:
    shares: list[float] = []
    dn.shape_motion(canadarm, TIMES, CANADARM(TIMES), progress=shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    with pytest.raises(dn.SolverError, match='cancelled after 0 iterations'):
        dn.shape_motion(canadarm, TIMES, CANADARM(TIMES), cancel=lambda: True)
