"""Runs whose numbers change, as bags: joint states with effort, gauges of one topic."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from tracked_runs import TrackedRun

from denoc_ros.bags.joint_state import JOINT_STATE, JointStateMessage
from denoc_ros.bags.writer import BagWriter
from denoc_ros.dynamics.robot import Robot
from denoc_ros.simulation.recorded.adapted import Adapted
from denoc_ros.types import Array

SHIFTED = 8  # joint states that the work of a block is spread over
ORIGIN = 10**18  # ns, of the first stamp


def write_tracked(run: TrackedRun, robot: Robot, path: Path, effort: str = '') -> Path:
    """Write a run of a robot whose sensors share a topic; `effort` names a topic of its own."""
    states = JointStateMessage(robot.joint_names, ('position', 'velocity', 'effort'))
    sensors = robot.tree.sensors
    strain = JointStateMessage([sensor.name for sensor in sensors], ('position',))
    commands = JointStateMessage(robot.joint_names, ('effort',))
    with BagWriter(path) as writer:
        for topic in ('/joint_states', '/strain', *([effort] if effort else [])):
            writer.add_topic(topic, JOINT_STATE)
        for k, t in enumerate(run.t.tolist()):
            stamp = ORIGIN + round(1e9 * t)
            states.position[:], states.velocity[:] = run.q[k], run.qd[k]
            states.effort[:] = np.nan if effort else run.effort[k]
            commands.effort[:] = run.effort[k]
            strain.position[:] = [
                (value - sensor.offset) / sensor.gain
                for value, sensor in zip(run.sensors[k], sensors, strict=True)
            ]
            said = {'/strain': strain, '/joint_states': states}
            for topic, message in ({effort: commands} | said if effort else said).items():
                writer.write(topic, stamp, message.bytes(stamp))
    return path


def is_as_heard(found: Adapted, run: TrackedRun, heard: Array) -> bool:
    """Say whether a bag's replay found the values (k,) of one number that were heard of a run.

    Rounding of stamps may end a block a joint state earlier or later, and so its work.
    """
    rows = np.searchsorted(run.t, found.t - 1e-6)
    near = [heard[np.clip(rows + k, 0, len(heard) - 1)] for k in range(-SHIFTED, SHIFTED + 1)]
    apart = np.abs(np.array(near) - found.values[:, 0]).min(axis=0)
    return bool(np.all(apart < 1e-6 * np.abs(heard[-1])))
