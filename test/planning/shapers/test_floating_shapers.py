"""Input shapers and rest to rest on a base that reacts, and how an undeformed robot reacts."""

from __future__ import annotations

import numpy as np
import pytest
from base_robots import description
from control_runs import cycloid

import denoc_ros as dn
from denoc_ros.dynamics.base.reacting_base import held_robot
from denoc_ros.dynamics.driven.motion_plan import Plan
from denoc_ros.dynamics.driven.torque_feedforward import TorqueFeedforward
from denoc_ros.planning.plan_simulation import carry_out, planned
from denoc_ros.planning.shapers.ringing import ringing_modes, ringing_robot
from denoc_ros.planning.shapers.shaped_samples import rest_spline
from denoc_ros.planning.tip.reaction import continuous, in_free_fall, reaction

EARTH = np.array([0.0, 0.0, -9.81])  # it must not matter: the spacecraft falls freely
DURATION = 6.0
TIMES = np.linspace(0.0, DURATION, 121)
MOTION = cycloid(np.radians([10.0, 40.0, 30.0]), np.radians([60.0, 45.0, 30.0]), DURATION)


@pytest.fixture(scope='module')
def robot() -> dn.Robot:
    return dn.load_robot(description('canadarm_10t'), gravity=EARTH)


def swing(robot: dn.Robot, plan: Plan) -> float:
    """Return the tip's swing after a plan whose joints are carried out [m]."""
    times = np.linspace(float(plan.t[0]), float(plan.t[-1]) + 4.0, 1500)
    motion = planned(plan, plan.joint_names)
    run = carry_out(robot, motion, robot.joint_names, plan.q[0], times)
    return run.swing(robot, 'tool', float(plan.t[-1]))


@pytest.fixture(scope='module')
def plain(robot: dn.Robot) -> float:
    """The swing after the plain motion: a shaper for a mode that is far too fast."""
    q = rest_spline(TIMES, MOTION(TIMES))
    t = np.linspace(0.0, DURATION, 601)
    rows = np.zeros((3, len(t), robot.n))
    for order in range(3):
        rows[order][:, robot.joint_indices] = q(t, order)
    none = np.zeros(len(t))
    names = tuple(robot.joint_names), tuple(robot.coordinate_names)
    torque = np.zeros((len(t), len(robot.joint_names)))
    given = rows[0], rows[1], rows[2], torque
    return swing(robot, Plan('', t, *given, *names, none, none))


# found: 0.2 % (0.4 to 5.5 % on other arms), 0.1 %, 4.3 % (5 % by design), 0.01 %
@pytest.mark.long_cases('rest_to_rest-0.02')
@pytest.mark.parametrize(
    ('method', 'most'), [('zv', 0.055), ('zvd', 0.029), ('ei', 0.072), ('rest_to_rest', 0.02)]
)
def test_no_swing_is_left_by_the_modes_of_the_robot_that_floats(
    robot: dn.Robot, plain: float, method: str, most: float
) -> None:
    plan = dn.shape_motion(robot, TIMES, MOTION(TIMES), method)
    assert swing(robot, plan) < most * plain
    force = in_free_fall(robot).inverse_dynamics(plan.q, plan.qd, plan.qdd)
    np.testing.assert_allclose(force[:, robot.free_indices], 0.0, atol=1e-6)
    np.testing.assert_allclose(force[:, robot.joint_indices], plan.torque, atol=1e-6)
    # steps of second order: 4000 N m s is what the arm has
    assert np.abs(robot.momentum(plan.q, plan.qd)).max() < 0.2
    assert np.abs(plan.q[-1, robot.base_indices]).max() > 0.1
    assert robot.base_motion is None


def test_a_held_base_has_other_modes_and_takes_a_wrench(robot: dn.Robot) -> None:
    posture = MOTION(np.array([DURATION]))[0]
    floats, held = (
        ringing_modes(ringing_robot(robot, base), posture).frequencies
        for base in ('free_floating', 'free_flying')
    )
    fixed = held_robot(robot)
    assert held == pytest.approx(ringing_modes(fixed, posture).frequencies)
    assert floats[0] > 1.3 * held[0]  # 0.27 and 0.17 Hz: the light spacecraft gives way
    plan = dn.shape_motion(robot, TIMES, MOTION(TIMES), 'zv', base='free_flying', effort=1e6)
    assert plan.base_wrench is not None
    weight = -robot.mass * EARTH[2]
    assert plan.base_wrench[0, 2] == pytest.approx(weight)
    still = np.zeros(robot.n)
    force = robot.inverse_dynamics(plan.q[50], plan.qd[50], plan.qdd[50])
    assert plan.base_wrench[50] == pytest.approx(robot.base_wrench(still, force))


def test_feedforward_that_follows_a_plans_joints_gives_its_torque(robot: dn.Robot) -> None:
    """What `denoc up` does with a plan: joints in, the base and the links react by themselves."""
    plan = dn.shape_motion(robot, TIMES, MOTION(TIMES))
    own, step = in_free_fall(robot), 2e-3
    source = TorqueFeedforward(own, model='flexible', step=step)
    motion = planned(plan, own.joint_names)
    times = np.arange(float(plan.t[0]), float(plan.t[-1]), step)
    rows = motion(times)
    found = np.array(
        [source.update(q, qd, qdd, step).copy() for q, qd, qdd in zip(*rows, strict=True)]
    )
    wanted = np.stack([np.interp(times, plan.t, column) for column in plan.torque.T], axis=1)
    # the amplitudes' steps are of second order; in its first and last rows a plan's acceleration
    # alternates from row to row, which linear interpolation of its torque does not follow
    within = (times > plan.t[16]) & (times < plan.t[-17])
    most = np.abs(wanted).max()
    assert np.abs(found - wanted)[within].max() < 0.01 * most
    assert np.abs(found - wanted).max() < 0.03 * most
    apart = own.frame_pose('tool', source.q) - own.frame_pose('tool', plan.q[-1])
    assert np.linalg.norm(apart[:3, 3]) < 2e-3


def test_a_base_that_reacts_keeps_its_centre_of_mass_and_goes_back_the_way_it_came() -> None:
    robot = dn.load_robot(description('ssrms_10t'), gravity=(0, 0, 0))
    start = np.array([0.2, 0.5, -0.9, 0.4, 0.3, 0.2])
    way = cycloid(start, start + 1.0, 10.0)
    there = np.linspace(0.0, 10.0, 101)
    joints = np.concatenate([way(there), way(there[::-1])[1:]])
    spline = rest_spline(np.linspace(0.0, 20.0, 201), joints)
    times, base = reaction(robot, spline, 20.0)
    q = np.zeros((len(times), robot.n))
    q[:, robot.base_indices], q[:, robot.joint_indices] = base, spline(times)
    centre = robot.centre_of_mass(q)
    # the base is integrated by its twist: the centre says how exactly
    assert np.abs(centre - centre[0]).max() < 1e-9
    assert np.abs(base[len(base) // 2]).max() > 0.1
    assert np.abs(base[-1]).max() < 1e-8


def test_rotation_vectors_are_continued_beyond_half_a_turn() -> None:
    angle = np.linspace(0.0, 5.0, 51)
    axis = np.array([0.6, 0.0, 0.8])
    wanted = angle[:, None] * axis
    short = np.where(angle[:, None] > np.pi, wanted - 2.0 * np.pi * axis, wanted)
    np.testing.assert_allclose(continuous(short), wanted, atol=1e-12)
    np.testing.assert_allclose(continuous(-wanted + 1.0), -wanted + 1.0, atol=1e-12)
