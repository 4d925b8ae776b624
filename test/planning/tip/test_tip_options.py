"""Limits, paths, several frames, redundant joints and gravity in tip-exact motions."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from control_runs import ROBOTS, Reference, carried_out, cycloid, strayed
from numpy.typing import NDArray
from planar_chains import FLEXIBLE, RIGID, planar_chain

import denoc_ros as dn
from denoc_ros.planning.timing.stretching import LimitError

TIMES = np.linspace(0.0, 10.0, 301)
POSTURES = np.radians([10.0, 40.0, 30.0]), np.radians([60.0, 45.0, 30.0])
CANADARM = cycloid(*POSTURES, 10.0)


@pytest.fixture(scope='module')
def canadarm() -> dn.Robot:
    return dn.load_robot(ROBOTS / 'canadarm.urdf', gravity=(0, 0, 0))


def test_a_limit_of_velocity_stretches_time_by_its_factor(canadarm: dn.Robot) -> None:
    plain = dn.shape_motion(canadarm, TIMES, CANADARM(TIMES))
    fastest = np.abs(plain.qd[:, canadarm.joint_indices]).max()
    plan = dn.shape_motion(canadarm, TIMES, CANADARM(TIMES), velocity=fastest / 1.5)
    assert np.abs(plan.qd[:, canadarm.joint_indices]).max() <= fastest / 1.5 * (1 + 1e-6)
    # the joints' rates are those of the stretched motion and a little for the links
    assert 1.4 < plan.stretch < 1.8
    assert plan.t[-1] == pytest.approx(10.0 * plan.stretch + plan.postaction)
    with pytest.raises(LimitError, match=r'must keep its limit of velocity, got 1\.5 times that'):
        dn.shape_motion(canadarm, TIMES, CANADARM(TIMES), velocity=fastest / 1.5, stretch=1.0)


def test_a_limit_of_effort_is_kept_with_the_least_stretch(canadarm: dn.Robot) -> None:
    plan = dn.shape_motion(canadarm, TIMES, CANADARM(TIMES), effort={'joint_1': 1000.0})
    largest = np.abs(plan.torque[:, 0]).max()
    # within 0.5 % of time, so twice as much of torque
    assert 985.0 < largest <= 1000.0 * (1 + 1e-6)
    assert plan.tip_error.max() < 1e-6


def test_what_no_stretch_can_keep_is_said_at_once() -> None:
    robot = dn.load_robot(ROBOTS / 'two_link_ff.urdf', gravity=(0, -9.81, 0))
    way = cycloid(np.array([-1.2, 0.6]), np.array([-0.7, 1.2]), 2.0)(TIMES / 5.0)
    with pytest.raises(dn.SolverError, match='joint_1 must keep its limit of effort at rest'):
        dn.shape_motion(robot, TIMES / 5.0, way, effort=20.0)


def test_a_tip_path_is_followed_as_its_joints_are(canadarm: dn.Robot) -> None:
    asked = np.zeros((len(TIMES), canadarm.n))
    asked[:, canadarm.joint_indices] = CANADARM(TIMES)
    path = canadarm.frame_pose('tool', asked)
    near = np.tile(POSTURES[0] + 0.1, (len(TIMES), 1))
    plan = dn.shape_motion(canadarm, TIMES, near, path=path)
    same = dn.shape_motion(canadarm, TIMES, CANADARM(TIMES))
    assert np.abs(plan.q - same.q).max() < 1e-6


def test_a_path_out_of_reach_or_without_rotations_is_refused(canadarm: dn.Robot) -> None:
    path = np.tile(np.eye(4), (3, 1, 1))
    path[:, 0, 3] = [12.0, 14.0, 20.0]
    joints = np.tile([0.3, 0.3, 0.3], (3, 1))
    with pytest.raises(
        dn.SolverError, match=r'must reach row 2 of the path, got no closer than 5'
    ):
        dn.shape_motion(canadarm, [0.0, 1.0, 2.0], joints, path=path)
    with pytest.raises(dn.StateError, match=r"path of 'tool' must have rotations"):
        dn.shape_motion(canadarm, [0.0, 1.0, 2.0], joints, path=2.0 * path)
    with pytest.raises(dn.StateError, match=r'must be finite and have shape \(3, 4, 4\)'):
        dn.shape_motion(canadarm, [0.0, 1.0, 2.0], joints, path=path[:2])
    with pytest.raises(dn.StateError, match=r"path must have the frames \['tool'\], got"):
        dn.shape_motion(canadarm, [0.0, 1.0, 2.0], joints, path={'link_3': path})


def test_a_spare_joint_stays_near_what_was_asked() -> None:
    """Four joints for three directions: the tip is exact, the spare one follows."""
    links = [FLEXIBLE, FLEXIBLE, RIGID, RIGID]
    robot = dn.load_robot(planar_chain(links), gravity=(0, 0, 0))
    times = np.linspace(0.0, 3.0, 151)
    motion = cycloid(np.array([0.2, 0.5, 0.4, 0.3]), np.array([0.6, 0.9, 0.9, 0.1]), 3.0)
    plan = dn.shape_motion(robot, times, motion(times), tip='link_4')
    assert plan.tip_error.max() < 1e-6
    assert plan.tip_turn.max() < 1e-5
    inside = np.clip(plan.t, 0.0, 3.0)
    assert np.abs(plan.q[:, robot.joint_indices] - motion(inside)).max() < 0.2


def test_fewer_joints_than_directions_leave_what_they_must() -> None:
    """One joint brings its tip no nearer than the bent link lets it: the rest is turn."""
    robot = dn.load_robot(ROBOTS / 'single_link.urdf', gravity=(0, 0, 0))
    times = np.linspace(0.0, 6.0, 151)
    motion = cycloid(np.array([0.0]), np.array([0.8]), 6.0)
    plan = dn.shape_motion(robot, times, motion(times))
    followed = dn.simulate(
        robot, np.zeros(robot.n), np.zeros(robot.n), times,
        prescribed={'joint_1': _prescribed(motion)}, rtol=1e-7,
    )  # fmt: skip
    assert plan.tip_error.max() < 0.01 * strayed(robot, 'tool', followed, motion(times)).max()


def _prescribed(motion: Reference) -> Callable[[float], tuple[float, float, float]]:

    def at(t: float) -> tuple[float, float, float]:
        h = 1e-3
        q = motion(np.array([t - h, t, t + h]))[:, 0]
        return float(q[1]), float((q[2] - q[0]) / (2 * h)), float((q[2] - 2 * q[1] + q[0]) / h**2)

    return at


def test_two_frames_share_the_error_by_their_weights() -> None:
    robot = dn.load_robot(ROBOTS / 'two_link_ff.urdf', gravity=(0, 0, 0))
    times = np.linspace(0.0, 2.0, 101)
    way = cycloid(np.array([0.2, 0.6]), np.array([1.0, 1.2]), 2.0)(times)
    frames = ('tool', 'link_2')
    errors = []
    for weights in ((1.0, 0.01), (0.01, 1.0)):
        plan = dn.shape_motion(robot, times, way, tip=frames, weights=weights)
        asked = np.zeros((1, robot.n))
        asked[:, robot.joint_indices] = way[25]
        middle = plan.q[np.searchsorted(plan.t, 0.5 - 1e-9)][None]
        apart = [
            robot.frame_pose(f, middle)[0, :3, 3] - robot.frame_pose(f, asked)[0, :3, 3]
            for f in frames
        ]
        errors.append(np.linalg.norm(apart, axis=1))
    assert errors[0][0] < 0.01 * errors[1][0]
    assert errors[1][1] < errors[0][1]
    with pytest.raises(dn.StateError, match='weights must be one for each of'):
        dn.shape_motion(robot, times, way, tip=frames, weights=[1.0])


def test_gravity_and_payload_are_carried() -> None:
    """The sagging tip is where the stiff arm's would be; joints held on the plan."""
    robot = dn.load_robot(ROBOTS / 'two_link_ff.urdf', gravity=(0, -9.81, 0))
    robot.set_payload('tool', 2.0)
    times = np.linspace(0.0, 2.0, 101)
    motion = cycloid(np.array([-1.2, 0.6]), np.array([-0.7, 1.2]), 2.0)
    plan = dn.shape_motion(robot, times, motion(times))
    assert plan.tip_error.max() < 1e-5
    run = carried_out(robot, plan, after=0.5)
    error = strayed(robot, 'tool', run, motion(np.clip(run.t, 0.0, 2.0)))
    assert error.max() < 5e-5
    straight = robot.static_deflection(motion(np.zeros(1))[0])
    asked = np.zeros(robot.n)
    asked[robot.joint_indices] = motion(np.zeros(1))[0]
    sag = robot.frame_pose('tool', straight) - robot.frame_pose('tool', asked)
    assert np.linalg.norm(sag[:3, 3]) > 0.01  # what it is held against


def test_a_stretched_start_needs_no_wild_joints(canadarm: dn.Robot) -> None:
    """Eq. 3.56 starts where the tip cannot move along the arm; to rest it takes 20 s."""
    times = np.linspace(0.0, 20.0, 401)
    rate, period = np.array([0.075, 0.05, 0.1]), np.array([10.0, 5.0, 5.0])
    way = rate * (times[:, None] - period / np.pi * np.sin(np.pi * times[:, None] / period))
    plan = dn.shape_motion(canadarm, times, way)
    assert np.sqrt(np.mean(plan.tip_error**2)) < 1e-4
    assert plan.tip_error.max() < 3e-4
    assert plan.tip_error[plan.t > 3.0].max() < 1e-5  # away from the stretched posture
    assert np.abs(plan.qd[:, canadarm.joint_indices]).max() < 0.25  # asked for: 0.2 rad/s


@pytest.mark.long
def test_the_straight_arm_of_the_book_does_without_noise() -> None:
    """Section 4.2 starts with all joints at zero: few directions are open, so some error stays."""
    robot = dn.load_robot(ROBOTS / 'ssrms.urdf', gravity=(0, 0, 0))
    times = np.linspace(0.0, 10.0, 201)
    motion = cycloid(np.zeros(6), np.full(6, 0.5), 10.0)
    plan = dn.shape_motion(robot, times, motion(times))
    assert plan.stretch == 1.0
    assert np.sqrt(np.mean(plan.tip_error**2)) < 1.5e-3
    assert plan.equation_error < 1e-6
    # what was asked for: 0.1 rad/s and 0.0314 rad/s^2
    assert np.abs(plan.qd[:, robot.joint_indices]).max() < 0.2
    assert np.abs(plan.qdd[:, robot.joint_indices]).max() < 0.5


@pytest.mark.long
def test_a_straight_arm_that_also_bends_sideways_finds_its_plan() -> None:
    """The first steps overflow: shorter ones, or more draw to the asked joints, do not."""
    page = (ROBOTS.parents[1] / 'docs' / 'tutorial_1_flexible_urdf.md').read_text(encoding='utf-8')
    plain = page.split('```xml\n')[1].split('```')[0]
    robot = dn.load_robot(dn.suggest_flexibility(plain).text, gravity=(0, 0, 0))
    times: NDArray[np.float64] = np.linspace(0.0, 4.0, 101)
    share = (times / 4.0)[:, None]
    asked = share**3 * (10 - 15 * share + 6 * share**2) * [0.3, 0.2]
    plan = dn.shape_motion(robot, times, asked)
    assert plan.tip_error.max() < 1e-6  # at the pace that the limits of velocity allow
    assert plan.equation_error < 1e-6


def test_a_motion_that_does_not_end_at_rest_is_refused(canadarm: dn.Robot) -> None:
    half = TIMES <= 5.0
    with pytest.raises(dn.StateError, match=r'q_joints must end at rest, got .* of joint_1'):
        dn.shape_motion(canadarm, TIMES[half], CANADARM(TIMES[half]))
    with pytest.raises(dn.StateError, match='q_joints must begin at rest'):
        dn.shape_motion(canadarm, TIMES[~half], CANADARM(TIMES[~half]))


def test_a_rigid_robot_does_what_it_is_asked() -> None:
    robot = dn.load_robot(ROBOTS / 'ur10.urdf')
    times = np.linspace(0.0, 3.0, 61)
    motion = cycloid(
        np.array([0.0, -1.0, 1.0, 0.0, 0.3, 0.0]), np.array([0.5, -0.8, 0.8, 0.3, 0.5, 0.2]), 3.0
    )
    plan = dn.shape_motion(robot, times, motion(times))
    assert np.abs(plan.q - motion(plan.t)).max() < 1e-6
    assert plan.preaction == plan.postaction == 0.0


@pytest.mark.parametrize(
    ('option', 'value', 'rule'),
    [
        ('turn', -1.0, '>= 0 m, got -1.0'),
        ('draw', 0.0, '> 0 m, got 0.0'),
        ('step', np.nan, 'a number > 0 s, got nan'),
        ('stretch', 0.5, '>= 1, got 0.5'),
        ('preaction', 'long', "a double s, got 'long'"),
        ('weights', [0.0], '> 0, got 0.0'),
        ('robustness', 0.1, None),
    ],
)
def test_bad_options_are_refused(
    canadarm: dn.Robot, option: str, value: Any, rule: str | None
) -> None:
    given: dict[str, Any] = {option: value}
    message = f'shape_motion: {option} must be {rule}' if rule else "options of 'tip' must be of"
    with pytest.raises(dn.StateError, match=re.escape(message)):
        dn.shape_motion(canadarm, TIMES, CANADARM(TIMES), **given)


@pytest.mark.long
def test_a_motion_that_has_no_bounded_plan_says_what_is_left(canadarm: dn.Robot) -> None:
    fast = TIMES[::10] / 20.0
    asked = CANADARM(20.0 * fast)
    with pytest.raises(dn.SolverError, match=r'must settle in 14 iterations, got forces without'):
        dn.shape_motion(canadarm, fast, asked, effort=1e9, velocity=1e9, stretch=1.0)


def test_a_load_that_no_posture_holds_is_said() -> None:
    """The arm's own weight is beyond what its links bear."""
    robot = dn.load_robot(ROBOTS / 'ssrms.urdf', gravity=(0, 0, -9.81))
    robot.set_payload('tool', 1000.0)
    motion = cycloid(np.full(6, 0.3), np.full(6, 0.5), 10.0)
    with pytest.raises(dn.SolverError, match=r'must (be found|have an equilibrium)'):
        dn.shape_motion(robot, TIMES, motion(TIMES), effort=1e9)
