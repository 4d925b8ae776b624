"""The feedforward node on real DDS."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from feedforward_bench import POSTURE, FeedforwardBench, joint_state, point, stamp
from node_robots import GRAVITY, JOINTS, two_links
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from denoc_ros.dynamics.robot import load_robot

pytestmark = pytest.mark.ros


@pytest.fixture
def bench(graph: Any, urdf: str) -> Any:
    return lambda **parameters: FeedforwardBench(graph, urdf, **parameters)


def test_torque_is_inverse_dynamics_along_the_reference(bench: Any) -> None:
    arm = bench(publish_joint_trajectory=True, enforce_command_limits=False)
    arm.follow(point(0.0, [0.0, 0.0]), point(0.3, [0.5, -0.6]), point(0.6, [0.0, 0.3]))
    arm.until(lambda: arm.node.follower.given and len(arm.points) > 5 and arm.cause == 'following')
    arm.until(lambda: arm.node.follower.finished(time.perf_counter()))
    moving = [m.points[0] for m in arm.points if np.any(m.points[0].velocities)]
    assert len(moving) > 20  # of 120: a busy machine leaves some out
    assert max(np.abs(p.accelerations).max() for p in moving) > 5.0
    for p in moving:
        expected = arm.inverse(p.positions, p.velocities, p.accelerations)
        np.testing.assert_allclose(p.effort, expected, atol=1e-9)
    # all three topics say the same
    last = arm.effort[-1]
    arm.until(lambda: any(list(c.data) == list(last.effort) for c in arm.commands))
    assert arm.commands[-1].layout.dim[0].label == 'j1,j2'
    assert last.name == JOINTS


def test_trajectory_read_late_begins_when_its_stamp_says(bench: Any) -> None:
    node = bench().node
    message = JointTrajectory(joint_names=JOINTS)
    message.points = [point(0.0, [0.0, 0.0]), point(1.0, [0.5, 0.5])]
    begin = time.perf_counter() + 5.0
    stamp(message, time.time_ns() + 5 * 10**9)
    node._on_reference(serialize_message(message), time.perf_counter() - 0.5)
    q, qd, qdd = np.zeros((3, 2))
    assert node.follower.sample(begin + 0.5, q, qd, qdd)
    # rate there 0.75 rad/s: half a second's shift would show, 5 ms of a busy machine pass
    np.testing.assert_allclose(q, 0.25, atol=0.01)


def test_one_answer_per_message_with_its_stamp(bench: Any) -> None:
    arm = bench(trigger='message', enforce_command_limits=False)
    rng = np.random.default_rng(1)
    count, rows = 500, rng.normal(size=(500, 3, 2))
    for k in range(count):
        message = JointTrajectory(joint_names=['j2', 'j1'])
        message.points = [point(0.0, *(row[::-1].tolist() for row in rows[k]))]
        stamp(message, 1_000_000 * (k + 1))
        arm.reference.publish(message)
        arm.graph.executor.spin_once(0.001)
    arm.until(lambda: len(arm.effort) == count)
    for k, message in enumerate(arm.effort):
        assert message.header.stamp.nanosec == 1_000_000 * (k + 1)
        np.testing.assert_array_equal([message.position, message.velocity], rows[k, :2])
        np.testing.assert_allclose(message.effort, arm.inverse(*rows[k]), atol=1e-9)
    assert not arm.commands
    arm.follow(point(0.0, [0.0, 0.0]), point(1.0, [0.0, 0.0]))
    arm.until(lambda: arm.node.reference_input.rejected['not_streamed'] == 1)


def test_one_wrong_position_leaves_no_trace_in_the_answers(bench: Any) -> None:
    arm = bench(trigger='message', model='flexible')
    count, wrong = 250, 150
    answers = []
    for error in (0.3, math.nan):  # A wrong point, and none.
        arm.effort.clear()
        for k in range(count):
            swing = 0.2 * (1.0 - math.cos(4.0 * 0.004 * k))
            message = JointTrajectory(joint_names=JOINTS)
            message.points = [point(0.0, [swing, -swing + (error if k == wrong else 0.0)])]
            stamp(message, 4_000_000 * (k + 1))
            if k != wrong or math.isfinite(error):
                arm.reference.publish(message)
                arm.graph.executor.spin_once(0.001)
        arm.until(lambda: len(arm.effort) == count - 1)
        answers.append(np.array([message.effort for message in arm.effort]))
        arm.call(Trigger, 'reset', Trigger.Request())
    np.testing.assert_allclose(answers[0], answers[1], rtol=0, atol=1e-3 * np.abs(answers).max())
    assert arm.node.reference_input.rejected == {'implausible': 1}


def test_measured_motion_can_be_the_reference(bench: Any) -> None:
    arm = bench(trigger='message', reference_source='joint_states', acceleration_cutoff=1e6)
    for k in range(50):
        t = 0.01 * (k + 1)
        message = joint_state(JOINTS, [0.5 * t * t, 0.0], round(t * 1e9))
        message.velocity = [t, 0.0]
        arm.states.publish(message)
        arm.graph.executor.spin_once(0.01)
    arm.feeding = False
    arm.until(lambda: len(arm.effort) == 50)
    last = arm.effort[-1]
    expected = arm.inverse(last.position, last.velocity, [1.0, 0.0])
    np.testing.assert_allclose(last.effort, expected, atol=1e-6)


def test_bad_references_do_not_move_the_robot(bench: Any) -> None:
    arm = bench()
    points = [point(0.0, POSTURE), point(0.01, POSTURE)]
    good = JointTrajectory(joint_names=JOINTS, points=points)
    stamp(good, time.time_ns())
    arm.reference.publish(good)
    arm.until(lambda: arm.cause == 'following')
    arm.until(lambda: arm.effort and list(arm.effort[-1].position) == POSTURE)
    held = list(arm.effort[-1].effort)
    far = [1.0, 1.0]
    backwards = JointTrajectory(joint_names=JOINTS, points=[point(0.0, far)])
    stamp(backwards, time.time_ns() - 3_000_000_000)
    bad = {
        'non_finite': JointTrajectory(joint_names=JOINTS, points=[point(0.0, [1.0, math.nan])]),
        'wrong_length': JointTrajectory(joint_names=JOINTS, points=[point(0.0, [1.0])]),
        'unknown_joint': JointTrajectory(joint_names=['j1', 'x'], points=[point(0.0, far)]),
        'missing_joint': JointTrajectory(joint_names=[], points=[point(0.0, [])]),
        'times_not_increasing': JointTrajectory(
            joint_names=JOINTS, points=[point(1.0, far), point(1.0, far)]
        ),
        'backwards_stamp': backwards,
    }
    for cause, message in bad.items():
        arm.reference.publish(message)
        arm.until(lambda cause=cause: arm.node.reference_input.rejected[cause] == 1)
    other = arm.graph.probe.create_publisher(JointTrajectory, 'reference', 1)
    arm.reference.publish(backwards)  # both talk
    other.publish(JointTrajectory(joint_names=JOINTS, points=[point(0.0, far)]))
    arm.until(lambda: arm.node.reference_input.rejected['second_publisher'] > 0)
    count = len(arm.effort)
    arm.until(lambda: len(arm.effort) > count + 20)
    positions = np.array([m.position for m in arm.effort[-20:]])
    assert (positions == POSTURE).all()
    assert list(arm.effort[-1].effort) == held
    key = 'reference rejected '
    arm.until(
        lambda: all(
            arm.graph.value('feedforward: inputs', key + cause) is not None
            for cause in [*bad, 'second_publisher']
        )
    )


def test_joints_without_velocity_and_effort_interfaces_are_followed(bench: Any) -> None:
    arm = bench()
    arm.feeding = False
    message = joint_state(JOINTS, POSTURE)
    message.velocity, message.effort = [math.nan, math.nan], [1.0, math.nan]

    def follows() -> bool:
        arm.states.publish(message)
        return bool(arm.node.follower.given and arm.cause == 'following')

    arm.follow(point(0.0, POSTURE), point(0.01, POSTURE))
    arm.until(follows)
    assert not arm.node.joint_input.rejected


def test_joints_that_are_not_named_hold_and_a_trajectory_without_points_cancels(
    bench: Any,
) -> None:
    arm = bench(joint_state_timeout=1.0)  # a busy machine feeds it late
    arm.until(lambda: arm.node.joint_input.received)
    arm.follow(point(0.0, [POSTURE[1]]), point(30.0, [1.3]), joints=['j2'])
    arm.until(lambda: arm.effort and arm.cause == 'following')
    arm.until(lambda: arm.effort and arm.effort[-1].position[1] > POSTURE[1] + 1e-6)
    arm.reference.publish(JointTrajectory())
    arm.until(lambda: arm.effort and arm.effort[-1].velocity[1] == 0.0 and arm.node.follower.given)
    moving = [m for m in arm.effort if m.velocity[1] != 0.0]
    assert {m.position[0] for m in moving} == {POSTURE[0]}
    there = arm.effort[-1].position[1]
    assert POSTURE[1] < there < 0.0
    count = len(arm.effort)
    arm.until(lambda: len(arm.effort) > count + 20)
    assert arm.effort[-1].position[1] == there
    assert arm.cause == 'following'


def test_a_reference_of_stamp_zero_starts_now_whatever_came_before(bench: Any) -> None:
    arm = bench()
    before = JointTrajectory(joint_names=JOINTS, points=[point(0.0, POSTURE)])
    stamp(before, time.time_ns())
    arm.reference.publish(before)
    arm.until(lambda: arm.node.reference_input.accepted)
    arm.hold([0.1, 0.2])
    arm.until(lambda: arm.effort and list(arm.effort[-1].position) == [0.1, 0.2])
    assert not arm.node.reference_input.rejected


def test_motions_out_of_reach_are_refused(bench: Any) -> None:
    arm = bench(trigger='message', model='flexible')
    for second, size in enumerate((0.1, 1e200, 0.1), start=1):
        message = JointTrajectory(joint_names=JOINTS, points=[point(0.0, *[[size] * 2] * 3)])
        stamp(message, second * 1_000_000_000)
        arm.reference.publish(message)
    arm.until(lambda: len(arm.effort) == 2)
    assert arm.node.reference_input.rejected == {'out_of_range': 1}
    assert arm.node.torque.restarts.failures == 0


def test_a_backwards_joint_state_is_no_posture_to_carry(bench: Any) -> None:
    arm = bench()
    arm.feeding = False
    now = time.time_ns()
    arm.states.publish(joint_state(JOINTS, POSTURE, now))
    arm.until(lambda: arm.node.joint_input.accepted == 1)
    arm.states.publish(joint_state(JOINTS, [1.5, 1.5], now - 1_000_000_000))
    arm.until(lambda: arm.node.joint_input.rejected['backwards_stamp'] == 1)
    count = len(arm.effort)
    arm.until(lambda: len(arm.effort) > count + 20)
    assert list(arm.effort[-1].position) == POSTURE
    np.testing.assert_allclose(arm.effort[-1].effort, arm.inverse(POSTURE), rtol=1e-9)


def test_bad_joint_states_age_into_the_safe_command(bench: Any) -> None:
    arm = bench(ramp_time=0.05)
    arm.hold([0.0, 0.0])
    arm.feeding = False
    nan = joint_state(JOINTS, [math.nan, 0.0])

    def flood() -> bool:
        arm.states.publish(nan)
        return bool(arm.cause == 'stale joint_states')

    arm.until(flood)
    assert arm.node.joint_input.rejected['non_finite'] > 0
    gravity = arm.inverse(POSTURE)  # where the robot was last seen
    arm.until(lambda: arm.effort and np.allclose(arm.effort[-1].effort, gravity, atol=1e-9))
    arm.until(lambda: arm.graph.value('feedforward: torque', 'cause') == 'stale joint_states')
    assert arm.graph.diagnostics['feedforward: torque'].level == b'\x01'
    assert arm.graph.value('feedforward: torque', 'takeovers') == '1'
    arm.feeding = True
    arm.until(lambda: arm.cause == 'following')


@pytest.mark.parametrize('action', ['hold', 'zero', 'stop_publishing'])
def test_a_stale_stream_ends_in_the_chosen_action(bench: Any, action: str) -> None:
    arm = bench(stale_action=action, reference_timeout=1.0)
    arm.until(lambda: arm.node.joint_input.received)
    arm.follow(point(0.0, POSTURE, [0.0, 0.0], [1.0, 2.0]))
    arm.until(lambda: arm.cause == 'following')
    expected = arm.inverse(POSTURE, [0.0, 0.0], [1.0, 2.0])
    arm.until(lambda: arm.effort and np.allclose(arm.effort[-1].effort, expected, atol=1e-9))
    arm.until(lambda: arm.cause == 'stale reference')
    arm.graph.spin(0.3)  # let what is under way arrive
    count = len(arm.effort)
    arm.graph.spin(0.1)
    if action == 'stop_publishing':
        assert len(arm.effort) == count
    else:
        target = expected if action == 'hold' else np.zeros(2)
        arm.until(lambda: len(arm.effort) > count)
        np.testing.assert_allclose(arm.effort[-1].effort, target, atol=1e-9)


def test_limits_and_rate_of_change_hold_whatever_is_asked(bench: Any) -> None:
    arm = bench(max_delta_tau=2.0, effort_limits=[30.0, 1.5], ramp_time=0.05)
    arm.until(lambda: arm.effort)
    push = [1e5, -9e5]
    wanted = np.copysign([30.0, 1.5], arm.inverse(POSTURE, [0.0, 0.0], push))

    def pushed() -> bool:
        arm.follow(point(0.0, POSTURE, [0.0, 0.0], push))
        return bool(list(arm.effort[-1].effort) == wanted.tolist())

    arm.until(pushed)
    torque = np.array([m.effort for m in arm.effort])
    assert (np.abs(torque) <= [30.0, 1.5]).all()
    assert np.abs(np.diff(torque, axis=0)).max() <= 2.0 + 1e-12
    arm.until(lambda: arm.graph.value('feedforward: torque', 'clamped') not in (None, '0 0'))
    assert 'clamped' in arm.graph.diagnostics['feedforward: torque'].message


def test_enable_stop_and_reset(bench: Any) -> None:
    arm = bench(enabled=False, ramp_time=0.02)
    arm.follow(point(0.0, [0.0, 0.0]), point(0.01, [0.0, 0.0]))
    arm.until(lambda: arm.cause == 'disabled' and arm.node.follower.given)
    gravity = arm.inverse(POSTURE)
    arm.until(lambda: arm.effort and np.allclose(arm.effort[-1].effort, gravity, atol=1e-9))
    assert arm.call(SetBool, 'enable', SetBool.Request(data=True)).success
    arm.until(lambda: arm.cause == 'following')
    arm.until(
        lambda: (
            arm.effort and np.allclose(arm.effort[-1].effort, arm.inverse([0.0, 0.0]), atol=1e-9)
        )
    )
    assert arm.call(Trigger, 'stop', Trigger.Request()).success
    arm.until(lambda: arm.cause == 'stopped')
    arm.until(lambda: arm.effort and np.allclose(arm.effort[-1].effort, gravity, atol=1e-9))
    arm.call(SetBool, 'enable', SetBool.Request(data=True))
    arm.until(lambda: arm.cause == 'no reference yet')  # stop dropped it
    arm.hold([0.1, 0.1])
    assert arm.call(Trigger, 'reset', Trigger.Request()).success
    arm.until(lambda: arm.cause == 'no reference yet')
    arm.feeding = False  # nothing says where the robot stands: what carried it goes on
    arm.until(lambda: arm.cause == 'stale joint_states')
    assert arm.call(Trigger, 'reset', Trigger.Request()).success
    arm.until(lambda: arm.cause == 'no joint_states yet')
    count = len(arm.effort)
    arm.until(lambda: len(arm.effort) > count + 20)
    np.testing.assert_allclose(arm.effort[-1].effort, gravity, atol=1e-9)


def test_deactivation_ends_with_the_safe_command_said_repeatedly(bench: Any) -> None:
    arm = bench(ramp_time=0.4)
    arm.hold([1.2, 0.0])
    arm.until(lambda: arm.effort and list(arm.effort[-1].position) == [1.2, 0.0])
    count = len(arm.commands)
    arm.node.trigger_deactivate()
    gravity = arm.inverse(POSTURE)

    def is_carried() -> bool:
        last = [command.data for command in arm.commands[count:]][-3:]
        return len(last) == 3 and np.allclose(last, gravity, rtol=0.0, atol=1e-9)

    arm.until(is_carried)
    torque = np.array([c.data for c in arm.commands[count:]])
    # on the way there, no jump: a ramp
    steps = np.abs(np.diff(torque, axis=0)).max()
    assert steps < 0.5 * np.abs(torque[0] - gravity).max()
    arm.node.trigger_activate()
    arm.until(lambda: arm.cause == 'following')
    for change in ('deactivate', 'cleanup', 'configure', 'activate'):
        getattr(arm.node, f'trigger_{change}')()
    assert arm.node.state == 'active'
    count = len(arm.effort)
    arm.until(lambda: arm.cause == 'no reference yet' and len(arm.effort) > count)


def test_before_any_joint_state_nothing_is_sent(bench: Any) -> None:
    arm = bench()
    arm.feeding = False
    arm.until(lambda: arm.cause == 'no joint_states yet')
    arm.graph.spin(0.1)
    assert not arm.commands
    assert not arm.effort


def test_model_terms_and_payload_change_live(bench: Any) -> None:
    arm = bench()
    arm.hold(POSTURE)
    weight = arm.inverse(POSTURE)
    arm.until(lambda: arm.effort and np.allclose(arm.effort[-1].effort, weight, atol=1e-9))

    def change(name: str, value: Any) -> None:
        result = arm.node.set_parameters([Parameter(name, value=value)])[0]
        assert result.successful, result.reason

    change('payload.two.mass', 1.0)
    loaded = load_robot(two_links(), gravity=GRAVITY).with_overrides({'payload.two.mass': 1.0})
    q, zero = np.zeros(loaded.n), np.zeros(loaded.n)
    q[loaded.joint_indices] = POSTURE
    expected = loaded.inverse_dynamics(q, zero, zero)[loaded.joint_indices]
    assert np.abs(expected - weight).max() > 1.0
    arm.until(lambda: arm.effort and np.allclose(arm.effort[-1].effort, expected, atol=1e-9))
    change('model', 'quasi_static')
    q = loaded.static_deflection(POSTURE)
    sagging = loaded.inverse_dynamics(q, zero, zero)[loaded.joint_indices]
    assert np.abs(sagging - expected).max() > 1e-4
    arm.until(lambda: arm.effort and np.allclose(arm.effort[-1].effort, sagging, atol=1e-9))
    change('terms.gravity', False)
    arm.until(lambda: arm.effort and np.allclose(arm.effort[-1].effort, 0.0, atol=1e-9))
    bad = arm.node.set_parameters([Parameter('beam.nine.y.ei', value=1.0)])[0]
    assert not bad.successful
    assert 'nine' in bad.reason


def test_the_model_is_read_again_on_request(bench: Any, urdf: str) -> None:
    arm = bench()
    arm.hold(POSTURE)
    Path(urdf).write_text(two_links().replace('mass value="3"', 'mass value="3.0001"'))
    reply = arm.call(Trigger, 'reload_model', Trigger.Request())
    assert reply.success, reply.message
    heavier = arm.inverse(POSTURE) * 3.0001 / 3.0
    arm.until(lambda: arm.effort and np.allclose(arm.effort[-1].effort, heavier, atol=1e-9))
    Path(urdf).write_text('<robot name="x"')
    reply = arm.call(Trigger, 'reload_model', Trigger.Request())
    assert not reply.success
    arm.until(lambda: arm.effort and np.allclose(arm.effort[-1].effort, heavier, atol=1e-9))
