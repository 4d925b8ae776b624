"""What a loop takes itself of its measurements, and when it says they came."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
from sensor_msgs.msg import JointState

from denoc_ros.nodes.base.inputs import HELD, arrivals
from denoc_ros.nodes.base.robot_node import WITHIN_A_TICK, RobotNode
from denoc_ros.runtime.inputs.message_readers import LONGEST, JointStateReader
from denoc_ros.runtime.parameters.parameter_table import ParameterTable
from denoc_ros.runtime.parameters.shared_parameters import (
    AUTOSTART,
    INPUTS,
    LOOP,
    ROBOT,
)

pytestmark = pytest.mark.ros

HEAVY = 200  # bytes
DELIVERY = 0.4  # s that a message may take to this process


TABLE = ParameterTable([AUTOSTART, *ROBOT, *LOOP, *INPUTS])


class Taker(RobotNode):
    """Takes joint states; no loop runs, so a timer does it, or a test."""

    def __init__(self, **options: Any) -> None:
        super().__init__('taker', TABLE, **options)
        self.arrivals: list[float] = []
        self.reader = JointStateReader(['a'])
        self.monitor = self.listen_in_loop(
            JointState, 'joint_states', self._on_state, lambda raw: len(raw) > HEAVY
        )

    def _on_state(self, raw: bytes, now: float) -> None:
        self.reader.read(raw, lambda stamp_ns: self.monitor.accept(stamp_ns, now))
        self.arrivals.append(now)


def state(stamp: int, name: str = 'a') -> JointState:
    message = JointState(name=[name], position=[1.0])
    message.header.stamp.sec = stamp
    return message


@pytest.fixture
def taker(graph: Any) -> Any:
    node = graph.add(Taker, start=False)
    graph.executor.remove_node(node)  # no timer takes anything
    return node


@pytest.fixture
def publisher(graph: Any, taker: Any) -> Any:
    return graph.publisher(JointState, 'joint_states', depth=100)


def test_only_taking_takes(graph: Any, taker: Any, publisher: Any) -> None:
    publisher.publish(state(1))
    graph.spin(0.2)
    assert taker.arrivals == []
    taker._take_inputs()
    assert len(taker.arrivals) == 1


def test_without_a_loop_measurements_are_taken_all_the_same(graph: Any, taker: Any) -> None:
    publisher = graph.publisher(JointState, 'joint_states')
    graph.executor.add_node(taker)
    publisher.publish(state(1))
    graph.until(lambda: len(taker.arrivals) == 1)


def test_arrival_is_when_it_came_not_when_it_was_taken(taker: Any, publisher: Any) -> None:
    taker._take_inputs()
    sent = []
    for stamp in (1, 2, 3):
        sent.append(time.perf_counter())
        publisher.publish(state(stamp))
        time.sleep(1.5 * DELIVERY)
    taker._take_inputs()
    assert len(taker.arrivals) == 3
    for before, arrival in zip(sent, taker.arrivals, strict=True):
        assert before - 1e-3 < arrival < before + DELIVERY


def test_arrivals_while_the_process_stood_still_are_those_of_the_sender() -> None:
    pause, step = 0.1, 0.001
    now, wall = time.perf_counter(), time.time_ns()
    # the sender's clock is another one; all were received when the process went on
    infos = [
        {'received_timestamp': wall, 'source_timestamp': 5_000_000_000 + round(1e9 * step * k)}
        for k in range(100)
    ]
    moments = np.array(arrivals(infos, now - pause))
    np.testing.assert_allclose(np.diff(moments), step, atol=1e-6)
    assert now - pause <= moments[0]
    assert moments[-1] <= time.perf_counter()
    # one after the other: when they were received is known
    together = np.array(arrivals(infos[:5], now))
    assert np.ptp(together) < 1e-6


@pytest.mark.parametrize('jump', [-3600.0, 3600.0])
def test_arrival_bears_a_clock_that_is_set(
    taker: Any, publisher: Any, monkeypatch: pytest.MonkeyPatch, jump: float
) -> None:
    before = time.perf_counter()
    taker._take_inputs()
    publisher.publish(state(1))
    time.sleep(0.1)
    wall = time.time_ns
    monkeypatch.setattr(time, 'time_ns', lambda: wall() + round(1e9 * jump))
    taker._take_inputs()
    # not before the last look, however long that is ago
    assert before < taker.arrivals[0] <= time.perf_counter()


def test_newest_of_a_flood_are_taken_and_bad_ones_counted(
    graph: Any, taker: Any, publisher: Any
) -> None:
    depth = WITHIN_A_TICK
    for stamp in range(1, 3 * depth):
        publisher.publish(state(stamp, 'a' if stamp % 2 else 'b'))
    time.sleep(DELIVERY)
    taker._take_inputs()
    accepted, rejected = taker.monitor.accepted, taker.monitor.rejected
    assert taker.reader.stamp_ns == (3 * depth - 1) * 10**9 or rejected['flood']
    assert accepted + rejected.total() == depth
    # a machine that takes its time to send them spreads them: some are too many at once then
    assert abs(accepted - rejected['unknown_joint']) <= rejected['flood']
    assert set(rejected) <= {'unknown_joint', 'flood'}
    taker._take_inputs()
    assert taker.monitor.accepted == accepted


@pytest.mark.parametrize(('slow', 'handled'), [(1, 6), (6, 3)])
def test_what_the_first_message_takes_makes_no_flood(
    taker: Any, publisher: Any, monkeypatch: pytest.MonkeyPatch, slow: int, handled: int
) -> None:
    handle = taker._on_state

    def slow_at_first(raw: bytes, now: float) -> None:
        handle(raw, now)
        ends = time.thread_time() + (0.01 if len(taker.arrivals) <= slow else 0.0)
        while time.thread_time() < ends:
            pass

    monkeypatch.setattr(taker._inputs[0], '_handle', slow_at_first)
    for stamp in range(1, 7):
        publisher.publish(state(stamp))
    time.sleep(DELIVERY)
    taker._take_inputs()
    assert taker.monitor.accepted == handled  # the first, one beyond the bound, the newest
    assert taker.monitor.rejected['flood'] == 6 - handled
    assert taker.reader.stamp_ns == 6 * 10**9


def heavy(stamp: int) -> JointState:
    message = state(stamp)
    message.header.frame_id = HEAVY * 'x'
    return message


def test_heavy_message_and_what_follows_it_wait_for_another_thread(
    taker: Any, publisher: Any
) -> None:
    for message in (state(1), heavy(2), state(3)):
        publisher.publish(message)
    time.sleep(0.2)
    taker._take_inputs()
    assert taker.reader.stamp_ns == 1 * 10**9
    taker._take_aside()
    assert taker.reader.stamp_ns == 3 * 10**9
    assert taker.monitor.accepted == 3
    publisher.publish(state(4))
    time.sleep(0.2)
    taker._take_inputs()
    assert taker.reader.stamp_ns == 4 * 10**9


def test_flood_of_heavy_messages_is_refused(taker: Any, publisher: Any) -> None:
    for stamp in range(1, HELD + 3):
        publisher.publish(heavy(stamp))
    time.sleep(0.2)
    taker._take_inputs()
    assert taker.monitor.rejected == {'flood': 2}
    taker._take_aside()
    assert taker.monitor.accepted == HELD
    assert taker.reader.stamp_ns == (HELD + 2) * 10**9  # the newest win


def test_heavy_messages_leave_time_for_others(
    taker: Any, publisher: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    handle = taker._on_state

    def slow(raw: bytes, now: float) -> None:
        time.sleep(0.05)
        handle(raw, now)

    monkeypatch.setattr(taker._inputs[0], '_handle', slow)
    for stamp in (1, 2, 3):
        publisher.publish(heavy(stamp))
    time.sleep(0.2)
    taker._take_inputs()
    for _ in range(5):
        taker._take_aside()
    assert taker.monitor.accepted == 1
    time.sleep(0.2)  # three times what it took
    taker._take_aside()
    assert taker.monitor.accepted == 2


def test_messages_too_long_for_a_loop_are_refused_unread(taker: Any, publisher: Any) -> None:
    taker._inputs[0]._is_heavy = lambda _: False
    message = state(1)
    message.header.frame_id = 'x' * LONGEST
    publisher.publish(message)
    time.sleep(0.2)
    taker._take_inputs()
    assert taker.monitor.rejected == {'too_long': 1}


def test_no_message_ends_who_takes_it(
    taker: Any, publisher: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_raw: bytes, _now: float) -> None:
        raise ZeroDivisionError('a number was zero')

    monkeypatch.setattr(taker._inputs[0], '_handle', fail)
    publisher.publish(state(1))
    time.sleep(0.2)
    taker._take_inputs()
    assert taker.monitor.rejected == {'unexpected': 1}
    assert 'ZeroDivisionError' in taker.monitor.last_message


def test_what_a_second_publisher_left_behind_is_refused(
    graph: Any, taker: Any, publisher: Any
) -> None:
    second = graph.probe.create_publisher(JointState, 'joint_states', 10)
    graph.until(lambda: second.get_subscription_count() == 1)
    taker._take_inputs()
    second.publish(state(2))
    time.sleep(0.2)
    graph.probe.destroy_publisher(second)
    graph.until(lambda: taker._inputs[0].subscription.handle.get_publisher_count() == 1)
    publisher.publish(state(3))
    time.sleep(0.2)
    taker._take_inputs()
    assert taker.monitor.accepted == 0
    assert taker.monitor.rejected['second_publisher'] >= 1
    publisher.publish(state(4))
    time.sleep(0.2)
    taker._take_inputs()
    assert taker.monitor.accepted == 1
