"""Phases of `denoc up` that shape their reference, and what a report says of their tip."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from node_robots import gripper
from numpy.typing import NDArray

import denoc_ros as dn
from denoc_ros.bags.run import read_run
from denoc_ros.bags.writer import BagWriter
from denoc_ros.cli.session.phase_plans import asked_at_pace, motion_of, started_on_the_plan
from denoc_ros.cli.session.session_config import SessionConfig, load_config
from denoc_ros.dynamics.driven.motion_plan import Plan
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError
from denoc_ros.planning.shaped_phases import plans_of
from denoc_ros.reports.measures import measure, summarize
from denoc_ros.simulation.reference_motion import trajectory_from_config
from denoc_ros.trajectories import Trajectory

ROOT = Path(__file__).resolve().parents[2]
JOINTS = ['joint_1', 'joint_2']
START_NS = 1_700_000_000_000_000_000
REFERENCE = '{kind: book, start: [0.2, 0.3], rate: [0.25, 0.2], period: [2, 2], duration: 2}'
SESSION = f"""
robot: {ROOT}/config/robots/two_link_ff.urdf
gravity: [0, 0, 0]
reference: {REFERENCE}
phases:
  - {{name: plain}}
  - {{name: shaped, shape: {{method: METHOD}}}}
"""


def session(folder: Path, method: str) -> tuple[SessionConfig, Plan, Robot, Trajectory]:
    path = folder / 'session.yaml'
    path.write_text(SESSION.replace('METHOD', method))
    config = load_config(path)
    robot = dn.load_robot(config.robot, gravity=config.gravity)
    trajectory = trajectory_from_config(config.reference, JOINTS)
    plans = plans_of(config, config.phases, robot, trajectory, JOINTS, lambda _: nullcontext())
    assert list(plans) == ['shaped']
    return config, plans['shaped'], robot, trajectory


def test_what_was_asked_for_keeps_the_pace_of_the_plan(tmp_path: Path) -> None:
    """A tip that is on its path later than asked for, because of a limit, is on its path."""
    _, plan, _, trajectory = session(tmp_path, 'tip')
    assert asked_at_pace(trajectory, plan, JOINTS) is trajectory
    t = 2.0 * plan.t
    slower = replace(plan, t=t, stretch=2.0)
    timed = replace(slower, passed=np.clip(plan.t, 0.0, trajectory.duration))
    for paced in (slower, timed):
        asked = asked_at_pace(trajectory, paced, JOINTS)
        here, there, rate, acceleration = np.zeros((4, 2))
        for moment in np.linspace(0.0, trajectory.duration, 7):
            asked.sample(2.0 * moment, here, rate, acceleration)
            trajectory.sample(moment, there, rate, acceleration)
            np.testing.assert_allclose(here, there, rtol=0, atol=1e-5)


def test_a_phase_follows_the_plan_of_its_reference(tmp_path: Path) -> None:
    config, plan, robot, trajectory = session(tmp_path, 'tip')
    motion = motion_of(plan, JOINTS)
    t, q, _, _ = trajectory.table(0.01)
    alone = dn.shape_motion(robot, t, q)
    np.testing.assert_allclose(plan.q, alone.q, rtol=0, atol=1e-12)
    at, qd, qdd = np.zeros((3, 2))
    motion.sample(0.7, at, qd, qdd)
    joints = [robot.coordinate_names.index(name) for name in JOINTS]
    column = np.array([np.interp(0.7 + alone.t[0], alone.t, alone.q[:, k]) for k in joints])
    np.testing.assert_allclose(at, column, rtol=0, atol=1e-5)
    assert motion.duration == pytest.approx(2.0 + alone.preaction + alone.postaction)
    phase = started_on_the_plan(config.phases[1], plan, JOINTS)
    np.testing.assert_allclose(phase.nodes['plant']['start'], alone.q[0, joints], atol=1e-12)


GRIPPER = """
robot: gripper.urdf
gravity: [0, 0, 0]
joints: [j1, j2, left]
reference: {kind: points, times: [0, 0.6], positions: [[0, 0, 0], [0.4, -0.3, 0.5]]}
phases: [{name: shaped, shape: {method: METHOD, output_step: 0.01}}]
"""
FIVE_BAR = f"""
robot: {ROOT}/config/robots/five_bar_ffff.urdf
gravity: [0, -9.81, 0]
joints: [joint_1, joint_3]
posture: [1.885, -1.2566, 1.2566, 1.2566]
reference: {{kind: points, times: [0, 2], positions: [[1.885, 1.2566], [2.085, 1.1566]]}}
phases: [{{name: shaped, shape: {{method: METHOD, tip: joint_5/parent}}}}]
"""


@pytest.mark.long_cases('text1-tip')
@pytest.mark.parametrize(('text', 'method'), [(GRIPPER, 'zv'), (FIVE_BAR, 'tip')])
def test_mimic_joints_and_loops_follow_the_driven_joints(
    text: str, method: str, tmp_path: Path
) -> None:
    (tmp_path / 'gripper.urdf').write_text(gripper())
    path = tmp_path / 'session.yaml'
    path.write_text(text.replace('METHOD', method))
    config = load_config(path)
    robot = dn.load_robot(config.robot, gravity=config.gravity)
    joints = config.joints
    trajectory = trajectory_from_config(config.reference, joints)
    (plan,) = plans_of(
        config, config.phases, robot, trajectory, joints, lambda _: nullcontext()
    ).values()
    assert plan.joint_names == joints
    assert np.abs(robot.closure(plan.q)).max() < 1e-8
    assert motion_of(plan, joints).duration > 0.6


@pytest.mark.parametrize(
    ('method', 'message'),
    [
        ('magic', "phase 'shaped': shape: shape_motion: method must be one of .*got 'magic'"),
        ('tip, tip: nose', "phase 'shaped': shape: .*tip must be"),
        ('tip, colour: red', "phase 'shaped': shape: .*colour"),
    ],
)
def test_a_shape_that_cannot_be_is_refused(tmp_path: Path, method: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        session(tmp_path, method)


def test_nothing_is_shaped_from_no_reference(tmp_path: Path) -> None:
    path = tmp_path / 'session.yaml'
    path.write_text(SESSION.replace('METHOD', 'tip').replace(f'reference: {REFERENCE}\n', ''))
    config = load_config(path)
    robot = dn.load_robot(config.robot)
    with pytest.raises(ConfigError, match='phases that shape must have a reference, got none'):
        plans_of(config, config.phases, robot, None, JOINTS, lambda _: nullcontext())


def rows(t: NDArray[np.float64], q: NDArray[np.float64]) -> list[dict[str, object]]:
    return [
        {
            'positions': position.tolist(),
            'time_from_start': {'sec': int(at), 'nanosec': round(1e9 * (at % 1.0))},
        }
        for at, position in zip(t.tolist(), q, strict=True)
    ]


def test_the_tip_is_judged_by_what_was_asked_for_and_after_the_stop(tmp_path: Path) -> None:
    """The joints begin 0.5 s early on a detour, come back, and swing by a known angle."""
    robot = dn.load_robot(ROOT / 'config' / 'robots' / 'two_link_rr.urdf', gravity=(0, 0, 0))
    kinds = {
        '/up/phase': 'std_msgs/msg/String',
        '/up/asked': 'trajectory_msgs/msg/JointTrajectory',
        '/reference': 'trajectory_msgs/msg/JointTrajectory',
        '/joint_states': 'sensor_msgs/msg/JointState',
        '/plant/true_modal_state': 'sensor_msgs/msg/JointState',
    }
    t, early, swing = np.linspace(0.0, 2.0, 21), 0.5, 1e-3

    def cycloid(at: NDArray[np.float64]) -> NDArray[np.float64]:
        inside = np.clip(at, 0.0, 2.0)
        way = inside / 2.0 - np.sin(np.pi * inside) / (2.0 * np.pi)
        return np.outer(way, [0.2, 0.1])

    asked = cycloid(t)
    done = np.linspace(0.0, 2.5, 26)
    planned = cycloid(done - early)
    planned += 0.01 * np.sin(np.pi * np.clip(done / early, 0.0, 1.0))[:, None]
    with BagWriter(tmp_path / 'bag') as bag:
        for topic, kind in kinds.items():
            bag.add_topic(topic, kind)
        bag.write_message('/up/phase', START_NS, data='shaped')
        names = list(robot.joint_names)
        for topic, points, begin in (
            ('/reference', rows(done, planned), 0.0),
            ('/up/asked', rows(t, asked), early),
        ):
            stamp = START_NS + round(1e9 * begin)
            bag.write_message(topic, stamp, joint_names=names, points=points)
        for now in np.arange(0.0, 4.5, 0.01):
            q = cycloid(np.array([now - early]))[0]
            if now > early + 2.0:
                q[0] += swing * np.sin(20.0 * now)
            message = {'name': names, 'position': q}
            stamp = START_NS + round(1e9 * now)
            bag.write_message('/joint_states', stamp, **message)
            bag.write_message('/plant/true_modal_state', stamp, **message)
        bag.write_message('/up/phase', START_NS + round(4.5e9), data='')
    (phase,) = measure(read_run(tmp_path / 'bag'), robot, 'tool')
    assert phase.stop == pytest.approx(early + 2.0)
    numbers = summarize((phase,))['shaped']
    assert numbers['tip_error_moving']['max'] < 1e-4
    reach = float(np.linalg.norm(robot.frame_pose('tool', asked[-1])[:3, 3]))
    assert numbers['tip_error_after_stop']['max'] == pytest.approx(swing * reach, rel=0.01)
    # the bag may lack every mark: the session knows its phases too
    noted = {'name': 'noted', 'begin_ns': START_NS, 'end_ns': START_NS + round(4.4e9)}
    (same,) = measure(read_run(tmp_path / 'bag', phases=[noted]), robot, 'tool')
    assert summarize((same,))['noted']['tip_error_moving'] == numbers['tip_error_moving']
    cut = read_run(tmp_path / 'bag', phases=[{**noted, 'end_ns': None}])
    assert [interval.name for interval in cut.phases] == ['noted (unfinished)']
