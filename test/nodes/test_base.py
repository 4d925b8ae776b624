"""The lifecycle node under every node."""

from __future__ import annotations

from typing import Any

import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.parameter import Parameter as RosParameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from denoc_ros.errors import ConfigError
from denoc_ros.nodes.base.denoc_node import DenocNode
from denoc_ros.runtime.inputs.input_monitor import InputError
from denoc_ros.runtime.inputs.message_readers import JointStateReader
from denoc_ros.runtime.parameters.parameter_table import ParameterTable
from denoc_ros.runtime.parameters.shared_parameters import AUTOSTART
from denoc_ros.settings import Kind, Parameter

pytestmark = pytest.mark.ros

TABLE = ParameterTable(
    [
        AUTOSTART,
        Parameter('gain', Kind.DOUBLE, 1.0, 'a gain', 'N m', 0.0, 10.0, live=True),
        Parameter('names', Kind.STRINGS, [], 'names'),
        Parameter('max_publishers', Kind.INTEGER, 1, 'publishers'),
    ]
)


class Listener(DenocNode):
    def __init__(self, **options: Any) -> None:
        super().__init__('listener', TABLE, **options)
        self.reader = JointStateReader(['a', 'b'])
        self.monitor = self.listen(JointState, 'joint_states', self.on_state)
        self.add_trigger_service('~/fail', self.fail)

    def on_state(self, raw: bytes, now: float) -> None:
        self.reader.read(raw)
        self.monitor.accept(self.reader.stamp_ns, now)

    def fail(self) -> str:
        raise ConfigError('here', ['nothing goes'])


def state(names: list[str], values: list[float], stamp: int = 0) -> JointState:
    message = JointState(name=names, position=values)
    message.header.stamp.sec = stamp
    return message


def test_integer_is_taken_for_a_double(graph: Any) -> None:
    node = graph.add(Listener, gain=5)
    assert node.settings.number('gain') == 5.0


def test_unknown_and_bad_parameters_are_all_named(graph: Any) -> None:
    with pytest.raises(ConfigError, match='gian') as caught:
        graph.add(Listener, gian=5.0, gain=11.0)
    assert "did you mean 'gain'" in str(caught.value)
    assert "parameter 'gain' must be >= 0, <= 10 N m, got 11.0" in str(caught.value)


def test_live_change_is_checked_and_read_only_refused(graph: Any) -> None:
    node = graph.add(Listener)
    good, bad, fixed = (
        node.set_parameters([RosParameter(name, value=value)])[0]
        for name, value in (('gain', 3), ('gain', -1.0), ('names', ['x']))
    )
    assert good.successful
    assert node.settings.number('gain') == 3.0
    assert not bad.successful
    assert 'must be >= 0' in bad.reason
    assert not fixed.successful
    assert 'read-only' in fixed.reason


def test_rejected_inputs_reach_diagnostics_by_cause(graph: Any) -> None:
    node = graph.add(Listener)
    publisher = graph.publisher(JointState, 'joint_states')
    nan = float('nan')
    bad = {
        'non_finite': state(['a', 'b'], [0.0, nan]),
        'wrong_length': state(['a', 'b'], [0.0]),
        'unknown_joint': state(['a', 'b', 'c'], [0.0, 0.0, 0.0]),
        'missing_joint': state(['a'], [0.0]),
        'repeated_joint': state(['a', 'a'], [0.0, 0.0]),
    }
    publisher.publish(state(['b', 'a'], [2.0, 1.0], stamp=5))
    graph.until(lambda: node.monitor.accepted == 1)
    bad['backwards_stamp'] = state(['a', 'b'], [9.0, 9.0], stamp=4)
    for cause, message in bad.items():
        publisher.publish(message)
        graph.until(lambda cause=cause: node.monitor.rejected[cause] == 1)
    key = 'joint_states rejected '
    graph.until(lambda: all(graph.value('listener: inputs', key + cause) == '1' for cause in bad))
    assert graph.diagnostics['listener: inputs'].level == b'\x01'
    assert node.monitor.accepted == 1


def test_second_publisher_silences_both(graph: Any) -> None:
    node = graph.add(Listener)
    both = [graph.publisher(JointState, 'joint_states') for _ in range(2)]
    graph.until(lambda: node.count_publishers('joint_states') == 2)
    for count in range(4):
        both[count % 2].publish(state(['a', 'b'], [1.0, 2.0]))
        graph.until(lambda count=count: sum(node.monitor.rejected.values()) > count)
    assert node.monitor.rejected['second_publisher'] == 4
    assert node.monitor.accepted == 0
    graph.until(
        lambda: (
            graph.value('listener: inputs', 'joint_states rejected second_publisher') is not None
        )
    )


def test_service_that_cannot_says_why(graph: Any) -> None:
    graph.add(Listener)
    client = graph.probe.create_client(Trigger, '/listener/fail')
    graph.until(client.service_is_ready)
    future = client.call_async(Trigger.Request())
    graph.until(future.done)
    assert not future.result().success
    assert 'nothing goes' in future.result().message


def test_a_lifecycle_manager_can_bring_it_up(graph: Any) -> None:
    node = graph.add(Listener, start=False)
    client = graph.probe.create_client(ChangeState, '/listener/change_state')
    graph.until(client.service_is_ready)
    for transition, state in (
        (Transition.TRANSITION_CONFIGURE, 'inactive'),
        (Transition.TRANSITION_ACTIVATE, 'active'),
        (Transition.TRANSITION_DEACTIVATE, 'inactive'),
    ):
        request = ChangeState.Request(transition=Transition(id=transition))
        future = client.call_async(request)
        graph.until(future.done)
        assert future.result().success
        assert node.state == state


def test_truncated_message_is_malformed() -> None:
    with pytest.raises(InputError, match='must not end') as caught:
        JointStateReader(['a']).read(b'\x00\x01\x00\x00\x00\x00\x00\x00')
    assert caught.value.cause == 'malformed'


def test_older_stamps_are_taken_after_simulated_time_was_set_back(graph: Any) -> None:
    node = graph.add(Listener, use_sim_time=True)
    clock = graph.publisher(Clock, '/clock')
    states = graph.publisher(JointState, 'joint_states')

    def at(second: int) -> bool:
        message = Clock()
        message.clock.sec = second
        clock.publish(message)
        states.publish(state(['a', 'b'], [1.0, 2.0], second))
        return bool(node.stamp_ns() == second * 10**9 and node.monitor.accepted)

    graph.until(lambda: at(100))
    node.monitor.accepted = 0
    graph.until(lambda: at(5))
    assert node.monitor.accepted > 0


def test_log_lines_show_control_characters(graph: Any, capfd: pytest.CaptureFixture[str]) -> None:
    log = graph.add(Listener, start=False).get_logger()
    topic = 'topic /a\x1b[31m\u202e'
    log.info(topic)
    log.warning(topic)
    log.error(topic)
    log.fatal(topic)
    for k in range(3):
        log.info(f'/b\x9b{k}', once=True)
    said = capfd.readouterr()
    lines = said.out + said.err
    assert lines.count('\\x1b[31m\\u202e') == 4
    assert '\x1b' not in lines
    assert '\x9b' not in lines
    # A filter belongs to the line that logs, not to the printer.
    assert lines.count('/b\\x9b') == 1
    log.info('other\x1b', once=True)
    assert 'other\\x1b' in ''.join(capfd.readouterr())
