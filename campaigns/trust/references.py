"""What may come as a reference, and what else may be done to a node."""

from __future__ import annotations

import itertools
import math
import os
import random
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import Any

from node_robots import JOINTS
from rclpy.serialization import serialize_message
from ros_domains import claimed_domain
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from trust.stage import GOAL, INPUTS, RECOVERY, Stage

NAN, INF = math.nan, math.inf
MANY_POINTS = 20_000


def stream(stage: Stage) -> None:
    """Let the planner stream GOAL."""
    stage.planner = lambda: [stage.point()]
    accepted = stage.count(INPUTS, 'reference accepted')
    stage.until(
        lambda: stage.count(INPUTS, 'reference accepted') > accepted + 20, RECOVERY, 'a stream'
    )


@contextmanager
def planning(stage: Stage, says: Callable[[], Sequence[Any]]) -> Iterator[None]:
    stage.planner = says
    yield


def bad_references(stage: Stage) -> AbstractContextManager[None]:
    far = [1.0, 1.0]
    later = JointTrajectoryPoint(positions=far)
    later.time_from_start.sec = 1
    kinds: Iterator[Callable[[], Any]] = itertools.cycle(
        [
            lambda: stage.point([1.0, NAN]),
            lambda: stage.point(far, accelerations=[INF, 0.0]),
            lambda: stage.point([1.0]),
            lambda: JointTrajectory(joint_names=['j1', 'x'], points=[later]),
            lambda: JointTrajectory(joint_names=JOINTS, points=[later, later]),
            lambda: bytes(serialize_message(stage.point()))[: random.randrange(4, 60)],
        ]
    )
    return planning(stage, lambda: [next(kinds)()])


@contextmanager
def second_planner(stage: Stage) -> Iterator[None]:
    other = stage.node.create_publisher(JointTrajectory, 'reference', 10)
    stage.planner = lambda: (other.publish(stage.point([1.0, 1.0])), stage.point([-1.0, 1.0]))[1:]
    yield
    stage.planner = lambda: ()
    stage.node.destroy_publisher(other)


@contextmanager
def many_points(stage: Stage) -> Iterator[None]:
    """Publish one trajectory of very many points, all at GOAL."""
    points = []
    for k in range(MANY_POINTS):
        made = JointTrajectoryPoint(positions=GOAL)
        made.time_from_start.nanosec = 1000 * (k + 1)
        points.append(made)
    stage.references.publish(JointTrajectory(joint_names=JOINTS, points=points))
    yield


def out_of_reach(stage: Stage) -> AbstractContextManager[None]:
    huge = [1e200, -1e200]
    return planning(stage, lambda: [stage.point(huge, velocities=huge, accelerations=huge)])


def violent(stage: Stage) -> AbstractContextManager[None]:
    signs = itertools.cycle([1.0, -1.0])
    return planning(stage, lambda: [stage.point(GOAL, accelerations=[1e5 * next(signs), -9e5])])


REFUSED: tuple[tuple[str, Any], ...] = (
    ('payload.two.mass', NAN),
    ('payload.two.mass', -1.0),
    ('payload.two.mass', 'heavy'),
    ('payload.nothing.mass', 1.0),
    ('beam.one.y.ei', 0.0),
    ('beam.one.y.modes', 1e9),
    ('joint_state_timeout', INF),
    ('joint_state_timeout', -1.0),
    ('reference_timeout', 'soon'),
    ('update_rate', 100.0),
    ('effort_limits', [1e9, 1e9]),
    ('max_delta_tau', 1e9),
    ('no_such_parameter', 1.0),
    ('model', 'magic'),
    ('terms.gravity', 3.5),
)


@contextmanager
def parameter_abuse(stage: Stage) -> Iterator[None]:
    for name, value in REFUSED:
        (result,) = stage.set_parameters([(name, value)])
        assert not result.successful, f'{name}: {value!r} must be refused'
        assert 'must' in result.reason
    for k in range(20):
        assert stage.set_parameters([('payload.two.mass', 0.1 * (k % 2))])[0].successful
    yield


STRANGER = """
import time, rclpy
from sensor_msgs.msg import JointState
rclpy.init()
node = rclpy.create_node('stranger')
publisher = node.create_publisher(JointState, 'joint_states', 10)
print(flush=True)
while True:
    publisher.publish(JointState(name=['j1', 'j2'], position=[float('nan'), 1.5]))
    time.sleep(0.005)
"""


@contextmanager
def another_domain(stage: Stage) -> Iterator[None]:
    command = [sys.executable, '-c', STRANGER]
    with (
        claimed_domain() as domain,
        subprocess.Popen(
            command, stdout=subprocess.PIPE, env={**os.environ, 'ROS_DOMAIN_ID': str(domain)}
        ) as process,
    ):
        assert process.stdout is not None
        process.stdout.readline()
        try:
            yield
        finally:
            process.kill()
