"""Who talks, by the numbers of messages; and what nodes take of whom."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from denoc_ros.nodes.base.denoc_node import DenocNode
from denoc_ros.nodes.base.robot_node import RobotNode
from denoc_ros.nodes.recorder import Recorder
from denoc_ros.runtime.inputs.input_monitor import LOST, SILENCE, ActivePublishers, Gaps
from denoc_ros.runtime.inputs.message_readers import JointStateReader
from denoc_ros.runtime.parameters.parameter_table import ParameterTable
from denoc_ros.runtime.parameters.shared_parameters import (
    AUTOSTART,
    INPUTS,
    LOOP,
    ROBOT,
)

pytestmark = pytest.mark.ros

LEASE = 20.0  # s until the middleware takes a publisher for dead

TALK = """
import rclpy, sys, time
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

rclpy.init()
publisher = Node('crashing').create_publisher(JointState, 'joint_states', 10)
while True:
    publisher.publish(JointState(name=['a'], position=[0.0]))
    time.sleep(0.01)
"""


def test_one_that_goes_on_is_one_although_messages_are_lost() -> None:
    publishers, now = ActivePublishers(1), 10.0
    for number in (7, 8, 9, 9 + LOST, 300):
        assert publishers.count(1, [number], now) == [1]
    for number in (301, 302, 302 + LOST):
        assert publishers.count(2, [number], now) == [1]


def test_two_that_talk_in_turns_are_two_however_their_numbers_stand() -> None:
    for other in (1, 999, 1000, 1001, 1050, 10**6):
        publishers = ActivePublishers(1)
        publishers.count(1, [1000], 10.0)
        found = []
        for k in range(1, 5):
            now = 10.0 + 0.01 * k
            found += publishers.count(2, [other + k], now) + publishers.count(2, [1000 + k], now)
        assert found[1:] == [2] * 7


def test_messages_of_one_batch_are_told_apart_before_one_is_taken() -> None:
    assert ActivePublishers(1).count(2, [5, 1], 10.0) == [2, 2]


def test_one_that_has_fallen_silent_does_not_count_after_a_while() -> None:
    publishers = ActivePublishers(1)
    publishers.count(1, [5000], 10.0)
    assert publishers.count(2, [1], 10.0 + 0.9 * SILENCE) == [2]
    assert publishers.count(2, [2], 10.0 + 1.1 * SILENCE) == [1]


def test_as_many_as_may_talk_are_not_too_many() -> None:
    publishers = ActivePublishers(2)
    found = [publishers.count(3, [first + k], 10.0) for k in range(3) for first in (1, 1000)]
    assert max(found) == [2]
    assert publishers.count(3, [9000], 10.0) == [3]


def test_without_numbers_all_count_as_talking() -> None:
    assert ActivePublishers(1).count(2, [None], 10.0) == [2]


def test_of_those_before_nothing_is_known_at_the_beginning() -> None:
    publishers = ActivePublishers(1)
    publishers.begin(10.0)
    assert publishers.count(2, [1], 10.1) == [2]
    assert publishers.count(2, [2], 10.1 + SILENCE) == [1]


ARM, FINGER = frozenset({'shoulder', 'elbow'}), frozenset({'finger'})


def test_those_of_other_joints_do_not_count_against_each_other() -> None:
    publishers = ActivePublishers(1)
    publishers.count(1, [1000], 10.0)
    found = []
    for k in range(1, 20):
        now = 10.0 + 0.01 * k
        found.append(publishers.count(2, [1000 + k], now, [ARM]))
        found.append(publishers.count(2, [k], now, [FINGER]))
    # whose the messages of one publisher alone were is not known before the next one
    assert found[1:] == [[1]] * 37


def test_two_of_the_same_joint_are_two_whatever_else_they_name() -> None:
    publishers = ActivePublishers(1)
    for k in range(1, 5):
        found = publishers.count(
            3, [k, 1000 + k, 5000 + k], 10.0, [ARM, FINGER, frozenset({'finger', 'thumb'})]
        )
    assert found == [1, 2, 2]


TABLE = ParameterTable([AUTOSTART, *ROBOT, *LOOP, *INPUTS])


class ByExecutor(DenocNode):
    """Takes joint states as the executor brings them."""

    def __init__(self, **options: Any) -> None:
        super().__init__('by_executor', TABLE, **options)
        self.reader = JointStateReader(['a'])
        self.monitor = self.listen(JointState, 'joint_states', self.on_state)

    def on_state(self, raw: bytes, now: float) -> None:
        self.reader.read(raw, lambda stamp_ns: self.monitor.accept(stamp_ns, now))


class ByLoop(RobotNode):
    """Takes joint states as a loop does."""

    def __init__(self, **options: Any) -> None:
        super().__init__('by_loop', TABLE, **options)
        self.reader = JointStateReader(['a'])
        self.monitor = self.listen_in_loop(JointState, 'joint_states', self.on_state)

    on_state = ByExecutor.on_state


@pytest.fixture(params=[ByExecutor, ByLoop])
def node(request: Any, graph: Any) -> Any:
    return graph.add(request.param, start=False)


def state(stamp_ns: int) -> JointState:
    message = JointState(name=['a'], position=[1.0])
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    return message


def test_a_publisher_that_is_silent_is_no_second_one(graph: Any, node: Any) -> None:
    silent = graph.publisher(JointState, 'joint_states')
    speaker = graph.publisher(JointState, 'joint_states')

    def said(publisher: Any) -> None:
        publisher.publish(state(time.time_ns()))
        graph.spin(0.01)

    def taken(publisher: Any, count: int) -> bool:
        said(publisher)
        return bool(node.monitor.accepted >= count)

    graph.until(lambda: taken(speaker, 20))

    def refused() -> bool:
        said(silent)
        said(speaker)
        return bool(node.monitor.rejected['second_publisher'] > 10)

    graph.until(refused)
    # both go on: neither is taken, however long
    before, end = node.monitor.accepted, time.perf_counter() + 1.2 * SILENCE
    while time.perf_counter() < end:
        refused()
    assert node.monitor.accepted == before
    graph.until(lambda: taken(silent, before + 5))


def test_a_publisher_of_other_joints_is_no_second_one(graph: Any, node: Any) -> None:
    arm = graph.publisher(JointState, 'joint_states')
    gripper = graph.publisher(JointState, 'joint_states')

    def both(count: int) -> bool:
        arm.publish(state(time.time_ns()))
        graph.spin(0.01)
        gripper.publish(JointState(name=['b'], position=[1.0]))
        graph.spin(0.01)
        return bool(node.monitor.accepted >= count)

    graph.until(lambda: both(5))
    before, refused = node.monitor.accepted, node.monitor.rejected['second_publisher']
    graph.until(lambda: both(before + 50))
    assert node.monitor.rejected['second_publisher'] == refused
    # one that has a joint of the arm is one
    other = graph.publisher(JointState, 'joint_states')

    def doubled() -> bool:
        message = state(time.time_ns())
        message.name, message.position = ['a', 'c'], [1.0, 1.0]
        other.publish(message)
        graph.spin(0.01)
        both(0)
        return bool(node.monitor.rejected['second_publisher'] > refused + 10)

    graph.until(doubled)


@pytest.fixture
def crashing() -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen([sys.executable, '-c', TALK])
    yield process
    process.kill()
    process.wait()


def test_a_publisher_is_taken_when_the_one_before_was_killed(
    graph: Any, crashing: subprocess.Popen[bytes]
) -> None:
    node = graph.add(ByLoop, start=False)
    graph.until(lambda: node.monitor.accepted > 10)
    crashing.send_signal(signal.SIGKILL)
    crashing.wait()
    begin = time.perf_counter()
    publisher = graph.publisher(JointState, 'joint_states')
    before = node.monitor.accepted

    def taken() -> bool:
        publisher.publish(state(0))
        graph.spin(0.01)
        return bool(node.monitor.accepted > before + 5)

    graph.until(taken)
    assert node.count_publishers('joint_states') == 2  # the graph still has the dead one
    assert time.perf_counter() - begin < SILENCE + 0.5 * LEASE


# ---- what did not come


def missed(numbers: list[int | None], publishers: int = 1) -> list[int]:
    gaps = Gaps()
    return [gaps.missed(number, publishers) for number in numbers]


@pytest.mark.parametrize(
    ('numbers', 'expected'),
    [
        ([1, 2, 3], [0, 0, 0]),
        ([500, 501, 505], [0, 0, 3]),  # a late subscription misses nothing of before
        ([7, None, 8], [0, 0, 0]),
        ([101, 104, 105, 107], [0, 2, 0, 1]),
        ([9, 1, 2, 3], [0, 0, 0, 0]),  # a publisher that starts anew
        ([4, 1 << 40], [0, 0]),  # so much is never lost
    ],
)
def test_gaps_in_the_numbers_are_messages_that_did_not_come(
    numbers: list[int | None], expected: list[int]
) -> None:
    assert missed(numbers) == expected


@pytest.mark.parametrize('numbers', [[100, 1, 101, 2, 104, 3], [5, 8, 6, 9, 7, 10]])
def test_of_several_publishers_nobody_knows_whose_a_jump_is(numbers: list[int | None]) -> None:
    """The second are two nodes' diagnostics, one of which was found at its eighth message."""
    assert not any(missed(numbers, publishers=2))


def test_gaps_are_counted_anew_when_one_publisher_is_left() -> None:
    gaps = Gaps()
    told = [(1, 1), (4, 1), (9, 2), (6, 2), (12, 1), (14, 1)]
    assert [gaps.missed(*each) for each in told] == [0, 2, 0, 0, 0, 1]


def test_publishers_and_subscriptions_have_no_events(graph: Any, tmp_path: Path) -> None:
    """Taking one may stop the executor for good (see `WithoutEvents`)."""
    node = graph.add(Recorder, output=str(tmp_path / 'run'), topics=['/a'])
    publisher = graph.publisher(Float64, '/a')
    graph.until(lambda: node.get_publishers_info_by_topic('/a') and len(node._topics) == 1)
    publisher.publish(Float64())
    entities = [*node.publishers, *node.subscriptions]
    entities += [recorded.subscription for recorded in node._topics.values()]
    assert len(entities) >= 4
    assert not [entity for entity in entities if entity.event_handlers]
