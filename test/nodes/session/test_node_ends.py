"""What is left of a process's part in the graph when it ends: nothing."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from child_processes import child
from sensor_msgs.msg import JointState

from denoc_ros.bags.writer import BagWriter
from denoc_ros.parts import node_main

pytestmark = pytest.mark.ros

PATIENCE = 300.0  # s for a process that imports everything, on a machine with twenty others
# of shared memory, where it is used: the library's thread, not a participant's
WATCHDOG = 'dds.shm.wdog'

LEFT = """
from pathlib import Path

def left():
    names = []
    for task in Path('/proc/self/task').iterdir():
        try:
            names.append((task / 'comm').read_text().strip())
        except OSError:  # it has just ended
            pass
    return sorted(name for name in names if name.startswith('dds'))
"""

# a node that is told to end when it is active; then the threads that are left of the middleware
LEFT_BEHIND = (
    LEFT
    + """
import os, signal, sys, threading
from denoc_ros.nodes.base import process
from denoc_ros.nodes import feedforward

def active():
    return any(name.name == 'loop' for name in threading.enumerate())

def told():
    if active():
        os.kill(os.getpid(), signal.SIGTERM)
    else:
        threading.Timer(0.1, told).start()

told()
status = process.run(feedforward.FeedforwardNode, sys.argv)
print(status, *left())
process.leave(status)
"""
)

LEFT_BY_CLIENT = (
    LEFT
    + """
from denoc_ros.nodes.session_client import SessionClient

with SessionClient('<robot/>'):
    pass
print(*left())
"""
)

# a session that is interrupted while it enters the graph
INTERRUPTED = (
    LEFT
    + """
import os, signal, threading
from types import SimpleNamespace
from denoc_ros.cli import up_verb as up
from denoc_ros.cli.interrupts import Interrupts
from denoc_ros.nodes import session_client

join = session_client.SessionClient._join
def joined(*given):
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGINT):
        os.kill(os.getpid(), number)
    join(*given)
session_client.SessionClient._join = joined
nothing = SimpleNamespace(
    check=lambda: None, trajectory=None, robot=Path(os.devnull), without=("shaper",)
)
try:
    with Interrupts() as interrupts, up._client(nothing, nothing, nothing, interrupts):
        print('went on')
except KeyboardInterrupt:
    print('interrupted')
print(*left())
"""
)


def test_a_node_leaves_no_thread_of_the_middleware(ros_domain: int, urdf: str) -> None:
    command = [sys.executable, '-c', LEFT_BEHIND, '--ros-args', '-p', f'urdf_path:={urdf}']
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    status, *left = done.stdout.splitlines()[-1].split()
    assert status == '0', done.stderr
    assert set(left) <= {WATCHDOG}


@pytest.mark.parametrize(('code', 'said'), [(LEFT_BY_CLIENT, []), (INTERRUPTED, ['interrupted'])])
def test_a_session_leaves_no_thread_of_the_middleware(
    ros_domain: int, code: str, said: list[str]
) -> None:
    command = [sys.executable, '-c', code]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 0, done.stderr
    *words, left = done.stdout.split('\n')[:-1]
    assert words == said, done.stderr
    assert set(left.split()) <= {WATCHDOG}


def test_a_publisher_that_cannot_be_made_is_one_clear_end(ros_domain: int, urdf: str) -> None:
    command = [sys.executable, '-m', 'denoc_ros.nodes.feedforward', '--ros-args']
    command += ['-p', f'urdf_path:={urdf}', '-r', '~/effort:=/clash', '-r', '~/commands:=/clash']
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 1
    assert 'terminate' not in done.stderr
    assert 'create' in done.stderr


@pytest.mark.parametrize(
    ('node', 'number'),
    [
        ('predictor', signal.SIGINT),
        ('predictor', signal.SIGTERM),
        ('predictor', signal.SIGHUP),
        pytest.param('shaper', signal.SIGTERM, marks=pytest.mark.parts('planning')),
        pytest.param('viewer', signal.SIGTERM, marks=pytest.mark.parts('viewer')),
    ],
)
def test_signals_are_honoured_while_a_node_imports(
    ros_domain: int, node: str, number: int
) -> None:
    command = [sys.executable, '-m', node_main(node)]
    with child(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline() == f'{node}: starting\n'
        process.send_signal(number)
        assert process.wait(60.0) == 0
        assert process.stderr.read() == ''


def test_signals_are_honoured_while_a_node_compiles(
    ros_domain: int, urdf: str, tmp_path: Path
) -> None:
    command = [sys.executable, '-m', 'denoc_ros.nodes.plant', '--ros-args']
    command += ['-p', f'urdf_path:={urdf}']
    environment = {**os.environ, 'NUMBA_CACHE_DIR': str(tmp_path / 'cache')}
    with child(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment
    ) as process:
        assert process.stdout is not None
        while 'compiling' not in (line := process.stdout.readline()):
            assert line, 'the node must say that it compiles'
        process.send_signal(signal.SIGTERM)
        began = time.monotonic()
        assert process.wait(60.0) == 0
        assert time.monotonic() - began < 20.0  # a second on a machine that does nothing else
        assert process.stderr is not None
        assert process.stderr.read() == ''


def write_motion(path: Path) -> None:
    """Write a recording of a joint that moves, 100 messages in a second."""
    with BagWriter(path) as writer:
        writer.add_topic('/joint_states', 'sensor_msgs/msg/JointState')
        for k in range(100):
            stamp = {'sec': 1, 'nanosec': k * 10_000_000}
            fields = {'name': ['a'], 'position': [0.01 * k], 'velocity': [1.0]}
            writer.write_message(
                '/joint_states', 10**9 + k * 10**7, header={'stamp': stamp}, **fields
            )


@pytest.mark.parametrize('numbers', [[signal.SIGINT] * 2, [signal.SIGTERM], [signal.SIGHUP]])
def test_a_player_ends_as_it_is_told(graph: Any, tmp_path: Path, numbers: list[int]) -> None:
    bag = tmp_path / 'bag'
    write_motion(bag)
    states = graph.collect(JointState, '/joint_states')
    command = [sys.executable, '-m', 'denoc_ros.cli.player', str(bag), '--speed', '0.005']  # 200 s
    with child(command, stderr=subprocess.PIPE) as process:
        graph.until(lambda: len(states) > 1, timeout=60.0)
        for number in numbers:
            process.send_signal(number)
            time.sleep(0.05)
        assert process.wait(60.0) == 0
        assert process.stderr is not None
        assert process.stderr.read() == ''
