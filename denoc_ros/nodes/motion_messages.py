"""Messages of whole motions that leave."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Duration, Time
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from denoc_ros.bags.cdr import stamp_fields
from denoc_ros.runtime.trajectory_messages import TrajectoryMessage
from denoc_ros.types import Array


def planned_message(
    joints: Sequence[str],
    arrays: dict[str, Array],
    begin_ns: int,
    chosen: Sequence[int] | None = None,
) -> JointTrajectory:
    """Return the message of a plan that begins at a stamp [ns]: `t`, `q`, `qd`, `qdd`."""
    places = list(range(len(joints))) if chosen is None else list(chosen)
    rows = [np.asarray(arrays[name][:, places]).tolist() for name in ('q', 'qd', 'qdd')]
    since = arrays['t'] - arrays['t'][0]
    points = [
        JointTrajectoryPoint(
            positions=q, velocities=qd, accelerations=qdd, time_from_start=_duration(t)
        )
        for t, q, qd, qdd in zip(since.tolist(), *rows, strict=True)
    ]
    return _message([joints[k] for k in places], points, begin_ns)


def unshaped_message(
    joints: Sequence[str],
    given: TrajectoryMessage,
    begin_ns: int,
    chosen: Sequence[int] | None = None,
) -> JointTrajectory:
    """Return the message that came in, with another stamp [ns]; 0: now."""
    places = list(range(len(joints))) if chosen is None else list(chosen)
    points = []
    for k, t in enumerate(given.times.tolist()):
        point = JointTrajectoryPoint(
            positions=given.positions[k, places].tolist(), time_from_start=_duration(t)
        )
        if given.velocities is not None:
            point.velocities = given.velocities[k, places].tolist()
        if given.accelerations is not None:
            point.accelerations = given.accelerations[k, places].tolist()
        points.append(point)
    return _message([joints[k] for k in places], points, begin_ns)


def _message(
    names: list[str], points: list[JointTrajectoryPoint], begin_ns: int
) -> JointTrajectory:
    message = JointTrajectory(joint_names=names, points=points)
    seconds, nanoseconds = stamp_fields(begin_ns)
    message.header.stamp = Time(sec=seconds, nanosec=nanoseconds)
    return message


def _duration(seconds: float) -> Duration:
    whole, rest = divmod(round(1e9 * seconds), 1_000_000_000)
    return Duration(sec=whole, nanosec=rest)
