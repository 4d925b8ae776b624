"""What the feedforward does where its input, its model or its start are bad, on real DDS."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from feedforward_bench import POSTURE, RATE, FeedforwardBench, joint_state, point
from node_robots import GRAVITY, JOINTS, LINK, two_links
from rclpy.lifecycle import TransitionCallbackReturn
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from denoc_ros.nodes.feedforward import FeedforwardNode

pytestmark = pytest.mark.ros
DELTA = 0.05  # N m per tick
FIVE_BAR = Path(__file__).resolve().parents[3] / 'config' / 'robots' / 'five_bar_ffff.urdf'
DRIVEN = ['joint_1', 'joint_3']
CLOSED = np.radians([108.0, 72.0]).tolist()
APART = [2.28, 0.86]  # arms apart: the loop does not close


@pytest.fixture
def bench(graph: Any, urdf: str) -> Any:
    return lambda **parameters: FeedforwardBench(graph, urdf, **parameters)


# ---- numbers that no robot has


def test_no_torque_but_a_finite_one_leaves_whatever_the_joint_states_say(
    graph: Any, tmp_path: Path
) -> None:
    sliders = LINK.format(link='two', joint='s1', parent='one', x=1) + LINK.format(
        link='three', joint='s2', parent='two', x=1
    )
    links = LINK.format(link='one', joint='j1', parent='base', x=0)
    links += sliders.replace('revolute', 'prismatic')
    file = tmp_path / 'slider.urdf'
    file.write_text(f'<robot name="slider"><link name="base"/>{links}</robot>')
    effort = graph.collect(JointState, '/feedforward/effort')
    commands = graph.collect(Float64MultiArray, '/feedforward/commands')
    given = {'urdf_path': str(file), 'gravity': GRAVITY, 'update_rate': RATE}
    node = graph.add(
        FeedforwardNode, parameters={**given, 'enforce_command_limits': False, 'ramp_time': 0.05}
    )
    states = graph.publisher(JointState, 'joint_states')
    names = ['j1', 's1', 's2']

    def said(positions: list[float]) -> bool:
        states.publish(joint_state(names, positions))
        return False

    graph.until(
        lambda: said([0.3, 1.7e308, 1.7e308]) or node.joint_input.rejected['out_of_range'] > 20
    )
    assert not effort
    graph.until(lambda: said([0.3, 0.1, 0.1]) or len(effort) > 20)
    graph.until(lambda: said([0.3, 1.7e308, -1.7e308]) or node._cause == 'stale joint_states')
    before = len(effort)
    graph.until(lambda: said([0.3, 0.1, 0.1]) or len(effort) > before + 20)
    node.trigger_deactivate()
    graph.spin(0.1)
    torque = np.array([m.effort for m in effort] + [m.data for m in commands])
    assert np.isfinite(torque).all()
    assert np.abs(torque).max() < 1e3


# ---- a new start in the middle of a motion


def test_after_a_restart_torque_begins_with_what_carries_the_robot(bench: Any) -> None:
    arm = bench(max_delta_tau=DELTA, ramp_time=0.05)
    gravity = arm.inverse(POSTURE)
    for _ in range(2):
        arm.until(lambda: arm.effort and np.allclose(arm.effort[-1].effort, gravity))
        arm.node.trigger_deactivate()
        arm.graph.spin(0.1)
        arm.effort.clear()
        arm.node.trigger_activate()
        arm.until(lambda: arm.effort)
        np.testing.assert_allclose(arm.effort[0].effort, gravity, atol=DELTA)


@pytest.mark.parametrize('action', ['ramp_to_gravity', 'hold', 'zero', 'stop_publishing'])
def test_a_reference_followed_at_once_begins_there_as_well(bench: Any, action: str) -> None:
    arm = bench(max_delta_tau=DELTA, stale_action=action)
    arm.node.trigger_deactivate()
    arm.graph.spin(0.1)
    arm.effort.clear()
    # both are there before the first tick
    arm.follow(point(0.0, POSTURE), point(60.0, POSTURE))
    arm.until(lambda: arm.node.follower.given and arm.node.joint_input.received)
    arm.node.trigger_activate()
    arm.until(lambda: arm.effort)
    assert arm.effort[0].position.tolist() == POSTURE
    np.testing.assert_allclose(arm.effort[0].effort, arm.inverse(POSTURE), atol=2.0 * DELTA)


def test_answers_to_messages_begin_with_what_carries_the_robot(bench: Any) -> None:
    arm = bench(trigger='message', max_delta_tau=DELTA)
    arm.until(lambda: arm.node.joint_input.received)
    message = JointTrajectory(joint_names=JOINTS, points=[point(0.0, POSTURE)])
    message.header.stamp.sec = 1
    arm.reference.publish(message)
    arm.until(lambda: arm.effort)
    np.testing.assert_allclose(arm.effort[0].effort, arm.inverse(POSTURE), atol=DELTA)


def test_a_reloaded_model_brings_its_effort_limits_without_a_jump(bench: Any, urdf: str) -> None:
    arm = bench(max_delta_tau=2.0, ramp_time=0.05)
    gravity = arm.inverse(POSTURE)
    assert gravity[0] > 30.0
    arm.until(lambda: arm.effort and np.allclose(arm.effort[-1].effort, gravity))
    Path(urdf).write_text(two_links().replace('effort="80"', 'effort="20"'))
    reply = arm.call(Trigger, 'reload_model', Trigger.Request())
    assert reply.success, reply.message
    arm.until(lambda: arm.effort and np.abs(arm.effort[-1].effort).max() <= 20.0)
    torque = np.array([m.effort for m in arm.effort])
    first = int(np.argmax(torque[:, 0] == torque[:, 0].max()))
    assert np.abs(np.diff(torque[first:], axis=0)).max() <= 2.0 + 1e-12


# ---- loops


class FiveBar:
    """A feedforward on a five-bar, and what it publishes."""

    def __init__(self, graph: Any) -> None:
        self.graph = graph
        self.effort = graph.collect(JointState, '/feedforward/effort')
        given = {
            'urdf_path': str(FIVE_BAR),
            'gravity': [0.0, -9.81, 0.0],
            'joints': DRIVEN,
            'posture': np.radians([108.0, -72.0, 72.0, 72.0]).tolist(),
            'update_rate': RATE,
            'ramp_time': 0.05,
        }
        self.node = graph.add(FeedforwardNode, parameters=given)
        self.states = graph.publisher(JointState, 'joint_states')
        self.reference = graph.publisher(JointTrajectory, 'reference')
        self.positions = CLOSED
        self._fed = 0.0

    def until(self, condition: Any) -> None:
        def fed() -> object:
            if time.perf_counter() - self._fed > 0.005:
                self._fed = time.perf_counter()
                self.states.publish(joint_state(DRIVEN, self.positions))
            return condition()

        self.graph.until(fed)

    def follow(self, *points: JointTrajectoryPoint) -> None:
        self.reference.publish(JointTrajectory(joint_names=DRIVEN, points=list(points)))


@pytest.fixture
def five_bar(graph: Any) -> FiveBar:
    return FiveBar(graph)


def test_joint_states_that_do_not_close_leave_the_last_good_weight(five_bar: FiveBar) -> None:
    node, effort = five_bar.node, five_bar.effort
    five_bar.positions = APART
    five_bar.until(lambda: node.joint_input.rejected['no_posture'])
    assert not effort  # nothing is known of where it stands
    five_bar.positions = CLOSED
    since: list[Any] = [0, None]  # states accepted when the torque changed last, and the torque

    def has_settled() -> bool:
        torque, taken = list(effort[-1].effort) if effort else None, node.joint_input.accepted
        if torque != since[1]:
            since[:] = taken, torque
        return torque is not None and taken > since[0] + 20

    five_bar.until(has_settled)  # the links are in equilibrium
    held = list(effort[-1].effort)
    assert np.abs(held).max() > 1e-3
    rejected = node.joint_input.rejected['no_posture']
    five_bar.positions = APART
    five_bar.until(lambda: node.joint_input.rejected['no_posture'] > rejected)
    count = len(effort)
    five_bar.until(lambda: len(effort) > count + 20)
    assert list(effort[-1].effort) == held
    assert effort[-1].position.tolist() == CLOSED
    assert node.loop.failure is None
    assert 'where the loops close' in node.joint_input.last_message


def test_a_following_mechanism_goes_safe_where_its_joints_do_not_close(
    five_bar: FiveBar,
) -> None:
    node = five_bar.node
    five_bar.follow(point(0.0, CLOSED), point(60.0, CLOSED))
    five_bar.until(lambda: node._cause == 'following')
    five_bar.positions = APART
    five_bar.until(lambda: node._cause == 'joint_states have no posture')
    five_bar.positions = CLOSED
    five_bar.until(lambda: node._cause == 'following')


def test_a_far_reference_does_not_silence_the_loop(five_bar: FiveBar) -> None:
    node, effort = five_bar.node, five_bar.effort
    five_bar.until(lambda: len(effort) > 10)
    for far in (1e4, 1e5, 1e6, 1e300):
        for points in ([point(0.0, [far, far])], [point(0.0, CLOSED), point(1.0, [far, far])]):
            refused = node.reference_input.rejected['out_of_range']
            five_bar.follow(*points)
            five_bar.until(
                lambda before=refused: node.reference_input.rejected['out_of_range'] > before
            )
    # within reach of the joints, but where nothing closes
    five_bar.follow(point(0.0, APART), point(60.0, APART))
    five_bar.until(lambda: node._cause == 'model failed')
    count = len(effort)
    five_bar.until(lambda: len(effort) > count + 100)
    assert node.loop.failure is None


# ---- ticks that fail


def test_a_tick_that_fails_sends_what_left_last_and_the_loop_goes_on(
    bench: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm = bench()
    arm.hold(POSTURE)
    arm.until(lambda: arm.effort and list(arm.effort[-1].position) == POSTURE)
    held = list(arm.effort[-1].effort)

    def fail(*_: Any) -> None:
        raise ZeroDivisionError('a number was zero')

    monkeypatch.setattr(arm.node.torque, 'update', fail)
    arm.until(lambda: arm.node.tick_failures > 10 or arm.node.loop.failure)
    assert arm.node.loop.failure is None
    count = len(arm.effort)
    arm.until(lambda: len(arm.effort) > count + 20)
    assert list(arm.effort[-1].effort) == held
    arm.until(lambda: arm.graph.value('feedforward: loop', 'failures') not in (None, '0'))
    assert arm.graph.diagnostics['feedforward: loop'].level == b'\x02'
    monkeypatch.undo()
    arm.until(lambda: arm.cause == 'following')
    assert arm.node.loop.running


def test_a_failing_model_is_left_alone_and_the_safe_command_goes_out(
    bench: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm = bench(model='flexible', ramp_time=0.05)
    arm.hold([0.1, 0.2])
    source = arm.node.torque.source
    calls: list[float] = []

    def fail(*_: Any) -> Any:
        calls.append(time.perf_counter())
        end = time.thread_time() + 0.02
        while time.thread_time() < end:
            math.sqrt(2.0)
        source.qd[:] = np.nan
        raise arm.node_error

    from denoc_ros.errors import SolverError

    arm.node_error = SolverError('the inertia must be positive definite, got none')
    monkeypatch.setattr(source, 'update', fail)
    arm.until(lambda: len(calls) >= 3)
    # 20 ms of each 200: a tick in forty
    assert np.diff(calls).min() > 0.15
    # no motion runs: the links hang in equilibrium
    hanging = arm.robot.static_deflection(np.array(POSTURE))
    rest = np.zeros(arm.robot.n)
    weight = arm.robot.inverse_dynamics(hanging, rest, rest)[arm.robot.joint_indices]
    arm.until(lambda: arm.effort and np.allclose(arm.effort[-1].effort, weight, atol=1e-2))
    monkeypatch.undo()
    arm.until(lambda: arm.cause == 'following')


def test_an_end_whose_safe_command_fails_sends_what_left_last(
    bench: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm = bench()
    arm.hold([0.1, 0.2])
    arm.until(lambda: arm.cause == 'following')

    def fail(*_: Any) -> None:
        raise ZeroDivisionError('a defect')

    monkeypatch.setattr(arm.node.carrying, 'update', fail)
    before = arm.node.tick_failures
    assert arm.node.trigger_deactivate() == TransitionCallbackReturn.SUCCESS
    assert arm.node.tick_failures >= before + 5
