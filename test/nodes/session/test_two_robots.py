"""Two robots in two namespaces: the launch file's processes, their loops, and the bag of them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from launch_files import started
from launch_stand_in import Context, Node
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from denoc_ros.parts import node_main

pytestmark = pytest.mark.ros
ROOT = Path(__file__).resolve().parents[3]
ROBOT = ROOT / 'config' / 'robots' / 'one_flexible_link.urdf'
RATE = 50.0  # Hz: seven processes share what there is of the machine
GOALS = {'arm1': 0.3, 'arm2': -0.2}  # rad
# torque alone, without a controller, drifts: how far is the machine's
CONTROLLER = {'kp': [0.5], 'kd': [0.04]}  # N m/rad, N m s/rad
PATIENCE = 300.0  # s, for seven interpreters that start at once, on a machine with others


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    return tmp_path / 'bag'


@pytest.fixture
def processes(tmp_path: Path, bag: Path) -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    """Start what the launch file does; end what is left at the end."""
    params = tmp_path / 'params.yaml'
    sections = yaml.safe_load((ROOT / 'config' / 'bringup.yaml').read_text('utf-8'))
    sections['/**/plant']['ros__parameters']['feedback'] = CONTROLLER
    params.write_text(yaml.safe_dump(sections))
    given = {
        'params': str(params),
        'urdf': str(ROBOT),
        'update_rate': str(RATE),
        'record': 'true',
        'output': str(bag),
    }
    context = Context({'denoc_ros': ROOT})
    running = {}
    for node in started(ROOT / 'launch' / 'two_robots.launch.py', given, context):
        assert isinstance(node, Node)
        words = node.ros_arguments(context, tmp_path)
        running[node.full_name] = subprocess.Popen(
            [sys.executable, '-m', node_main(node.executable), *words],
            env={**os.environ, 'PYTHONUNBUFFERED': '1'},
            stdout=subprocess.DEVNULL,
        )
    yield running
    for process in running.values():
        process.kill()
        process.wait()


def value(graph: Any, processes: dict[str, Any], status: str, key: str) -> str:
    """Return what a node says, while all of them run."""
    assert all(process.poll() is None for process in processes.values())
    return graph.value(status, key) or ''


def test_two_robots_follow_their_own_references_and_are_recorded(
    graph: Any, processes: dict[str, Any], bag: Path
) -> None:
    for arm in GOALS:
        graph.until(
            lambda arm=arm: (
                value(graph, processes, f'{arm}/plant: plant', 'braked') == 'False'
                and value(graph, processes, f'{arm}/predictor: loop', 'state') == 'active'
            ),
            PATIENCE,
        )
    graph.until(lambda: value(graph, processes, 'recorder: recording', 'path') != '', PATIENCE)
    seen = {arm: graph.collect(JointState, f'/{arm}/joint_states') for arm in GOALS}
    for arm, goal in GOALS.items():
        move(graph, arm, goal, seen[arm])
    for status in graph.diagnostics.values():
        refused = [each.key for each in status.values if ' rejected ' in each.key]
        assert not refused, (status.name, refused)
    for process in processes.values():
        process.send_signal(signal.SIGINT)
    ends = time.perf_counter() + PATIENCE
    assert {p.wait(max(0.0, ends - time.perf_counter())) for p in processes.values()} == {0}
    with AnyReader([bag]) as reader:
        topics = {connection.topic for connection in reader.connections}
        states = {arm: positions(reader, f'/{arm}/joint_states') for arm in GOALS}
    ours = ('joint_states', 'feedforward/commands', 'predictor/tip_deflection', 'strain')
    assert {f'/{arm}/{topic}' for arm in GOALS for topic in ours} <= topics
    assert not topics & {f'/{topic}' for topic in ours}
    for arm, goal in GOALS.items():
        assert len(states[arm]) > RATE
        assert abs(states[arm][-1] - goal) < 0.1


def move(graph: Any, arm: str, goal: float, states: list[JointState]) -> None:
    """Move an arm; send the reference again while it is not there: not all may listen yet."""
    publisher = graph.publisher(JointTrajectory, f'/{arm}/reference')
    end = JointTrajectoryPoint(positions=[goal])
    end.time_from_start.sec = 1
    reference = JointTrajectory(joint_names=['joint_1'], points=[end])
    sent = [0.0]

    def is_there() -> bool:
        if time.perf_counter() > sent[-1] + 5.0:
            publisher.publish(reference)
            sent.append(time.perf_counter())
        return bool(states) and bool(abs(states[-1].position[0] - goal) < 0.05)

    graph.until(is_there, PATIENCE)


def positions(reader: AnyReader, topic: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    chosen = [each for each in reader.connections if each.topic == topic]
    found = [
        reader.deserialize(raw, connection.msgtype).position[0]  # type: ignore[attr-defined]
        for connection, _, raw in reader.messages(chosen)
    ]
    return np.array(found)
