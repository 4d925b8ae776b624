"""The recorder as a process: what is left after it is told to end, or killed."""

from __future__ import annotations

import itertools
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from child_processes import child
from rclpy.duration import Duration
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from denoc_ros.bags.reader import read_bag
from denoc_ros.bags.recover import recover
from denoc_ros.errors import BagError

pytestmark = pytest.mark.ros

FLUSH_PERIOD = 0.2
DELIVERY = 0.1  # s from publishing to the recorder, where no thread waits for a processor
RATE = 1000.0
PATIENCE = 60.0  # s for what takes a second on a machine that does nothing else


class Stream:
    """Publishes numbered joint states from a thread and remembers when.

    Attributes
    ----------
    times : list of float
        [s] of each message.
    """

    def __init__(self, publisher: Any) -> None:
        self.times: list[float] = []
        self._publisher = publisher
        self._running = True
        self._thread = threading.Thread(target=self._publish, daemon=True)
        self._thread.start()

    def _publish(self) -> None:
        message = JointState(name=['a'], position=[0.0])
        start = time.perf_counter()
        while self._running:
            message.header.stamp.sec, message.header.stamp.nanosec = 1, len(self.times)
            self._publisher.publish(message)
            self.times.append(time.perf_counter())
            time.sleep(max(0.0, start + len(self.times) / RATE - time.perf_counter()))

    def wait_for_all(self) -> None:
        """End the thread; wait until all that was published has come to the recorder's process."""
        self.stop()
        assert self._publisher.wait_for_all_acked(Duration(seconds=PATIENCE))

    @property
    def longest_wait(self) -> float:
        """The longest time [s] that this thread waited for a processor, beyond its period."""
        return max(b - a for a, b in itertools.pairwise(self.times)) - 1.0 / RATE

    def stop(self) -> None:
        """End the thread."""
        self._running = False
        self._thread.join(PATIENCE)


@pytest.fixture
def recorder(graph: Any, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, '-m', 'denoc_ros.nodes.recorder', '--ros-args']
    command += ['-p', f'output:={tmp_path / "run"}', '-p', f'flush_period:={FLUSH_PERIOD}']
    command += ['-p', 'topics:=[/joint_states]']
    with child(command, stderr=subprocess.PIPE) as process:
        yield process


def stream_for(graph: Any, duration: float) -> Stream:
    """Return a stream that has run for a while into the recorder."""
    publisher = graph.probe.create_publisher(JointState, '/joint_states', 1000)
    graph.until(lambda: publisher.get_subscription_count() == 1)
    stream = Stream(publisher)
    time.sleep(duration)
    return stream


def test_killed_recorder_loses_at_most_the_flush_period(
    graph: Any, recorder: subprocess.Popen[str], tmp_path: Path
) -> None:
    stream = stream_for(graph, 1.5)
    killed = time.perf_counter()
    recorder.kill()
    recorder.wait(PATIENCE)
    stream.stop()
    with pytest.raises(BagError, match='denoc recover'):
        list(read_bag(tmp_path / 'run'))
    result = recover(tmp_path / 'run')
    numbers = [item.message.header.stamp.nanosec for item in read_bag(result.path)]
    # the recorder has two threads that may wait as long as the one of this test
    latest = killed - FLUSH_PERIOD - DELIVERY - 2.0 * stream.longest_wait
    due = sum(moment < latest for moment in stream.times)
    assert numbers == list(range(len(numbers)))
    assert len(numbers) >= due
    assert len(numbers) > 100


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_told_to_end_it_leaves_a_whole_bag(
    graph: Any, recorder: subprocess.Popen[str], tmp_path: Path, number: signal.Signals
) -> None:
    stream = stream_for(graph, 0.5)
    stream.wait_for_all()
    recorder.send_signal(number)
    _, said = recorder.communicate(timeout=PATIENCE)
    assert recorder.returncode == 0
    numbers = [item.message.header.stamp.nanosec for item in read_bag(tmp_path / 'run')]
    assert numbers == list(range(len(stream.times)))
    assert f'{len(numbers)} messages on 1 topics, 0 lost' in said


def test_existing_output_is_one_message_and_status_1(graph: Any, tmp_path: Path) -> None:
    command = [sys.executable, '-m', 'denoc_ros.nodes.recorder', '--ros-args']
    done = subprocess.run(
        [*command, '-p', f'output:={tmp_path}'], capture_output=True, text=True, timeout=PATIENCE
    )
    assert done.returncode == 1
    assert 'must not exist yet' in done.stderr
    assert 'Traceback' not in done.stderr


HANGING = """
import sys, time
from denoc_ros.nodes.base.process import run
from denoc_ros.nodes.recorder import Recorder

class Hanging(Recorder):
    def mark(self):
        time.sleep(1000.0)

sys.exit(run(Hanging, sys.argv, patience=1.5))
"""


LOCKED = """
import ctypes, sys
from denoc_ros.nodes.base.process import run
from denoc_ros.nodes.recorder import Recorder

class Locked(Recorder):
    def mark(self):
        ctypes.PyDLL(None).sleep(1000)  # with the interpreter's lock

sys.exit(run(Locked, sys.argv, patience=1.0))
"""


def test_an_interpreter_that_is_held_for_good_ends_the_process(graph: Any, tmp_path: Path) -> None:
    command = [sys.executable, '-c', LOCKED, '--ros-args', '-p', f'output:={tmp_path / "run"}']
    with child(command, stderr=subprocess.PIPE) as process:
        client = graph.probe.create_client(Trigger, '/recorder/mark')
        graph.until(client.service_is_ready)
        client.call_async(Trigger.Request())
        assert process.wait(PATIENCE) == 1
        assert process.stderr is not None
        assert 'Timeout' in process.stderr.read()
    assert recover(tmp_path / 'run').damaged_chunks == 0


def test_a_hanging_executor_leaves_a_whole_bag(graph: Any, tmp_path: Path) -> None:
    command = [sys.executable, '-c', HANGING, '--ros-args', '-p', f'output:={tmp_path / "run"}']
    command += ['-p', 'topics:=[/joint_states]']
    with child(command, stderr=subprocess.PIPE) as process:
        stream = stream_for(graph, 1.0)
        client = graph.probe.create_client(Trigger, '/recorder/mark')
        graph.until(client.service_is_ready)
        stream.wait_for_all()
        due = len(stream.times)
        graph.until(lambda: graph.value('recorder: recording', 'written') == str(due))
        client.call_async(Trigger.Request())
        assert process.wait(PATIENCE) == 1
        assert process.stderr is not None
        assert 'executor must turn within 1.5 s' in process.stderr.read()
    assert len(list(read_bag(tmp_path / 'run'))) == due
