"""Nodes as processes: how they start, refuse and end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from child_processes import children, gone
from feedback_runs import CANADARM
from node_robots import JOINTS, STATE_FEEDBACK
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from denoc_ros.dynamics.robot import load_robot
from denoc_ros.parts import node_main

pytestmark = pytest.mark.ros
GRAVITY = '[0.0, -9.81, 0.0]'


@pytest.fixture
def start() -> Iterator[Any]:
    """Start a node with parameters as `name:=value` texts; end what is left at the end."""
    processes: list[subprocess.Popen[str]] = []

    def begin(node: str, *parameters: str) -> subprocess.Popen[str]:
        arguments = [text for each in parameters for text in ('-p', each)]
        process = subprocess.Popen(
            [sys.executable, '-m', node_main(node), '--ros-args', *arguments],
            stderr=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        processes.append(process)
        return process

    yield begin
    for process in processes:
        for child in children(process.pid):  # a stopped one would keep the pipes open
            with suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)
        process.kill()
        process.communicate()


@pytest.mark.parametrize(
    ('node', 'parameters', 'says'),
    [
        ('plant', ['urdf_path:=/nowhere/arm.urdf'], '/nowhere/arm.urdf'),
        ('plant', ['urdf_path:={urdf}', 'beam.six.y.ei:=3'], 'six'),
        ('feedforward', ['update_rat:=5'], "did you mean 'update_rate'"),
        ('feedforward', ['urdf_path:={urdf}', 'joints:=[j1,j9]'], 'must name different joints'),
    ],
)
def test_what_cannot_work_exits_1_with_one_line(
    start: Any, urdf: str, node: str, parameters: list[str], says: str
) -> None:
    process = start(node, *(text.format(urdf=urdf) for text in parameters))
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 1
    assert says in errors
    assert 'Traceback' not in errors
    assert len(errors.strip().splitlines()) == 1, errors


def test_a_process_without_a_model_loads_no_dynamics() -> None:
    """A recorder took three times as long to start with them."""
    script = (
        'import sys; import denoc_ros.nodes.recorder; '
        'found = {"numba", "scipy", "denoc_ros.dynamics"} & sys.modules.keys(); '
        'assert not found, found'
    )
    subprocess.run([sys.executable, '-c', script], check=True, timeout=120)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_with_the_safe_command_and_status_0(
    graph: Any, start: Any, urdf: str, number: int
) -> None:
    commands = graph.collect(Float64MultiArray, '/feedforward/commands')
    process = start(
        'feedforward',
        f'urdf_path:={urdf}',
        f'gravity:={GRAVITY}',
        'update_rate:=100',
        'model:=rigid',
        'joint_state_timeout:=5',
    )
    states = graph.publisher(JointState, 'joint_states')

    def carried() -> bool:
        states.publish(JointState(name=JOINTS, position=[0.4, -0.7]))
        return len(commands) > 10

    graph.until(carried)
    process.send_signal(number)
    graph.until(lambda: process.poll() is not None)
    graph.spin(0.3)  # let what is under way arrive
    said, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    assert 'active at 100 Hz: robot' in said + errors
    robot = load_robot(urdf, gravity=(0.0, -9.81, 0.0))
    q, zero = np.zeros(robot.n), np.zeros(robot.n)
    q[robot.joint_indices] = 0.4, -0.7
    gravity = robot.inverse_dynamics(q, zero, zero)[robot.joint_indices]
    np.testing.assert_allclose([c.data for c in commands[-3:]], [gravity] * 3, atol=1e-9)


COMPILED = 400.0  # s in which a node that may be the first of all has its kernels, and a child
PROCESSES = {
    'shaper': ['method:=zv', 'limits.effort:=[500.0]'],
    'feedforward': [f'{name}:={value}' for name, value in STATE_FEEDBACK.items()],
}


@pytest.mark.parametrize('moment', ['starts', 'imports', 'works'])
@pytest.mark.parametrize('node', PROCESSES)
def test_a_node_ends_with_status_0_while_its_process_is_stopped(
    graph: Any, start: Any, node: str, moment: str
) -> None:
    process = start(node, f'urdf_path:={CANADARM}', 'gravity:=[0.0,0.0,0.0]', *PROCESSES[node])
    graph.until(lambda: children(process.pid), COMPILED)
    (child,) = children(process.pid)
    if moment == 'imports':
        graph.spin(0.3)
    elif moment == 'works':
        graph.until(lambda: graph.value(f'{node}: loop', 'state') == 'active')
    os.kill(child, signal.SIGSTOP)
    began = time.perf_counter()
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    assert time.perf_counter() - began < 20.0  # 1 to 2 s, on a machine that is busy with others
    graph.until(lambda: gone(child))


def test_a_plant_ends_cleanly_on_sigterm(graph: Any, start: Any, urdf: str) -> None:
    states = graph.collect(JointState, '/joint_states')
    process = start('plant', f'urdf_path:={urdf}', 'update_rate:=100')
    graph.until(lambda: len(states) > 10)
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
