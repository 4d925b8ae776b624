"""State feedback in the feedforward node: when it acts, lets go, and is refused."""

from __future__ import annotations

import math
import os
import re
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from child_processes import gone
from feedback_runs import CANADARM
from imu_arms import ENDS, imu_text
from node_robots import STATE_FEEDBACK
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from denoc_ros.feedback.planned_states import spacing
from denoc_ros.nodes.feedforward import FeedforwardNode

pytestmark = pytest.mark.ros

RATE = 400.0
JOINTS = ['joint_1', 'joint_2', 'joint_3']
COMMON = {'urdf_path': str(CANADARM), 'gravity': [0.0, 0.0, 0.0], 'update_rate': RATE}
START = [0.2, 0.7, 0.5]
AWAY = 2e-5  # rad
GAUGES = ['link_1_y_root', 'link_1_y_middle', 'link_2_y_root', 'link_2_y_middle']
LONG = 300.0  # s, for a machine that is busy with others


def trajectory(*points: tuple[float, list[float]]) -> JointTrajectory:
    message = JointTrajectory(joint_names=JOINTS)
    for after, positions in points:
        point = JointTrajectoryPoint(positions=positions)
        point.time_from_start.sec = int(after)
        point.time_from_start.nanosec = round((after - int(after)) * 1e9)
        message.points.append(point)
    return message


class Feed:
    """Joints beside the reference, and sensors, published as long as they are to speak.

    Parameters
    ----------
    graph : Graph
    imus : bool
        Whether the sensors are IMUs in place of gauges.
    away : float
        How far the joints stand beside the reference [rad]. No torque moves them: after seconds
        of torque the estimate leaves all bounds.
    """

    def __init__(self, graph: Any, imus: bool = False, away: float = AWAY) -> None:
        self.graph, self.speak, self._away = graph, True, away
        self._joints = graph.publisher(JointState, 'joint_states')
        kind, topics = (
            (Imu, [f'imu/{link}' for link in ENDS]) if imus else (JointState, ['strain'])
        )
        self._sensors = [graph.probe.create_publisher(kind, topic, 10) for topic in topics]
        self._still = Imu() if imus else JointState(name=GAUGES, position=[0.0] * 4)
        self._last = 0.0

    def until(self, condition: Callable[[], object]) -> None:
        def fed() -> object:
            now = time.perf_counter()
            if now - self._last > 0.002:
                self._last = now
                beside = [each + self._away for each in START]
                self._joints.publish(JointState(name=JOINTS, position=beside, velocity=[0.0] * 3))
                if self.speak:
                    for sensor in self._sensors:
                        sensor.publish(self._still)
            return condition()

        self.graph.until(fed, LONG)


def test_silent_gauges_leave_the_plan_alone_and_a_motion_gets_gains_of_its_own(
    graph: Any,
) -> None:
    node = graph.add(FeedforwardNode, parameters={**COMMON, **STATE_FEEDBACK})
    commands = graph.collect(Float64MultiArray, '/feedforward/commands')
    reference = graph.publisher(JointTrajectory, 'reference')
    feed, state = Feed(graph), node.feedback.law.state
    feed.until(lambda: node.joint_input.received)
    reference.publish(trajectory((0.0, START), (0.1, START)))

    def torque() -> float:
        return float(np.abs(commands[-1].data).max()) if commands else 0.0

    # there is no gravity, and the plan is at rest: all torque is the feedback's
    feed.until(lambda: state.active and torque() > 0.1)
    feed.speak = False
    feed.until(lambda: not state.active)
    feed.until(lambda: torque() < 1e-6)
    name = 'feedforward: state feedback'
    # a status of the start may still be the newest: it has the cause as well, and no fall back
    feed.until(lambda: int(graph.value(name, 'fallbacks') or 0) > 0)
    assert 'no good values of link' in graph.value(name, 'cause')
    feed.speak = True
    feed.until(lambda: state.active and torque() > 0.1)

    before = state.designs
    gains = math.ceil(2.0 / spacing(2.0, 1.0 / RATE)) + 1
    there = [each + 0.02 for each in START]
    reference.publish(trajectory((0.0, START), (2.0, there)))
    feed.until(lambda: state.designs > before and state.postures == gains)
    assert state.status().values['refused'] == ''
    assert node.tick_failures == 0


def test_imus_reach_the_feedback_and_a_dead_one_leaves_the_plan_alone(
    graph: Any, tmp_path: Path
) -> None:
    file = tmp_path / 'arm.urdf'
    file.write_text(imu_text())
    given = {**COMMON, **STATE_FEEDBACK, 'urdf_path': str(file)}
    node = graph.add(FeedforwardNode, parameters=given)
    reference = graph.publisher(JointTrajectory, 'reference')
    feed, state = Feed(graph, imus=True, away=0.0), node.feedback.law.state
    feed.until(lambda: node.joint_input.received)
    reference.publish(trajectory((0.0, START), (0.1, START)))
    feed.until(lambda: state.active)
    feed.speak = False
    feed.until(lambda: not state.active)
    name = 'feedforward: state feedback'
    dead = re.compile(r'no good values of link_\d_imu/gyro_[xyz]')
    feed.until(lambda: dead.search(graph.value(name, 'cause') or ''))
    forces = [f'{link}_imu/accel_{axis}' for link in ENDS for axis in 'xyz']
    assert graph.value(name, 'unread') == ' '.join(forces)
    feed.speak = True
    feed.until(lambda: state.active)
    assert node.tick_failures == 0


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'model': 'rigid'}, "'model' must be flexible with state feedback, got 'rigid'"),
        ({'terms.elastic': False}, "'terms.elastic' must be true with state feedback"),
        ({'feedback.strain_gain': [1.0] * 3}, 'must not be set both'),
        ({'feedback.tip': 'nose'}, "tip must be one of base, .*, got 'nose'"),
        ({'enforce_command_limits': False}, 'effort limits must be finite and > 0'),
        (
            {'feedback.integral_time': 0.01},
            r'must be stable for 0\.8 to 1\.2 of the stiffness .*, got modulus \d\.\d+ at',
        ),
    ],
)
def test_what_cannot_work_is_refused_at_configure(
    graph: Any, change: dict[str, Any], message: str
) -> None:
    given = {**COMMON, **STATE_FEEDBACK, **change}
    node = graph.add(FeedforwardNode, start=False, parameters=given)
    node.trigger_configure()
    assert node.state == 'unconfigured'
    with pytest.raises(ValueError, match=message):
        raise ValueError(node.failure)


def change(node: Any, **values: Any) -> None:
    """Set parameters as a client does; each must be accepted."""
    named = [Parameter(name.replace('__', '.'), value=value) for name, value in values.items()]
    began = time.perf_counter()
    results = node.set_parameters(named)
    assert [result.reason for result in results] == [''] * len(named)
    assert time.perf_counter() - began < 10.0  # at once, on a machine that is busy with others


def test_state_feedback_is_switched_on_and_off_while_the_node_is_active(graph: Any) -> None:
    given = {**COMMON, **STATE_FEEDBACK, 'feedback.state': 'off', 'max_delta_tau': 5.0}
    node = graph.add(FeedforwardNode, parameters=given)
    commands = graph.collect(Float64MultiArray, '/feedforward/commands')
    reference = graph.publisher(JointTrajectory, 'reference')
    state = node.feedback.law.state
    change(node, feedback__state='lqr')
    feed = Feed(graph)
    feed.until(lambda: node.joint_input.received)
    reference.publish(trajectory((0.0, START), (0.1, START)))

    def torque() -> float:
        return float(np.abs(commands[-1].data).max()) if commands else 0.0

    # there is no gravity, and the plan is at rest: all torque is the feedback's
    feed.until(lambda: state.active and torque() > 0.1)
    change(node, feedback__joint_error=0.1)
    designs = state.designs
    # a loop that falls behind beside other tests lets the gains go, and begins anew
    feed.until(lambda: state.designs > designs and state.active)
    (result,) = node.set_parameters([Parameter('feedback.tip', value='nose')])
    assert 'tip must be one of base, ' in result.reason
    feed.until(lambda: state.active)
    pid = state._worker.planner.pid
    assert pid is not None
    change(node, feedback__state='off')
    feed.until(lambda: not state.wanted and torque() < 1e-6)
    feed.until(lambda: gone(pid))
    assert node.tick_failures == 0
    change(node, feedback__state='lqr')
    feed.until(lambda: state.active and torque() > 0.1)
    taken = np.abs(np.diff([command.data for command in commands], axis=0)).max()
    assert taken < 2.0  # N m, of 5000: it comes and goes by its ramps


def test_gains_whose_process_is_stopped_cost_no_torque(
    graph: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr('denoc_ros.nodes.feedforward.DESIGN_PATIENCE', 1e-3)
    node = graph.add(FeedforwardNode, parameters={**COMMON, **STATE_FEEDBACK})
    planner = node.feedback.law.state._worker.planner
    graph.until(lambda: planner.pid is not None)
    first = planner.pid
    os.kill(first, signal.SIGSTOP)  # while it starts
    commands = graph.collect(Float64MultiArray, '/feedforward/commands')
    reference = graph.publisher(JointTrajectory, 'reference')
    feed, state = Feed(graph), node.feedback.law.state
    feed.until(lambda: node.joint_input.received)
    reference.publish(trajectory((0.0, START), (0.1, START)))
    feed.until(lambda: len(commands) > 100)
    change(node, payload__tool__mass=55.0)
    change(node, feedback__effort_share=0.2)
    feed.until(lambda: len(commands) > 200)
    assert state.cause == 'no gains yet'
    change(node, feedback__state='off')
    feed.until(lambda: gone(first))
    change(node, feedback__state='lqr')
    feed.until(lambda: state.active)
    os.kill(state._worker.planner.pid, signal.SIGSTOP)
    before = len(commands)
    there = [each + 0.02 for each in START]
    reference.publish(trajectory((0.0, START), (2.0, there)))
    feed.until(lambda: len(commands) > before + 400)
    assert node.tick_failures == 0
