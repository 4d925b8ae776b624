"""The recorder keeps what is published, as it is published."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import rclpy
from frozen_disk import freeze_disk
from mcap.reader import make_reader
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import Reader
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger

from denoc_ros.bags.reader import bag_topics, read_attachment, read_bag
from denoc_ros.errors import ConfigError
from denoc_ros.nodes.recorder import Recorder

pytestmark = pytest.mark.ros

RELIABLE = QoSProfile(depth=1000)
BEST_EFFORT = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def joint_state(index: int) -> JointState:
    message = JointState(name=['a', 'b'], position=[float(index), 0.5], effort=[1.0, 2.0])
    message.header.stamp.nanosec = index
    return message


def written(node: Any) -> int:
    return 0 if node.writer is None else int(node.writer.status().written)


def call(graph: Any, name: str) -> Any:
    client = graph.probe.create_client(Trigger, f'/recorder/{name}')
    graph.until(client.service_is_ready)
    future = client.call_async(Trigger.Request())
    graph.until(future.done)
    return future.result()


def test_bytes_are_kept_as_published(graph: Any, tmp_path: Path) -> None:
    node = graph.add(Recorder, output=str(tmp_path / 'run'), topics=['joint_states'])
    publisher = graph.probe.create_publisher(JointState, 'joint_states', RELIABLE)
    graph.until(lambda: publisher.get_subscription_count() == 1)
    sent = [serialize_message(joint_state(index)) for index in range(500)]
    for raw in sent:
        publisher.publish(raw)
    graph.until(lambda: written(node) == 500)
    node.end()
    with Reader(tmp_path / 'run') as reader:
        kept = [bytes(raw) for _, _, raw in reader.messages()]
    assert kept == sent
    stamps = [item.log_ns for item in read_bag(tmp_path / 'run')]
    assert stamps == sorted(stamps)
    assert stamps[0] > 1_600_000_000 * 10**9


def test_a_recording_that_was_begun_by_request_is_whole_at_the_end(
    graph: Any, tmp_path: Path
) -> None:
    node = graph.add(Recorder, output=str(tmp_path / 'run'), topics=['joint_states'])
    node.trigger_deactivate()
    assert node.state == 'inactive'
    assert call(graph, 'start').success
    path = node.writer.path
    node.end()
    with Reader(path) as reader:
        assert reader.message_count == 0


def test_threads_get_their_priority_once_per_recording(
    graph: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[int] = []

    def prioritized(priority: int) -> dict[str, str]:
        given.append(priority)
        return {}

    monkeypatch.setattr(Recorder, 'prioritized', staticmethod(prioritized))
    node = graph.add(Recorder, output=str(tmp_path / 'run'), start=False)
    node.trigger_configure()
    node.owns_process = True
    node.trigger_activate()
    assert given == [node.settings.integer('thread_priority')]
    node.stop()
    node.start()  # another thread writes now
    assert len(given) == 2


def test_every_offered_qos_is_matched_and_written_down(graph: Any, tmp_path: Path) -> None:
    fast = graph.probe.create_publisher(JointState, '/fast', BEST_EFFORT)
    latched = graph.probe.create_publisher(String, '/latched', LATCHED)
    latched.publish(String(data='before the recorder'))
    mixed = [
        graph.probe.create_publisher(Float64, '/mixed', qos) for qos in (RELIABLE, BEST_EFFORT)
    ]
    topics = ['/fast', '/latched', '/mixed']
    node = graph.add(Recorder, output=str(tmp_path / 'run'), topics=topics)
    graph.until(lambda: all(each.get_subscription_count() for each in (fast, *mixed)))
    fast.publish(joint_state(1))
    for each in mixed:
        each.publish(Float64(data=2.0))
    counts = {'/fast': 1, '/latched': 1, '/mixed': 2}
    graph.until(lambda: written(node) == 4)
    node.end()
    with Reader(tmp_path / 'run') as reader:
        found = {each.topic: each for each in reader.connections}
        assert {topic: found[topic].msgcount for topic in counts} == counts
        offers = {
            topic: [
                (each.reliability.name, each.durability.name)
                for each in found[topic].ext.offered_qos_profiles
            ]
            for topic in counts
        }
    assert offers['/fast'] == [('BEST_EFFORT', 'VOLATILE')]
    assert offers['/latched'] == [('RELIABLE', 'TRANSIENT_LOCAL')]
    assert sorted(offers['/mixed']) == [('BEST_EFFORT', 'VOLATILE'), ('RELIABLE', 'VOLATILE')]


def test_publisher_with_a_weaker_offer_is_recorded_too(graph: Any, tmp_path: Path) -> None:
    node = graph.add(Recorder, output=str(tmp_path / 'run'), topics=['/a'])
    graph.publisher(Float64, '/a').publish(Float64(data=1.0))
    graph.until(lambda: written(node) == 1)
    weaker = graph.probe.create_publisher(Float64, '/a', BEST_EFFORT)
    graph.until(lambda: weaker.get_subscription_count() == 1)
    weaker.publish(Float64(data=2.0))
    graph.until(lambda: written(node) == 2)
    node.end()
    assert [item.message.data for item in read_bag(tmp_path / 'run')] == [1.0, 2.0]


@pytest.fixture
def others() -> Iterator[Callable[..., Any]]:
    """Make publishers in a process of their own, as far as the middleware is concerned."""
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    node = rclpy.create_node('others', context=context, use_global_arguments=False)
    made: list[Any] = []

    def publisher(graph: Any, kind: type, listened: bool = True) -> Any:
        for each in made:
            node.destroy_publisher(each)
        made[:] = [node.create_publisher(kind, '/a', RELIABLE)]
        graph.until(lambda: made[0].get_subscription_count() == listened)
        return made[0]

    yield publisher
    node.destroy_node()
    rclpy.shutdown(context=context)


def test_a_topic_whose_type_changes_is_recorded_on_and_told(
    graph: Any, tmp_path: Path, others: Callable[..., Any]
) -> None:
    node = graph.add(Recorder, output=str(tmp_path / 'run'), topics=['/a'])
    sent = [Float64(data=1.0), String(data='two'), String(data='three'), Float64(data=4.0)]
    for count, message in enumerate(sent, 1):
        if count != 3:
            publisher = others(graph, type(message))
        publisher.publish(message)
        graph.until(lambda count=count: written(node) == count)
    graph.until(lambda: graph.value('recorder: recording', 'types_changed') == '2')
    assert node.stop() == f'{tmp_path / "run"}: 4 messages on 1 topics, 0 lost'
    kept = [(item.type.split('/')[-1], item.message.data) for item in read_bag(tmp_path / 'run')]
    assert kept == [('Float64', 1.0), ('String', 'two'), ('String', 'three'), ('Float64', 4.0)]


def test_messages_of_a_second_type_are_counted_as_soon_as_they_can_be(
    graph: Any, tmp_path: Path, others: Callable[..., Any]
) -> None:
    first = graph.probe.create_publisher(Float64, '/a', RELIABLE)
    node = graph.add(Recorder, output=str(tmp_path / 'run'), topics=['/a'])
    graph.until(lambda: first.get_subscription_count() == 1)
    second = others(graph, String, listened=False)
    for _ in range(5):
        second.publish(String(data='not recorded'))
    told: list[str] = []

    def is_told() -> bool:
        status = graph.diagnostics.get('recorder: recording')
        told.append(status.message if status and status.level == b'\x01' else '')
        return 'one type at a time, std_msgs/msg/Float64, got also std_msgs/msg/String' in told[-1]

    graph.until(is_told)
    first.publish(Float64(data=1.0))
    graph.until(lambda: written(node) == 1)
    graph.probe.destroy_publisher(first)
    graph.until(lambda: second.get_subscription_count() == 1)
    second.publish(String(data='recorded'))
    graph.until(lambda: written(node) == 2)
    graph.until(lambda: graph.value('recorder: recording', 'lost /a') == '5')
    node.end()
    assert [item.message.data for item in read_bag(tmp_path / 'run')] == [1.0, 'recorded']


def test_names_and_patterns_choose_topics(graph: Any, tmp_path: Path) -> None:
    node = graph.add(Recorder, output=str(tmp_path / 'run'), topics=['/arm/*', 'clock_like'])
    for topic in ('/arm/effort', '/arm/deep/down', '/clock_like'):
        graph.publisher(Float64, topic)
    graph.probe.create_publisher(Float64, '/other', 1)
    graph.spin(0.2)
    node.end()
    assert set(bag_topics(tmp_path / 'run')) == {'/arm/effort', '/arm/deep/down', '/clock_like'}


def test_without_names_all_but_hidden_topics_are_recorded(graph: Any, tmp_path: Path) -> None:
    graph.probe.create_publisher(Float64, '/_hidden/a', 1)
    node = graph.add(Recorder, output=str(tmp_path / 'run'))
    graph.publisher(Float64, '/seen')
    node.end()
    topics = set(bag_topics(tmp_path / 'run'))
    assert {'/seen', '/diagnostics', '/rosout'} <= topics
    assert '/_hidden/a' not in topics


def test_robot_description_is_attached(graph: Any, tmp_path: Path) -> None:
    publisher = graph.probe.create_publisher(String, 'robot_description', LATCHED)
    publisher.publish(String(data='<robot name="arm"/>'))
    node = graph.add(Recorder, output=str(tmp_path / 'run'))
    graph.until(lambda: node.description)
    node.end()
    attached = read_attachment(tmp_path / 'run', 'robot_description.urdf')
    assert attached == b'<robot name="arm"/>'


def test_robot_file_is_attached(graph: Any, tmp_path: Path) -> None:
    (tmp_path / 'arm.urdf').write_text('<robot name="file"/>')
    urdf = str(tmp_path / 'arm.urdf')
    graph.add(Recorder, output=str(tmp_path / 'run'), urdf_path=urdf).end()
    attached = read_attachment(tmp_path / 'run', 'robot_description.urdf')
    assert attached == b'<robot name="file"/>'


def test_services_stop_start_split_and_mark(graph: Any, tmp_path: Path) -> None:
    node = graph.add(Recorder, output=str(tmp_path / 'run'), topics=['/a'])
    publisher = graph.publisher(Float64, '/a')
    publisher.publish(Float64(data=1.0))
    graph.until(lambda: written(node) == 1)
    assert call(graph, 'mark').message == 'mark 1'
    assert call(graph, 'split').success
    graph.until(lambda: len(list((tmp_path / 'run').glob('*.mcap'))) == 2)
    refused = call(graph, 'start')
    assert not refused.success
    assert 'must be stopped before' in refused.message
    stopped = call(graph, 'stop')
    assert stopped.message == f'{tmp_path / "run"}: 2 messages on 1 topics, 0 lost'
    assert not call(graph, 'mark').success
    assert call(graph, 'start').message == f'recording to {tmp_path / "run_2"}'
    graph.until(lambda: publisher.get_subscription_count() == 1)
    publisher.publish(Float64(data=2.0))
    graph.until(lambda: written(node) == 1)
    node.end()
    first, mark = read_bag(tmp_path / 'run')
    assert (first.message.data, mark.topic, mark.message.data) == (
        1.0,
        '/recorder/marks',
        'mark 1',
    )
    assert [item.message.data for item in read_bag(tmp_path / 'run_2')] == [2.0]


def test_what_has_arrived_at_the_stop_is_kept(graph: Any, tmp_path: Path) -> None:
    node = graph.add(Recorder, output=str(tmp_path / 'run'), topics=['/a'])
    publisher = graph.publisher(Float64, '/a', depth=1000)
    for index in range(100):
        publisher.publish(Float64(data=float(index)))
    assert publisher.wait_for_all_acked()
    node.end()
    values = [item.message.data for item in read_bag(tmp_path / 'run')]
    assert values == [float(index) for index in range(100)]


def test_existing_output_fails_the_start(graph: Any, tmp_path: Path) -> None:
    node = graph.add(Recorder, start=False, output=str(tmp_path))
    node.trigger_configure()
    node.trigger_activate()
    assert node.state == 'inactive'
    assert 'must not exist yet' in node.failure


def test_bad_parameters_are_named(graph: Any, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"'compression' must be one of none, lz4, zstd"):
        graph.add(Recorder, output=str(tmp_path / 'run'), compression='gzip')
    with pytest.raises(ConfigError, match=r"'flush_period' must be > 0"):
        graph.add(Recorder, output=str(tmp_path / 'run'), flush_period=0.0)


def test_losses_behind_a_stalled_disk_are_reported(
    graph: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = graph.add(
        Recorder, output=str(tmp_path / 'run'), topics=['/a'], queue_size=10, flush_period=0.02
    )
    publisher = graph.publisher(Float64, '/a', depth=1000)
    publisher.publish(Float64(data=1.0))
    graph.until(lambda: written(node) == 1)
    released = freeze_disk(monkeypatch)
    publisher.publish(Float64(data=2.0))
    graph.until(lambda: node.writer.status().stalled > 0.2)
    for _ in range(50):
        publisher.publish(Float64(data=3.0))
    name = 'recorder: recording'
    # the writing thread may have stalled before it took the second message, or with it in hand
    graph.until(lambda: graph.value(name, 'lost /a') in ('40', '41'))
    assert graph.diagnostics[name].level == b'\x01'
    assert 'disk stalled' in graph.diagnostics[name].message
    released.set()
    stopped = call(graph, 'stop')
    lost = int(graph.value(name, 'lost /a') or 0)
    kept = f'{52 - lost} messages on 1 topics, {lost} lost (/a {lost})'
    assert stopped.message.endswith(kept)
    # an end without loss is another severity of the log, an end with one no failure
    assert stopped.success
    assert call(graph, 'start').success
    assert call(graph, 'stop').message.endswith('0 lost')


def test_short_disk_ends_the_recording_but_not_the_node(graph: Any, tmp_path: Path) -> None:
    run = tmp_path / 'run'
    node = graph.add(Recorder, output=str(run), topics=['/a'], min_free_space=1 << 60)
    name = 'recorder: recording'
    graph.until(lambda: name in graph.diagnostics and graph.diagnostics[name].level == b'\x02')
    assert 'disk must keep' in graph.diagnostics[name].message
    assert node.state == 'active'
    assert list(read_bag(run)) == []


def test_type_that_is_not_installed_is_left_out(
    graph: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        'denoc_ros.bags.definitions._definition_file', lambda _: tmp_path / 'x.msg'
    )
    offer = SimpleNamespace(topic_type='nobody_msgs/msg/Nothing', qos_profile=RELIABLE)
    monkeypatch.setattr(Recorder, 'get_publishers_info_by_topic', lambda *_: [offer])
    node = graph.add(Recorder, output=str(tmp_path / 'run'), topics=['/rosout'])
    graph.until(lambda: graph.value('recorder: recording', 'types_refused') == '1')
    assert node._topics == {}


def test_a_message_is_known_by_when_it_left_and_when_it_came(graph: Any, tmp_path: Path) -> None:
    graph.add(Recorder, output=str(tmp_path / 'run'), topics=['/a', '/b'])
    publishers = [graph.publisher(Float64, topic) for topic in ('/a', '/b')]
    sent = []
    for index in range(20):
        before = time.time_ns()
        publishers[index % 2].publish(Float64(data=float(index)))
        sent.append((before, time.time_ns()))
        graph.spin(0.01)
    call(graph, 'stop')
    with next((tmp_path / 'run').glob('*.mcap')).open('rb') as file:
        kept = [message for _, _, message in make_reader(file).iter_messages()]
    assert len(kept) == 20
    for (before, after), message in zip(sent, kept, strict=True):
        assert before <= message.publish_time <= after
        assert message.publish_time <= message.log_time < after + 10**9
