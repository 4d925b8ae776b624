"""Phases of `denoc up` that shape the reference of an arm on a spacecraft."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

import denoc_ros as dn
from denoc_ros.bags.run import read_run
from denoc_ros.bags.writer import BagWriter
from denoc_ros.cli.session.session_config import load_config
from denoc_ros.planning.plan_simulation import planned
from denoc_ros.planning.shaped_phases import plans_of
from denoc_ros.reports.measures import measure, summarize
from denoc_ros.simulation.reference_motion import trajectory_from_config

ROOT = Path(__file__).resolve().parents[2]
START_NS = 1_700_000_000_000_000_000
SESSION = f"""
robot: {ROOT}/config/robots/canadarm_10t.urdf
gravity: [0, 0, 0]
reference: {{kind: book, start: [0.2, 0.7, 0.5], rate: [0.1, 0.04, 0.02], period: 5, duration: 5}}
phases:
  - {{name: reacts, shape: {{method: tip}}}}
  - {{name: held, shape: {{method: tip}}, feedforward: {{base: free_flying}}}}
  - {{name: told, shape: {{method: zv, base: free_flying}}}}
"""
KINDS = {
    '/up/phase': 'std_msgs/msg/String',
    '/up/asked': 'trajectory_msgs/msg/JointTrajectory',
    '/reference': 'trajectory_msgs/msg/JointTrajectory',
    '/joint_states': 'sensor_msgs/msg/JointState',
    '/plant/true_modal_state': 'sensor_msgs/msg/JointState',
}


def test_a_plan_has_the_feedforwards_base_and_its_tip_is_judged_in_the_world(
    tmp_path: Path,
) -> None:
    path = tmp_path / 'session.yaml'
    path.write_text(SESSION)
    config = load_config(path)
    robot = dn.load_robot(config.robot, gravity=config.gravity)
    joints = list(robot.joint_names)
    trajectory = trajectory_from_config(config.reference, joints)
    plans = plans_of(config, config.phases, robot, trajectory, joints, lambda _: nullcontext())
    assert plans['reacts'].base_wrench is None
    assert plans['held'].base_wrench is not None
    assert plans['told'].base_wrench is not None
    plan = plans['reacts']
    begin = START_NS + round(-1e9 * plan.t[0])
    t, asked, _, _ = trajectory.table(0.02)
    with BagWriter(tmp_path / 'bag') as bag:
        for topic, kind in KINDS.items():
            bag.add_topic(topic, kind)
        bag.write_message('/up/phase', START_NS, data='reacts')
        q = plan.q[:, robot.joint_indices]
        for topic, stamp, times, rows in (
            ('/reference', START_NS, plan.t - plan.t[0], q),
            ('/up/asked', begin, t, asked),
        ):
            points = [
                {
                    'positions': row.tolist(),
                    'time_from_start': {'sec': int(at), 'nanosec': round(1e9 * (at % 1.0))},
                }
                for at, row in zip(times.tolist(), rows, strict=True)
            ]
            bag.write_message(topic, stamp, joint_names=joints, points=points)
        every = planned(plan, plan.coordinate_names)
        at = np.arange(plan.t[0], plan.t[-1], 0.02)
        for now, row in zip(at.tolist(), every(at)[0], strict=True):
            stamp = begin + round(1e9 * now)
            bag.write_message(
                '/joint_states', stamp, name=joints, position=row[robot.joint_indices]
            )
            names = list(robot.coordinate_names)
            bag.write_message('/plant/true_modal_state', stamp, name=names, position=row)
    (phase,) = measure(read_run(tmp_path / 'bag'), robot, 'tool')
    numbers = summarize((phase,))['reacts']
    # against a base that stood still it would be off by 4.7 m
    assert numbers['tip_error_moving']['max'] < 1e-4
    assert np.linalg.norm(plan.q[-1, robot.base_indices[:3]]) > 0.02
    assert phase.stop == pytest.approx(5.0 - plan.t[0], abs=1e-6)
