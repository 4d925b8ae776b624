"""A recorder whose files are spoiled, or whose disk is frozen, says so and goes on."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
from frozen_disk import freeze_disk
from std_msgs.msg import Float64, String

from denoc_ros.bags.background import CHECK_PERIOD
from denoc_ros.bags.definitions import encode
from denoc_ros.bags.reader import read_bag, read_raw
from denoc_ros.nodes.recorder import Recorder

pytestmark = pytest.mark.ros

STATUS = 'recorder: recording'


def recording(graph: Any, path: Path, **more: Any) -> Any:
    """Return a recorder of /a, and a publisher of it whose first message is on the disk."""
    node = graph.add(Recorder, output=str(path), topics=['/a', '/text'], **more)
    publisher = graph.publisher(Float64, '/a', depth=1000)
    for index in range(10):
        publisher.publish(Float64(data=float(index)))
    graph.until(lambda: node.writer.status().written == 10)
    return node, publisher


@pytest.mark.parametrize('spoil', ['file', 'folder', 'cut'])
def test_spoiled_file_is_told_within_a_second_and_the_recording_goes_on(
    graph: Any, tmp_path: Path, spoil: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    node, publisher = recording(graph, tmp_path / 'run')
    bag = node.writer._bag
    look, told = bag.check, list[bool]()

    def looked() -> None:
        look()
        told.append(bool(bag.losses))

    monkeypatch.setattr(bag, 'check', looked)
    file = tmp_path / 'run' / 'run_0.mcap'
    told.clear()
    if spoil == 'file':
        file.unlink()
    elif spoil == 'folder':
        shutil.rmtree(file.parent)
    else:
        file.write_bytes(b'')
    graph.until(lambda: True in told)
    assert node.writer.status().losses
    # by the first look at the file: the one before may have been under way
    assert told.index(True) <= 1
    assert 2.0 * CHECK_PERIOD < 1.0
    publisher.publish(Float64(data=77.0))
    graph.until(lambda: graph.value(STATUS, 'files_lost') == '1')
    graph.until(lambda: graph.value(STATUS, 'written') == '1')
    status = graph.diagnostics[STATUS]
    assert status.level == b'\x01'
    assert '10 messages' in status.message
    assert 'are lost' in status.message
    assert graph.value(STATUS, 'lost') == graph.value(STATUS, 'lost by file') == '10'
    path = Path(graph.value(STATUS, 'path'))
    assert (path == tmp_path / 'run') == (spoil != 'folder')
    assert '1 messages on 1 topics, 10 lost (/a 10)' in node.stop()
    assert [item.message.data for item in read_bag(path)] == [77.0]


def test_memory_of_the_queue_is_bounded_by_a_parameter(
    graph: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bound = 500_000
    node, _ = recording(graph, tmp_path / 'run', queue_bytes=bound, flush_period=0.02)
    publisher = graph.publisher(String, '/text', depth=10)
    released = freeze_disk(monkeypatch)
    text = String(data='x' * 50_000)
    try:
        for _ in range(40):
            publisher.publish(text)
            graph.spin(0.01)
            assert node.writer.status().queued_bytes <= bound
        graph.until(lambda: int(graph.value(STATUS, 'lost by queue_bytes') or 0) >= 29)
        assert int(graph.value(STATUS, 'queued_bytes')) <= bound
        assert graph.diagnostics[STATUS].level == b'\x01'
    finally:
        released.set()
    lost = node.writer.status().lost['/text']
    node.end()
    assert len(list(read_raw(tmp_path / 'run', ['/text']))) == 40 - lost


def test_times_before_1970_do_not_end_the_recording(
    graph: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    node, publisher = recording(graph, tmp_path / 'run')
    arrived = 'denoc_ros.nodes.recorder.arrived'
    raw = encode('std_msgs/msg/Float64', 0, {'data': 1.0})
    once = [[(raw, -5, -7, 11)]]
    monkeypatch.setattr(arrived, lambda *_: once.pop() if once else [])
    graph.until(lambda: node.writer.status().written == 11 or node.writer.status().failure)
    assert node.writer.status().failure == ''
    assert publisher.get_subscription_count() == 1
    node.end()
    assert min(item.log_ns for item in read_bag(tmp_path / 'run')) == 0
