"""Nodes share no memory with other processes, so that none of them can hold up the torque."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from child_processes import child

from denoc_ros.nodes.base import middleware
from denoc_ros.nodes.base.middleware import (
    LOCALHOST,
    ONLY,
    PROFILES,
    RANGE,
    TRANSPORTS,
    use_sockets,
)

FASTRTPS = 'rmw_fastrtps_cpp'
# prints whether shared memory of the middleware is mapped, then sends
SENDER = """
import rclpy, sys, time
from denoc_ros.nodes.base.middleware import use_sockets
from std_msgs.msg import String
use_sockets()
rclpy.init()
publisher = rclpy.create_node('sender').create_publisher(String, 'torque', 1)
print('/dev/shm/fast' in open('/proc/self/maps').read(), flush=True)
while True:
    publisher.publish(String(data='x' * 500))
    time.sleep(0.002)
"""
LISTENER = """
import rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node('listener')
heard = []
node.create_subscription(String, 'torque', heard.append, 1)
while not heard:
    rclpy.spin_once(node, timeout_sec=0.1)
print('heard', flush=True)
"""


@pytest.mark.parametrize(
    ('given', 'changed'),
    [
        ({}, {TRANSPORTS: 'UDPv4'}),
        ({RANGE: 'SUBNET'}, {TRANSPORTS: 'UDPv4'}),
        ({RANGE: 'LOCALHOST'}, {PROFILES: str(LOCALHOST), RANGE: 'SYSTEM_DEFAULT'}),
        ({ONLY: '1'}, {PROFILES: str(LOCALHOST), RANGE: 'SYSTEM_DEFAULT', ONLY: None}),
        ({ONLY: '0', RANGE: 'LOCALHOST'}, {TRANSPORTS: 'UDPv4'}),
        ({RANGE: 'LOCALHOST', 'ROS_STATIC_PEERS': '192.168.0.2'}, {}),
        ({RANGE: 'LOCALHOST', TRANSPORTS: 'DEFAULT'}, {}),
        ({PROFILES: 'mine.xml'}, {}),
    ],
)
def test_the_users_own_choice_stays(given: dict[str, str], changed: dict[str, str | None]) -> None:
    environment = dict(given)
    use_sockets(environment, FASTRTPS)
    expected = {name: value for name, value in {**given, **changed}.items() if value is not None}
    assert environment == expected


def test_other_middleware_and_a_profile_in_the_folder_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    environment = {RANGE: 'LOCALHOST'}
    use_sockets(environment, 'rmw_cyclonedds_cpp')
    assert environment == {RANGE: 'LOCALHOST'}
    (tmp_path / middleware.IMPLICIT_PROFILES).touch()
    monkeypatch.chdir(tmp_path)
    use_sockets(environment, FASTRTPS)
    assert environment == {RANGE: 'LOCALHOST'}


@pytest.mark.ros
def test_a_sender_without_shared_memory_is_heard_by_a_listener_with(ros_domain: int) -> None:
    """Stopped and killed listeners with shared memory: `python -m campaigns neighbours`."""
    with child([sys.executable, '-c', SENDER], stdout=subprocess.PIPE) as sender:
        listener = [sys.executable, '-c', LISTENER]
        heard = subprocess.run(listener, capture_output=True, text=True, timeout=60.0, check=True)
        assert heard.stdout == 'heard\n'
        sender.kill()
        said, _ = sender.communicate(timeout=60.0)
    assert said == 'False\n'
