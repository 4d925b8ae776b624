"""What chapter 3 of the book says of its planar arms; docs/book.md has the figures.

The comparisons with independent solutions are in test_reference_solutions.py.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from book_runs import desired, joints, shipped, tips, until

from denoc_ros.dynamics.robot import Robot
from denoc_ros.simulation.simulate import Run
from denoc_ros.types import Array

Fall = tuple[Robot, Run]


def test_single_links_rate_fluctuates_about_the_rigid_ones() -> None:
    robot, scenario = shipped('single_link', 'single_link')
    run = until(scenario, 5.0).run(robot)
    rigid_rate = 5.0 / (1.616 * 8.0**2 / 3.0) * run.t
    fluctuation = run.qd[:, 0] - rigid_rate
    assert np.max(np.abs(fluctuation)) > 0.5 * rigid_rate[-1]  # "considerable"
    assert np.min(run.qd[:, 0]) < 0.0
    # it is a vibration about the rigid motion, not a drift
    rigid_angle = 0.5 * rigid_rate * run.t
    assert np.max(np.abs(run.q[:, 0] - rigid_angle)) < 0.06
    tip = tips(robot, run, 'link_1')[:, 1]
    assert np.min(tip) == pytest.approx(-0.522, abs=0.005)  # 6.5 % of the length, lagging
    assert np.max(tip) < 0.01


def test_rigid_single_link_turns_at_constant_acceleration() -> None:
    robot, scenario = shipped('single_link', 'single_link', {'beam.link_1.y.modes': 0})
    run = scenario.run(robot)
    acceleration = 5.0 / (1.616 * 8.0**2 / 3.0)
    np.testing.assert_allclose(run.q[:, 0], 0.5 * acceleration * run.t**2, rtol=1e-9, atol=1e-9)


def test_second_mode_is_needed_and_a_third_changes_little() -> None:
    tip = {}
    for modes in (1, 2, 3, 4):
        overrides = {'beam.link_1.y.modes': modes}
        robot, fall = shipped('single_link', 'single_link_free_fall', overrides)
        tip[modes] = tips(robot, fall.run(robot), 'link_1')[:, 1]
    peak = np.max(np.abs(tip[4]))
    gap = {modes: np.max(np.abs(tip[modes] - tip[4])) / peak for modes in (1, 2, 3)}
    # The book's fig. 3.8: one mode is far off, two and three are alike.
    assert gap[1] > 0.8
    assert 0.05 < gap[2] < 0.10
    assert 0.02 < gap[3] < 0.04


@pytest.fixture(scope='module')
def falls() -> dict[str, Fall]:
    """Free fall of the two-link arm in its four kinds."""
    found = {}
    for kind in ('rr', 'rf', 'fr', 'ff'):
        robot, scenario = shipped(f'two_link_{kind}', 'two_link')
        found[kind] = robot, scenario.run(robot)
    return found


def largest_gap(falls: dict[str, Fall], kind: str) -> Array:
    return np.asarray(np.max(np.abs(joints(*falls[kind]) - joints(*falls['rr'])), axis=0))


def test_flexible_links_hardly_move_the_joints(falls: dict[str, Fall]) -> None:
    rf, fr = largest_gap(falls, 'rf'), largest_gap(falls, 'fr')
    for gap in (rf, fr):
        assert np.all((gap > 5e-5) & (gap < 5e-4))  # "in the range of 1e-4"
    assert rf[0] < 0.5 * fr[0]  # "less differences, particularly with respect to joint 1"
    assert rf[1] == pytest.approx(fr[1], rel=0.05)  # "joint 2 behaviour ... is very similar"
    assert np.all(largest_gap(falls, 'ff') > np.maximum(rf, fr))


def end_effector(robot: Robot, run: Run) -> Array:
    return np.array([robot.frame_pose('tool', q)[:2, 3] for q in run.q])


def straight_end(robot: Robot, run: Run) -> Array:
    """The end effector as if the links were straight between the joint angles."""
    first, second = joints(robot, run).T
    x, y = np.cos(first) + np.cos(first + second), np.sin(first) + np.sin(first + second)
    return np.column_stack([x, y])


def test_end_effector_strays_less_with_the_inner_link_flexible(falls: dict[str, Fall]) -> None:
    """The book's fig. 3.15 has it the other way round: see docs/book.md."""
    rigid = end_effector(*falls['rr'])
    gap = {k: np.max(np.abs(end_effector(*falls[k]) - rigid), axis=0)[0] for k in ('rf', 'fr')}
    assert gap['rf'] == pytest.approx(1.07e-4, rel=0.05)
    assert gap['fr'] == pytest.approx(5.8e-5, rel=0.05)
    straight = {
        kind: np.max(np.abs(straight_end(*falls[kind]) - rigid), axis=0)[0]
        for kind in ('rf', 'fr')
    }
    assert straight['fr'] > 3.0 * straight['rf']  # as the book has it: joint angles alone


def test_two_flexible_links_fall_without_artificial_damping(falls: dict[str, Fall]) -> None:
    robot, run = falls['ff']
    assert run.energy_drift < 1e-9
    for link in ('link_1', 'link_2'):
        tip = tips(robot, run, link)[:, 1]
        early, late = np.ptp(tip[run.t < 0.7]), np.ptp(tip[run.t > 1.3])
        assert late > 0.9 * early


def test_rigid_canadarm_reproduces_the_desired_motion() -> None:
    robot, scenario = shipped('canadarm_rrr', 'canadarm')
    ode45 = replace(scenario, method='RK45', rtol=1e-8)
    error = np.abs(joints(robot, ode45.run(robot)) - desired(scenario))
    assert np.max(error) < 1e-8  # "negligible numerical integration errors of the order of 1e-8"


def undamped_canadarm() -> tuple[Robot, Run, Array]:
    overrides = {f'beam.link_{k}.y.damping_ratio': 0.0 for k in (1, 2)}
    robot, scenario = shipped('canadarm', 'canadarm', overrides)
    return robot, scenario.run(robot), desired(scenario)


def test_flexible_canadarm_strays_significantly() -> None:
    robot, run, wanted = undamped_canadarm()
    stray = np.max(np.abs(joints(robot, run) - wanted), axis=0)
    np.testing.assert_allclose(stray, [0.0216, 0.0282, 0.0062], rtol=0.03)
    peaks = [np.max(np.abs(tips(robot, run, link)[:, 1])) for link in ('link_1', 'link_2')]
    np.testing.assert_allclose(peaks, [0.152, 0.0449], rtol=0.02)


@pytest.mark.long
def test_slow_canadarm_hardly_needs_geometric_stiffness() -> None:
    """The book leaves it out there (section 3.10.2); this is what that costs."""
    robot, run, _ = undamped_canadarm()
    _, scenario = shipped('canadarm', 'canadarm')
    without = Robot(robot.tree, robot.gravity, geometric_stiffness=False)
    other = scenario.run(without)
    gap = np.max(np.abs(joints(without, other) - joints(robot, run)))
    assert 1e-4 < gap < 2e-3
    for link in ('link_1', 'link_2'):
        assert np.max(np.abs(tips(without, other, link) - tips(robot, run, link))[:, 1]) < 2.5e-3
