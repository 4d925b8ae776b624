"""A session has the robot and the nodes of its configuration, whoever else is in its domain."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from bench.loops.rates_blocks import domain
from node_robots import two_links
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from denoc_ros.bags.reader import read_bag, read_description
from denoc_ros.nodes.base.messages import LATCHED
from denoc_ros.nodes.session_client import NodeError, SessionClient

pytestmark = pytest.mark.ros

BOUND = 240.0  # s: with a cold kernel cache on a slow machine
SESSION = """
robot: arm.urdf
time: simulated
duration: 0.1
nodes:
  plant: {update_rate: 100}
  recorder: {topics: [joint_states, robot_description]}
  predictor: false
  feedforward: false
"""
OTHER_ROBOT = two_links().replace('"j1"', '"other"').replace('name="arm"', 'name="other"')
Maker = Callable[..., Any]


@pytest.fixture
def environment() -> Iterator[dict[str, str]]:
    with domain() as environment:
        yield environment


@pytest.fixture
def others() -> Iterator[Maker]:
    """Make nodes of others in a domain, each as if in a process of its own."""
    made: list[tuple[Any, Any]] = []

    def make(name: str, number: int | None = None) -> Any:
        context = rclpy.Context()
        rclpy.init(args=[], context=context, domain_id=number)
        node = rclpy.create_node(name, context=context, use_global_arguments=False)
        made.append((node, context))
        return node

    yield make
    for node, context in made:
        node.destroy_node()
        rclpy.shutdown(context=context)


def count(client: SessionClient, name: str) -> int:
    """Return how many nodes of a name the client has found."""
    return [each for each, _ in client._node.get_node_names_and_namespaces()].count(name)


UP = """
import sys
from denoc_ros.cli.main import main
from denoc_ros.nodes import session_client
if '--patient' in sys.argv:  # until the description of another is found, however late
    session_client.DISCOVERY = 60.0
    sys.argv.remove('--patient')
sys.exit(main(sys.argv[1:]))
"""


def up(folder: Path, environment: dict[str, str], *options: str) -> Any:
    """Run a session to its end."""
    (folder / 'arm.urdf').write_text(two_links())
    (folder / 'session.yaml').write_text(SESSION)
    return subprocess.run(
        [sys.executable, '-c', UP, 'up', str(folder / 'session.yaml')]
        + ['--output', str(folder / 'run'), *options],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=BOUND,
        check=False,
    )


def test_a_session_runs_the_configured_robot_beside_the_description_of_another(
    tmp_path: Path, environment: dict[str, str], others: Maker
) -> None:
    node = others('robot_state_publisher', int(environment['ROS_DOMAIN_ID']))
    node.create_publisher(String, '/robot_description', LATCHED).publish(String(data=OTHER_ROBOT))
    done = up(tmp_path, environment, '--patient')
    assert done.returncode == 0, done.stderr
    run = tmp_path / 'run'
    assert read_description(run / 'bag') == two_links()
    names = {tuple(item.message.name) for item in read_bag(run / 'bag', ['/joint_states'])}
    assert names == {('j1', 'j2')}
    assert 'description must be that of arm.urdf, got another robot' in done.stderr
    (note,) = json.loads((run / 'session.json').read_text())['notes']
    assert note in done.stdout
    assert 'Notes of the session' in (run / 'report.html').read_text()


@pytest.mark.parametrize('other', ['plant', 'a publisher of /clock'])
def test_a_session_does_not_start_beside_the_nodes_of_another(
    tmp_path: Path, environment: dict[str, str], others: Maker, other: str
) -> None:
    is_node = other == 'plant'
    number = environment['ROS_DOMAIN_ID']
    node = others(other if is_node else 'simulator', int(number))
    if not is_node:
        node.create_publisher(Clock, '/clock', 10)
    done = up(tmp_path, environment)
    assert done.returncode == 1
    rule = f'ROS domain {number}: nodes of other sessions must not run, got '
    assert f'{rule}{"/plant" if is_node else other};' in done.stderr
    assert 'Traceback' not in done.stderr
    # A busy machine may find the others when the nodes have started: nothing has moved by then.
    assert json.loads((tmp_path / 'run' / 'session.json').read_text())['phases'] == []


def test_nodes_of_another_session_are_refused_however_late_they_are_found(
    ros_domain: int, others: Maker
) -> None:
    with SessionClient('<robot/>') as client:
        client.require_alone(['plant'], uses_clock=True)
        others('plant', ros_domain)
        client.require_alone(['predictor'], uses_clock=True, own=1)
        client.require_alone(['plant'], uses_clock=True, own=1)
        assert client.until(lambda: count(client, 'plant') == 1, BOUND)
        with pytest.raises(NodeError, match=r'must not run, got /plant; end them'):
            client.require_alone(['plant'], uses_clock=True)
        others('plant', ros_domain)
        others('up', ros_domain)
        assert client.until(lambda: count(client, 'plant') == 2, BOUND)
        assert client.until(lambda: count(client, 'up') == 2, BOUND)
        with pytest.raises(NodeError, match=r'must not run, got /up; end them'):
            client.require_alone(['predictor'], uses_clock=False)
        with pytest.raises(NodeError, match=r'must not run, got /plant, /up; end them'):
            client.require_alone(['plant'], uses_clock=True, own=1)
        client.forget_nodes(['plant'])  # one of the two counts as the session's own, which ended
        with pytest.raises(NodeError, match=r'must not run, got /up; end them'):
            client.require_alone(['plant'], uses_clock=True, own=1)
        others('plant', ros_domain)
        assert client.until(lambda: count(client, 'plant') == 3, BOUND)
        with pytest.raises(NodeError, match=r'must not run, got /plant, /up; end them'):
            client.require_alone(['plant'], uses_clock=True, own=1)
