"""No request and no message ends a node: each is answered, counted, and the node goes on."""

from __future__ import annotations

from typing import Any

import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState
from node_robots import two_links
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    SetParameters,
    SetParametersAtomically,
)
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String
from std_srvs.srv import Trigger
from type_description_interfaces.srv import GetTypeDescription

from denoc_ros.nodes.base.denoc_node import DenocNode
from denoc_ros.nodes.base.messages import LATCHED
from denoc_ros.nodes.base.robot_node import ModelNode
from denoc_ros.nodes.feedforward import FeedforwardNode
from denoc_ros.runtime.parameters.parameter_table import ParameterTable
from denoc_ros.runtime.parameters.shared_parameters import AUTOSTART, ROBOT
from denoc_ros.settings import Kind
from denoc_ros.settings import Parameter as Row

pytestmark = pytest.mark.ros

TABLE = ParameterTable([AUTOSTART, Row('gain', Kind.DOUBLE, 1.0, '', live=True)])
MODEL_TABLE = ParameterTable([AUTOSTART, *ROBOT])
EVERY_TRANSITION = (0, 2, 3, 4, 5, 6, 7, 10, 60, 99, 255)


class Plain(DenocNode):
    """A node whose callbacks fail where they are asked to."""

    def __init__(self, **options: Any) -> None:
        super().__init__('plain', TABLE, **options)
        self.add_trigger_service('~/fail', self.fail)
        self.create_timer(0.01, self.fail_in_time, clock=self.steady_clock)

    def fail(self) -> str:
        raise ZeroDivisionError('nothing is by zero')

    def fail_in_time(self) -> None:
        raise KeyError('late')


class Described(ModelNode):
    def __init__(self, **options: Any) -> None:
        super().__init__('described', MODEL_TABLE, **options)


def ask(graph: Any, kind: Any, service: str, **fields: Any) -> Any:
    """Return a service's reply."""
    client = graph.probe.create_client(kind, service)
    graph.until(client.service_is_ready)
    future = client.call_async(kind.Request(**fields))
    graph.until(future.done)
    graph.probe.destroy_client(client)
    return future.result()


def value(kind: int, **fields: Any) -> ParameterValue:
    return ParameterValue(type=kind, **fields)


def test_a_transition_that_is_not_possible_is_answered(graph: Any) -> None:
    node = graph.add(Plain)
    for number in EVERY_TRANSITION[:4]:
        if number != Transition.TRANSITION_DEACTIVATE:
            assert not ask(
                graph, ChangeState, '/plain/change_state', transition=Transition(id=number)
            ).success
    wrong = Transition(label='fly')
    assert not ask(graph, ChangeState, '/plain/change_state', transition=wrong).success
    assert ask(graph, GetState, '/plain/get_state').current_state.label == 'active'
    assert ask(graph, GetAvailableTransitions, '/plain/get_transition_graph').available_transitions
    graph.until(lambda: graph.value('plain: callbacks', 'service change_state') is not None)
    assert node.state == 'active'


@pytest.mark.parametrize('numbers', [(5,), (2, 5), (1, 6), (1, 2, 5), (1, 3, 7)])
def test_a_life_ends_from_wherever_it_is(graph: Any, tmp_path: Any, numbers: Any) -> None:
    (tmp_path / 'arm.urdf').write_text(two_links())
    node = graph.add(FeedforwardNode, start=False, urdf_path=str(tmp_path / 'arm.urdf'))
    replies = [
        ask(graph, ChangeState, '/feedforward/change_state', transition=Transition(id=number))
        for number in numbers
    ]
    assert [reply.success for reply in replies] == [
        number != 2 or 1 in numbers for number in numbers
    ]
    assert node.state == 'finalized'
    assert ask(graph, GetState, '/feedforward/get_state').current_state.label == 'finalized'


@pytest.mark.parametrize('kind', [77, 255])
def test_a_parameter_of_no_type_is_refused_alone(graph: Any, kind: int) -> None:
    node = graph.add(Plain)
    parameters = [
        Parameter(name='gain', value=value(kind)),
        Parameter(name='gain', value=value(ParameterType.PARAMETER_DOUBLE, double_value=2.0)),
    ]
    results = ask(graph, SetParameters, '/plain/set_parameters', parameters=parameters).results
    assert [result.successful for result in results] == [False, True]
    assert 'not a valid' in results[0].reason
    reply = ask(
        graph, SetParametersAtomically, '/plain/set_parameters_atomically', parameters=parameters
    )
    assert not reply.result.successful
    assert 'not a valid' in reply.result.reason
    assert node.settings.number('gain') == 2.0


def test_unknown_names_are_answered(graph: Any) -> None:
    graph.add(Plain)
    names = ['gain', 'nobody', '']
    types = ask(graph, GetParameterTypes, '/plain/get_parameter_types', names=names).types
    assert list(types) == [ParameterType.PARAMETER_DOUBLE, 0, 0]
    assert ask(graph, GetParameters, '/plain/get_parameters', names=names) is not None
    assert ask(graph, DescribeParameters, '/plain/describe_parameters', names=names) is not None
    reply = ask(graph, GetTypeDescription, '/plain/get_type_description', type_name='no/such/Type')
    assert not reply.successful


def test_a_service_that_fails_says_so(graph: Any) -> None:
    graph.add(Plain)
    reply = ask(graph, Trigger, '/plain/fail')
    assert not reply.success
    assert 'ZeroDivisionError: nothing is by zero' in reply.message


def test_failures_are_counted_on_diagnostics(graph: Any) -> None:
    graph.add(Plain)
    graph.until(lambda: int(graph.value('plain: callbacks', 'timer fail_in_time') or 0) > 50)
    assert "timer fail_in_time failed, got KeyError: 'late'" in (
        graph.diagnostics['plain: callbacks'].message
    )


def test_time_before_all_time_is_refused(graph: Any) -> None:
    graph.add(Plain, use_sim_time=True)
    clock = graph.publisher(Clock, '/clock')
    message = Clock()
    message.clock.sec = -5

    def counted() -> bool:
        clock.publish(message)
        return graph.value('plain: callbacks', 'topic /clock') is not None

    graph.until(counted)
    assert ask(graph, GetState, '/plain/get_state').current_state.label == 'active'


@pytest.mark.parametrize('text', ['', '/dev/stdin', '\x01\ufffd' * 5000, '<urdf/>', '<robot'])
def test_a_description_that_is_none_is_refused(graph: Any, text: str) -> None:
    node = graph.add(Described, start=False)
    publisher = graph.probe.create_publisher(String, 'robot_description', LATCHED)
    publisher.publish(String(data=text))
    graph.until(lambda: graph.value('described: inputs', 'robot_description rejected format'))
    assert not node.ready
    publisher.publish(String(data=two_links()))
    graph.until(lambda: node.ready)
    node.trigger_configure()
    assert node.state == 'inactive'
