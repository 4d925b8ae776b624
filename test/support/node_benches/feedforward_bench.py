"""A feedforward node under test, and the messages it is given."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from node_robots import GRAVITY, JOINTS
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from denoc_ros.dynamics.robot import load_robot
from denoc_ros.nodes.feedforward import FeedforwardNode

RATE = 200.0
POSTURE = [0.4, -0.7]


class FeedforwardBench:
    """A feedforward node, its joint states kept fresh, and what it publishes."""

    def __init__(self, graph: Any, urdf: str, **parameters: Any) -> None:
        self.graph = graph
        self.commands = graph.collect(Float64MultiArray, '/feedforward/commands')
        self.effort = graph.collect(JointState, '/feedforward/effort')
        self.points = graph.collect(JointTrajectory, '/feedforward/joint_trajectory')
        given = {'urdf_path': urdf, 'gravity': GRAVITY, 'update_rate': RATE, 'model': 'rigid'}
        given.update({name.replace('__', '.'): value for name, value in parameters.items()})
        self.node = graph.add(FeedforwardNode, parameters=given)
        self.states = graph.publisher(JointState, 'joint_states')
        self.reference: Any = None
        if not self.node.from_joints:
            self.reference = graph.publisher(JointTrajectory, 'reference')
        self.robot = load_robot(urdf, gravity=GRAVITY)
        self.posture = list(POSTURE)
        self.feeding = True
        self._fed = 0.0

    def feed(self) -> None:
        """Publish joint states now and then."""
        if self.feeding and time.perf_counter() - self._fed > 0.005:
            self._fed = time.perf_counter()
            self.states.publish(joint_state(JOINTS, self.posture))

    def until(self, condition: Any) -> None:
        def fed() -> object:
            self.feed()
            return condition()

        self.graph.until(fed)

    def follow(self, *points: JointTrajectoryPoint, joints: list[str] | None = None) -> None:
        self.reference.publish(JointTrajectory(joint_names=joints or JOINTS, points=list(points)))

    def hold(self, positions: list[float]) -> None:
        """Give a trajectory that stays at a posture, and wait until it is followed."""
        self.follow(point(0.0, positions), point(0.01, positions))
        self.until(lambda: self.node.follower.given)
        self.until(lambda: self.cause == 'following')

    @property
    def cause(self) -> str:
        return str(self.node._cause)

    def inverse(self, *state: Any) -> Any:
        """Return the joint torque of the rigid model."""
        rows = np.zeros((3, self.robot.n))
        for row, part in zip(rows, state, strict=False):
            row[self.robot.joint_indices] = part
        return self.robot.inverse_dynamics(*rows)[self.robot.joint_indices]

    def call(self, service: type, name: str, request: Any) -> Any:
        client = self.graph.probe.create_client(service, f'/feedforward/{name}')
        self.until(client.service_is_ready)
        future = client.call_async(request)
        self.until(future.done)
        return future.result()


def joint_state(names: list[str], positions: list[float], stamp_ns: int = 0) -> JointState:
    message = JointState(name=names, position=positions)
    stamp(message, stamp_ns)
    return message


def stamp(message: Any, stamp_ns: int) -> None:
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    message.header.stamp.sec, message.header.stamp.nanosec = seconds, nanoseconds


def point(after: float, *rows: list[float]) -> JointTrajectoryPoint:
    names = ('positions', 'velocities', 'accelerations')
    made = JointTrajectoryPoint(**dict(zip(names, rows, strict=False)))
    made.time_from_start.sec = int(after)
    made.time_from_start.nanosec = round((after - int(after)) * 1e9)
    return made
