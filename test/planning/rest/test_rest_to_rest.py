"""Motions from rest to rest leave nothing ringing in the robot's own simulation."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike
from planar_chains import FLEXIBLE, planar_chain
from shaped_runs import cycloid, simulated_swing, swing_after

import denoc_ros as dn
from denoc_ros.dynamics.driven.joint_limits import joint_limits
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError, StateError
from denoc_ros.planning.rest.rest_problem import RestMotion
from denoc_ros.planning.rest.rest_to_rest import rest_to_rest
from denoc_ros.types import Array

ROBUST = 0.1
WAY = [0.0], [0.5]


def one_link() -> Robot:
    robot = dn.load_robot(planar_chain((FLEXIBLE,)), gravity=(0, 0, 0))
    return robot.with_overrides({'joint.joint_1.armature': 0.2})


def two_links(gravity: tuple[float, float, float] = (0, 0, 0)) -> Robot:
    return dn.load_robot('config/robots/two_link_ff.urdf', gravity=gravity)


def plain(start: Array, end: Array, t: Array) -> Array:
    return np.asarray(start + (end - start) * cycloid(t, t[-1])[:, None])


@pytest.mark.parametrize('gravity', [(0, 0, 0), (0, -9.81, 0)])
@pytest.mark.parametrize(
    ('start', 'end', 'duration'), [((0, 0), (1, 1), 1.0), ((0, 1.0), (1, 0), 0.9)]
)
def test_leaves_a_fiftieth_of_the_swing_in_the_plain_motions_time(
    start: tuple[float, float],
    end: tuple[float, float],
    duration: float,
    gravity: tuple[float, float, float],
) -> None:
    robot = two_links(gravity)
    limits = joint_limits(robot, effort=400.0)
    motion = rest_to_rest(robot, start, end, duration, limits)
    t = np.linspace(0.0, duration, 301)
    q = plain(np.array(start, float), np.array(end, float), t)
    left = swing_after(robot, t, motion.joints(t), 'tool')
    assert left <= 0.02 * swing_after(robot, t, q, 'tool')
    np.testing.assert_allclose(motion.joints([0.0, duration]), [start, end], atol=1e-12)
    for order in (1, 2, 3):
        np.testing.assert_allclose(motion.joints([0.0, duration], order), 0.0, atol=1e-6)


def test_adaptive_simulation_agrees() -> None:
    robot = two_links()
    motion = rest_to_rest(robot, (0, 0), (1, 1), 1.0)
    t = np.linspace(0.0, 1.0, 301)
    q = plain(np.zeros(2), np.ones(2), t)
    left = simulated_swing(robot, t, motion.joints(t), 'tool')
    assert left <= 0.02 * simulated_swing(robot, t, q, 'tool')


def test_limits_are_kept() -> None:
    robot = two_links()

    def largest(motion: RestMotion) -> Array:
        rows = [motion.joints(motion.t, order) for order in range(3)]
        torque, _ = robot.hybrid_dynamics(motion.states.q, motion.states.qd, rows[2])
        return np.array([np.abs(each).max(axis=0) for each in (*rows[1:], torque)])

    free = largest(rest_to_rest(robot, (0, 0), (1, 1), 1.0))
    for row, what in enumerate(('velocity', 'acceleration', 'effort')):
        limit = 0.95 * free[row]
        limits = joint_limits(robot, **{what: limit})
        assert (
            largest(rest_to_rest(robot, (0, 0), (1, 1), 1.0, limits))[row] <= 1.005 * limit
        ).all()


@pytest.mark.long
def test_robust_motion_leaves_less_where_frequencies_are_off() -> None:
    robot = two_links()
    softer = robot.with_overrides(
        {f'beam.{link}.y.ei': 1000.0 * 0.9**2 for link in ('link_1', 'link_2')}
    )
    t = np.linspace(0.0, 1.0, 301)
    limits = joint_limits(robot, effort=400.0)
    left = [
        swing_after(
            softer,
            t,
            rest_to_rest(robot, (0, 0), (1, 1), 1.0, limits, robustness=share).joints(t),
            'tool',
        )
        for share in (0.0, 0.1)
    ]
    assert left[1] < 0.1 * left[0]


def test_shortest_motion_is_shorter_than_any_that_was_tried() -> None:
    robot = one_link()
    limits = joint_limits(robot, velocity=2.0, acceleration=10.0)
    motion = rest_to_rest(robot, *WAY, limits=limits)
    rows = [motion.joints(motion.t, order) for order in range(3)]
    assert (np.abs(rows[1]).max(axis=0) <= 1.005 * limits.velocity).all()
    assert (np.abs(rows[2]).max(axis=0) <= 1.005 * limits.acceleration).all()
    with pytest.raises(SolverError, match=r'rest to rest in .* must be possible, got none'):
        rest_to_rest(robot, *WAY, motion.duration / 1.05, limits)


@pytest.mark.parametrize('way', [0.0, 1e-16])
@pytest.mark.parametrize('method', ['tip', 'zv', 'rest_to_rest'])
def test_a_motion_without_a_way_stands_still(method: str, way: float) -> None:
    robot = two_links((0, -9.81, 0))
    times = np.linspace(0.0, 1.0, 41)
    asked = [0.3, 0.2] + way * np.sin(7.0 * times)[:, None]
    plan = dn.shape_motion(robot, times, asked, method)
    still = robot.static_deflection([0.3, 0.2])
    # the tip method moves the joints by what the links sag, and settles to 1e-9 of 2 m
    tool = robot.frame_pose('tool', plan.q)[:, :3, 3]
    where = tool[0] if method == 'tip' else robot.frame_pose('tool', still)[:3, 3]
    assert np.abs(tool - where).max() < 1e-8
    assert np.abs(plan.qd).max() < 1e-4  # what the search leaves, over steps of 2 ms


def test_what_cannot_be_is_refused() -> None:
    robot = two_links()
    with pytest.raises(SolverError, match='limits of velocity, acceleration and jerk leave no'):
        rest_to_rest(robot, (0, 0), (1, 1), 0.5, joint_limits(robot, velocity=2.0))
    with pytest.raises(StateError, match='end must be within'):
        rest_to_rest(robot, (0, 0), (1, 13), 1.0)
    with pytest.raises(StateError, match='start must be 2 finite numbers'):
        rest_to_rest(robot, (0, np.nan), (1, 1), 1.0)
    with pytest.raises(StateError, match='duration must be > 0 s, got 0'):
        rest_to_rest(robot, (0, 0), (1, 1), 0.0)
    with pytest.raises(StateError, match='robustness must be >= 0 and < 1, got 1'):
        rest_to_rest(robot, (0, 0), (1, 1), 1.0, robustness=1.0)
    with pytest.raises(StateError, match='modes to be shaped must be >= 1, got 0'):
        rest_to_rest(robot, (0, 0), (1, 1), 1.0, modes=0)
    with pytest.raises(StateError, match='needs a way to go and limits'):
        rest_to_rest(robot, (0, 0), (0, 0))
    looped = dn.load_robot('config/robots/four_bar_fff.urdf')
    with pytest.raises(StateError, match='needs a robot without loops'):
        rest_to_rest(looped, np.zeros(3), np.ones(3), 1.0)
    with pytest.raises(StateError, match='velocity must be > 0, got'):
        joint_limits(robot, velocity=0.0)
    with pytest.raises(StateError, match=r"acceleration must be of joints of .*, got 'elbow'"):
        joint_limits(robot, acceleration={'elbow': 1.0})
    with pytest.raises(StateError, match='jerk must have one element, or one for each of 2'):
        joint_limits(robot, jerk=(1.0, 2.0, 3.0))


def test_search_can_be_ended() -> None:
    class EndedError(Exception):
        pass

    def check() -> None:
        raise EndedError

    with pytest.raises(EndedError):
        rest_to_rest(two_links(), (0, 0), (1, 1), 1.0, check=check)


def ask(duration: float | None = None) -> RestMotion:
    """Return a motion of one link within 100 N m."""
    robot = one_link()
    limits = joint_limits(robot, effort=100.0)
    return rest_to_rest(robot, *WAY, duration, limits, robustness=ROBUST)


@pytest.fixture(scope='module')
def swift() -> RestMotion:
    """Return the shortest motion within the effort."""
    return ask()


def require_efforts(robot: Robot, motion: RestMotion, effort: ArrayLike) -> None:
    """Require that a motion keeps its efforts and rests at its end."""
    rows = motion.joints(motion.t, 2)
    torque, _ = robot.hybrid_dynamics(motion.states.q, motion.states.qd, rows)
    assert (np.abs(torque).max(axis=0) <= 1.005 * np.asarray(effort)).all()
    assert motion.left <= 1e-3


@pytest.mark.parametrize('longer', [1.0, 1.1, 1.7])
def test_a_duration_that_another_way_takes_has_a_motion(swift: RestMotion, longer: float) -> None:
    duration = longer * swift.duration
    motion = ask(duration)
    assert motion.duration == duration
    require_efforts(one_link(), motion, 100.0)


def test_a_duration_of_more_than_twice_the_shortest_has_a_motion() -> None:
    """It was refused, though a motion of 0.42 s was known: the robot may wait."""
    robot, duration = two_links(), 0.93
    motion = rest_to_rest(robot, (0, 0), (0.5, 0.5), duration, robustness=ROBUST)
    assert motion.duration == duration
    require_efforts(robot, motion, joint_limits(robot).effort)


def test_a_motion_by_narrower_limits_is_one_within_the_wider_ones() -> None:
    robot = one_link()
    narrow = joint_limits(robot, effort=100.0, acceleration=40.0)
    found = rest_to_rest(robot, *WAY, limits=narrow)
    for robustness in (0.0, ROBUST):
        wide = rest_to_rest(
            robot, *WAY, found.duration, joint_limits(robot, effort=100.0), robustness=robustness
        )
        assert wide.duration == found.duration


@pytest.mark.parametrize('share', [0.5, pytest.param(0.95, marks=pytest.mark.long)])
def test_a_refusal_names_the_shortest_duration_that_was_found(
    swift: RestMotion, share: float
) -> None:
    """It said "a longer duration has one" of whatever was refused."""
    with pytest.raises(SolverError, match='the shortest motion that was found takes') as refused:
        ask(share * swift.duration)
    shortest = float(str(refused.value).split('takes ')[1].removesuffix(' s'))
    assert shortest == pytest.approx(swift.duration, rel=0.05)
    assert ask(1.001 * shortest).duration > share * swift.duration


def test_postures_that_no_effort_holds_are_named() -> None:
    heavy = two_links((0, -9.81, 0))
    limits = joint_limits(heavy, effort=1.0)
    with pytest.raises(SolverError, match="effort of 'joint_1' must hold the start posture"):
        rest_to_rest(heavy, (0, 0), (0.5, 0.5), 1.0, limits)


def test_a_way_that_limits_make_long_is_said_to_be_long() -> None:
    limits = joint_limits(two_links(), velocity=0.01)
    with pytest.raises(SolverError, match='leave no motion; these limits take 1200 s at least'):
        rest_to_rest(two_links(), (0, 0), (12.0, 12.0), 20.0, limits)
