"""A simulated run as a bag, with the topics that the plant would have published."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from denoc_ros.bags.joint_state import FIELDS, JOINT_STATE, JointStateMessage
from denoc_ros.bags.reader import DESCRIPTION_ATTACHMENT, SESSION_ATTACHMENT
from denoc_ros.bags.series import ODOMETRY
from denoc_ros.bags.writer import BagWriter
from denoc_ros.dynamics.driven.measured_side import MeasuredStates
from denoc_ros.dynamics.elastic.deflection import TipDeflections
from denoc_ros.dynamics.robot import Robot
from denoc_ros.output_files import require_new, whole_file
from denoc_ros.simulation.simulate import Run
from denoc_ros.trajectories import Trajectory
from denoc_ros.types import Array

BASE = '/base_motion'  # of a base that floats
TRAJECTORY = 'trajectory_msgs/msg/JointTrajectory'
REFERENCE_STEP = 0.01  # s between the points of the recorded reference
TOPICS = ('/joint_states', '/plant/true_modal_state', '/plant/true_deflection')


def write_run(
    run: Run,
    robot: Robot,
    path: str | os.PathLike[str],
    description: str = '',
    reference: Trajectory | None = None,
    progress: Any = None,
    session: Mapping[str, Any] | None = None,
    base_moves: bool = False,
) -> None:
    """Write a run as MCAP; stamps are the run's own times, from 0.

    Sensors on beams are recorded on their topics where the robot stands on a base that rests and
    has no loops: as names and positions of a JointState, raw and without noise.

    Parameters
    ----------
    run : Run
        Of the robot.
    robot : Robot
        Names joints and beams.
    path : path
        A file that ends in .mcap, or a folder; it must not exist.
    description : str
        The URDF, to be attached; '' for none.
    reference : Trajectory, optional
        What the joints that mimic none were meant to do.
    progress : callable, optional
        Called with 1 after each output time.
    session : mapping, optional
        What the run was, to be attached: ready for JSON.
    base_moves : bool
        Whether the base was moved: then readings of sensors are left out.

    Raises
    ------
    BagError
        When the path exists or cannot be written.
    """
    require_new(Path(path))
    with whole_file(path, parents=True) as unfinished, BagWriter(unfinished) as bag:
        for topic in TOPICS:
            bag.add_topic(topic, JOINT_STATE)
        if description:
            bag.attach(DESCRIPTION_ATTACHMENT, description)
        if session:
            bag.attach(SESSION_ATTACHMENT, json.dumps(session, indent=2), 'application/json')
        if reference is not None:
            bag.add_topic('/reference', TRAJECTORY)
            bag.write_message('/reference', 0, **_reference(robot, reference))
        if len(robot.base_indices):
            bag.add_topic(BASE, ODOMETRY)
        gauges = _Gauges(run, robot, has_readings=not base_moves)
        _write_states(bag, run, robot, gauges, progress)


def _write_states(bag: BagWriter, run: Run, robot: Robot, gauges: _Gauges, progress: Any) -> None:
    measured = MeasuredStates(robot)
    position, velocity, effort = np.zeros((3, len(robot.joint_names)))
    tips = TipDeflections(robot)
    encoders = (
        JointStateMessage(robot.joint_names, FIELDS),
        JointStateMessage(robot.coordinate_names, FIELDS[:2]),
        JointStateMessage(tips.names, FIELDS[:2]),
    )
    for topic in gauges.messages:
        bag.add_topic(topic, JOINT_STATE)
    for k, (t, q, qd, tau) in enumerate(zip(run.t, run.q, run.qd, run.torque, strict=True)):
        stamp_ns = round(float(t) * 1e9)
        measured.positions(q, position)
        measured.positions(qd, velocity)
        effort[:] = tau[robot.joint_indices]
        measured.efforts(q, qd, effort)
        rows = ((position, velocity, effort), (q, qd), tips.evaluate(q, qd))
        for topic, encoder, values in zip(TOPICS, encoders, rows, strict=True):
            bag.write(topic, stamp_ns, encoder.encode(stamp_ns, *values))
        for topic, raw in gauges.messages_at(k, stamp_ns):
            bag.write(topic, stamp_ns, raw)
        if len(robot.base_indices):
            bag.write_message(BASE, stamp_ns, **_odometry(*robot.base_odometry(q, qd)))
        if progress is not None:
            progress(1)


class _Gauges:
    """Raw readings of the sensors on beams along a run, and their messages by topic."""

    def __init__(self, run: Run, robot: Robot, has_readings: bool) -> None:
        tree = robot.tree
        sensors = [sensor for sensor in tree.sensors if sensor.topic]
        if tree.loops or len(robot.base_indices) or not has_readings:
            sensors = []
        self.messages: dict[str, JointStateMessage] = {}
        if not sensors:
            return
        accelerations = robot.forward_dynamics(run.q, run.qd, run.torque)
        values = robot.sensor_values(run.q, run.qd, accelerations)[:, tree.beam_sensor_places]
        self._raw: dict[str, Array] = {}
        for topic in dict.fromkeys(sensor.topic for sensor in sensors):
            own = [k for k, sensor in enumerate(tree.sensors) if sensor.topic == topic]
            names = [tree.sensors[k].field or tree.sensors[k].name for k in own]
            gain, offset = (
                np.array([getattr(tree.sensors[k], name) for k in own])
                for name in ('gain', 'offset')
            )
            resolved = topic if topic.startswith('/') else f'/{topic}'
            self.messages[resolved] = JointStateMessage(names, ('position',))
            self._raw[resolved] = (values[:, own] - offset) / gain

    def messages_at(self, row: int, stamp_ns: int) -> Iterator[tuple[str, bytes]]:
        """Yield topics and messages of a row of the run."""
        for topic, message in self.messages.items():
            yield topic, message.encode(stamp_ns, self._raw[topic][row])


def _odometry(pose: Array, twist: Array) -> dict[str, Any]:
    """Return the fields of an Odometry."""
    turned = Rotation.from_matrix(pose[:3, :3]).as_quat()

    def named(axes: str, values: Array) -> dict[str, float]:
        return dict(zip(axes, values.tolist(), strict=True))

    return {
        'pose': {
            'pose': {
                'position': named('xyz', pose[:3, 3]),
                'orientation': named('xyzw', turned),
            }
        },
        'twist': {
            'twist': {'linear': named('xyz', twist[:3]), 'angular': named('xyz', twist[3:])}
        },
    }


def _reference(robot: Robot, trajectory: Trajectory) -> dict[str, Any]:
    """Return the fields of a JointTrajectory."""
    ties = robot.tree.mimics
    times, q, qd, qdd = trajectory.table(REFERENCE_STEP)
    points = []
    for row, t in enumerate(times.tolist()):
        seconds = math.floor(t)
        points.append(
            {
                'time_from_start': {'sec': seconds, 'nanosec': round((t - seconds) * 1e9)},
                'positions': q[row],
                'velocities': qd[row],
                'accelerations': qdd[row],
            }
        )
    names = [name for name in robot.joint_names if name not in ties]
    return {'joint_names': names, 'points': points}
