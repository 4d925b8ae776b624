"""The viewer node on real DDS, its page to a client that does not draw."""

from __future__ import annotations

import time
from itertools import cycle
from typing import Any

import numpy as np
import pytest
from node_robots import GRAVITY
from sensor_msgs.msg import JointState

from denoc_ros.dynamics.robot import load_robot
from denoc_ros.viewer.viewer import ViewerNode

pytestmark = pytest.mark.ros


@pytest.fixture
def viewer(graph: Any, urdf: str) -> Any:
    def make(**parameters: Any) -> Any:
        given = {'urdf_path': urdf, 'gravity': GRAVITY, 'port': 0, **parameters}
        node = graph.add(ViewerNode, parameters=given)
        node.shown = []
        node.page.show = node.shown.append
        return node

    return make


def stamped(names: Any, position: Any, effort: Any = ()) -> JointState:
    message = JointState(name=list(names), position=list(position), effort=list(effort))
    seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
    message.header.stamp.sec, message.header.stamp.nanosec = seconds, nanoseconds
    return message


def test_it_listens_and_draws_only_while_somebody_watches(
    graph: Any, viewer: Any, watch: Any, urdf: str
) -> None:
    node = viewer()
    states = graph.probe.create_publisher(JointState, 'joint_states', 10)
    graph.spin(0.5)
    assert states.get_subscription_count() == 0
    leave = watch(node.page.address)
    graph.until(lambda: states.get_subscription_count() > 0)

    def drawn() -> bool:
        states.publish(stamped(['j2', 'j1'], [0.2, 0.1], [4.0, 3.0]))
        return len(node.shown) > 5

    graph.until(drawn)
    robot = load_robot(urdf)
    wanted = np.zeros(robot.n)
    wanted[robot.joint_indices] = 0.1, 0.2
    np.testing.assert_array_equal(node.shown[-1].q, wanted)
    assert node.shown[-1].torque == {'j1': 3.0, 'j2': 4.0}
    graph.until(lambda: graph.value('viewer: page', 'clients') == '1')
    assert graph.value('viewer: page', 'address') == node.page.address
    leave()
    graph.until(lambda: states.get_subscription_count() == 0)
    count = len(node.shown)
    graph.spin(0.3)
    assert len(node.shown) == count


def test_joint_states_are_left_where_more_is_said_and_taken_when_it_ends(
    graph: Any, viewer: Any, watch: Any, urdf: str
) -> None:
    names = load_robot(urdf).coordinate_names
    node = viewer(timeout=0.3)
    watch(node.page.address)
    joints = graph.publisher(JointState, 'joint_states')
    efforts, modal = (
        graph.publisher(JointState, topic)
        for topic in ('feedforward/effort', 'predictor/modal_state')
    )

    def left() -> bool:
        joints.publish(stamped(['j1', 'j2'], [0.5, 0.5]))
        efforts.publish(stamped(['j1', 'j2'], [0.0, 0.0], [1.0, 2.0]))
        modal.publish(stamped(names, [0.1] * len(names)))
        return bool(joints.get_subscription_count() == 0)

    graph.until(left)
    assert node.shown[-1].q.tolist() == [0.1] * len(names)

    def back() -> bool:
        joints.publish(stamped(['j1', 'j2'], [0.5, 0.5]))
        return 0.5 in node.shown[-1].q

    graph.until(back)


def test_garbage_and_second_publishers_are_counted_and_not_drawn(
    graph: Any, viewer: Any, watch: Any
) -> None:
    node = viewer()
    watch(node.page.address)
    states = graph.publisher(JointState, 'joint_states')

    def refused(cause: str, message: JointState) -> bool:
        states.publish(message)
        return graph.value('viewer: inputs', f'/joint_states rejected {cause}') is not None

    graph.until(lambda: refused('non_finite', stamped(['j1', 'j2'], [float('nan'), 0.0])))
    graph.until(lambda: refused('unknown_joint', stamped(['six'], [0.0])))
    assert node.shown == []
    second = graph.publisher(JointState, 'joint_states')
    publishers = cycle((states, second))

    def both_refused() -> bool:
        next(publishers).publish(stamped(['j1', 'j2'], [0.1, 0.2]))
        graph.spin(0.02)
        return graph.value('viewer: inputs', '/joint_states rejected second_publisher') is not None

    graph.until(both_refused)
    graph.probe.destroy_publisher(second)

    def drawn() -> bool:
        states.publish(stamped(['j1', 'j2'], [0.1, 0.2]))
        return bool(node.shown)

    graph.until(drawn)


def test_it_draws_at_its_rate_however_fast_the_topic_is(
    graph: Any, viewer: Any, watch: Any
) -> None:
    node = viewer(rate=10.0)
    watch(node.page.address)
    states = graph.publisher(JointState, 'joint_states')

    def drawn() -> bool:
        states.publish(stamped(['j1', 'j2'], [0.1, 0.2]))
        return len(node.shown) > 15

    graph.until(drawn)
    times = np.array([moment.t for moment in node.shown])
    # rounds keep their times: a late one is followed by one that is early as much
    assert np.median(np.diff(times)) == pytest.approx(0.1, abs=0.03)
    assert len(times) <= 10.0 * (times[-1] - times[0]) + 2


def test_beyond_loopback_it_warns(graph: Any, viewer: Any) -> None:
    viewer(host='0.0.0.0')
    graph.until(lambda: 'viewer: page' in graph.diagnostics)
    status = graph.diagnostics['viewer: page']
    assert status.level == b'\x01'
    assert 'beyond this machine (0.0.0.0)' in status.message


def test_what_cannot_be_served_fails_the_configuration(graph: Any, urdf: str) -> None:
    taken = graph.add(ViewerNode, parameters={'urdf_path': urdf, 'port': 0})
    port = int(taken.page.address.rpartition(':')[2])
    for given, says in (
        ({'port': port}, str(port)),
        ({'host': 'no.such.host.invalid'}, 'no.such.host.invalid'),
        ({'state_topics': []}, "'state_topics' must name"),
    ):
        node = graph.add(
            ViewerNode, start=False, parameters={'urdf_path': urdf, 'port': 0, **given}
        )
        node.trigger_configure()
        assert node.state == 'unconfigured'
        assert says in node.failure


def test_it_can_be_configured_again(graph: Any, viewer: Any, watch: Any) -> None:
    node = viewer()
    node.trigger_deactivate()
    node.trigger_cleanup()
    gone = node.page
    assert gone is None
    node.trigger_configure()
    node.trigger_activate()
    assert node.state == 'active', node.failure
    shown: list[Any] = []
    node.page.show = shown.append
    watch(node.page.address)
    states = graph.publisher(JointState, 'joint_states')

    def drawn() -> bool:
        states.publish(stamped(['j1', 'j2'], [0.1, 0.2]))
        return bool(shown)

    graph.until(drawn)
