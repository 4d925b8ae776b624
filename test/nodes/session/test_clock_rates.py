"""A motion of one flexible link by others' clock, slower and faster than the wall's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from denoc_ros.dynamics.robot import load_robot
from denoc_ros.nodes.base.messages import time_message
from denoc_ros.nodes.feedforward import FeedforwardNode
from denoc_ros.nodes.predictor import PredictorNode
from denoc_ros.types import Array

pytestmark = pytest.mark.ros
RATES = (1.0, 2.0, 0.3)  # s of simulated time per s
PERIOD, START = 5_000_000, 3_000_000_000  # ns
ANGLE, DURATION = 0.8, 4.0  # rad, s
EVERY = QoSProfile(depth=2000, reliability=ReliabilityPolicy.RELIABLE)


def quintic(t: Array) -> tuple[Array, Array]:
    """Return angle and rate of a motion from rest to rest at times (k,) [s]."""
    u = np.clip(t / DURATION, 0.0, 1.0)
    angle = ANGLE * u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
    return angle, ANGLE / DURATION * 30.0 * (u * (1.0 - u)) ** 2


class Run:
    """Both nodes on a robot that follows the motion exactly, by /clock at a rate."""

    def __init__(self, graph: Any, robot: Path) -> None:
        self.graph = graph
        (self.joint,) = load_robot(robot).joint_names
        given = {'urdf_path': str(robot), 'update_rate': 200.0, 'use_sim_time': True}
        self.nodes = [
            graph.add(kind, parameters=given) for kind in (FeedforwardNode, PredictorNode)
        ]
        publisher = graph.probe.create_publisher
        self.clock = publisher(Clock, '/clock', EVERY)
        self.states = publisher(JointState, 'joint_states', EVERY)
        self.reference = publisher(JointTrajectory, 'reference', EVERY)
        self.efforts = graph.collect(JointState, '/feedforward/effort')
        self.modes = graph.collect(JointState, '/predictor/modal_state')

    def at(self, now: int) -> None:
        angle, rate = quintic(np.array([1e-9 * (now - START)]))
        state = JointState(name=[self.joint], position=angle.tolist(), velocity=rate.tolist())
        state.header.stamp = time_message(now)
        self.states.publish(state)
        self.clock.publish(Clock(clock=time_message(now)))

    def go(self, rate: float) -> tuple[dict[int, list[float]], dict[int, list[float]]]:
        """Return position and torque, and the modal state, by stamp [ns]."""
        feedforward, _ = self.nodes
        end = START + round(1e9 * DURATION)

        def begun() -> bool:
            self.at(START - 50 * PERIOD)
            return all(
                node.clock.now_ns() == START - 50 * PERIOD and node.joint_input.received
                for node in self.nodes
            )

        self.graph.until(begun)
        before = feedforward.reference_input.accepted
        message = JointTrajectory(joint_names=[self.joint])
        message.header.stamp = time_message(START)
        for angle, second in ((0.0, 0), (ANGLE, round(DURATION))):
            point = JointTrajectoryPoint(positions=[angle], velocities=[0.0], accelerations=[0.0])
            point.time_from_start.sec = second
            message.points.append(point)
        self.reference.publish(message)
        self.graph.until(lambda: feedforward.reference_input.accepted > before)
        self.efforts.clear()
        self.modes.clear()
        for now in range(START - 49 * PERIOD, end + 1, PERIOD):
            self.at(now)
            self.graph.spin(1e-9 * PERIOD / rate)
        last = time_message(end)
        self.graph.until(lambda: self.efforts[-1].header.stamp == last)
        self.graph.until(lambda: self.modes[-1].header.stamp == last)
        assert feedforward._cause == 'following'
        return (
            by_stamp(self.efforts, lambda m: [m.position[0], m.effort[0]]),
            by_stamp(self.modes, lambda m: list(m.position)),
        )


def by_stamp(messages: list[Any], values: Any) -> dict[int, list[float]]:
    return {m.header.stamp.sec * 10**9 + m.header.stamp.nanosec: values(m) for m in messages}


def test_outputs_at_other_rates_are_those_of_rate_one(graph: Any, repository: Path) -> None:
    run = Run(graph, repository / 'config/robots/one_flexible_link.urdf')
    stamps = range(START, START + round(1e9 * DURATION) + 1, PERIOD)
    wanted, _ = quintic(1e-9 * (np.array(stamps) - START))
    torques, bent = {}, {}
    for rate in RATES:
        efforts, modes = run.go(rate)
        position, torques[rate] = np.array([efforts[each] for each in stamps]).T
        assert np.abs(position - wanted).max() < 1e-9, rate
        bent[rate] = np.array([modes[each] for each in stamps])[:, 1:]
    swing, bends = np.ptp(torques[1.0]), np.ptp(bent[1.0])
    assert swing > 1e-3
    assert bends > 1e-6
    for rate in RATES[1:]:
        errors = (
            np.abs(torques[rate] - torques[1.0]).max() / swing,
            np.abs(bent[rate] - bent[1.0]).max() / bends,
        )
        print(f'rate {rate:g}: torque off by {errors[0]:.1e}, amplitudes by {errors[1]:.1e}')
        assert max(errors) < 1e-9
