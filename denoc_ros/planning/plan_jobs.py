"""Motions planned as jobs of the worker process."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np

from denoc_ros.dynamics.driven.driven_joints import DrivenJoints, all_joints
from denoc_ros.dynamics.driven.joint_limits import joint_limits, require_limits
from denoc_ros.dynamics.driven.motion_plan import Plan
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import DenocError
from denoc_ros.planning.shape_motion import shape_motion
from denoc_ros.planning.shapers.joint_servo import JointServo, joint_servo
from denoc_ros.planning.shapers.shaped_samples import rest_spline
from denoc_ros.trajectories import KNOTS, SplineTrajectory
from denoc_ros.types import Array

LONGEST_STEP = 0.01  # s between samples that are planned from
SAMPLES = 200  # of a motion, at least


def answer(
    robot: Robot, header: dict[str, Any], arrays: dict[str, Array]
) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return the answer to a job `load` or `shape`; a motion has arrays `t`, `q`, `qd`, `qdd`."""
    if header['job'] == 'load':
        _rehearse(robot, header, arrays)
        return {'joints': list(robot.joint_names)}, {}
    return _shape(robot, header, arrays)


def _rehearse(robot: Robot, header: dict[str, Any], arrays: dict[str, Array]) -> None:
    """Plan a motion that stands still: kernels compile here, not in the time of the first."""
    still = arrays['posture'][robot.indices(header['joints'])]
    rest = np.zeros((2, len(still)))
    knots = np.array([0.0, 1.0]), np.array([still, still]), rest, rest
    with suppress(DenocError):  # a motion may be possible where standing still is not
        _shape(robot, header, {**dict(zip(KNOTS, knots, strict=True)), **arrays})


def _shape(
    robot: Robot, header: dict[str, Any], arrays: dict[str, Array]
) -> tuple[dict[str, Any], dict[str, Array]]:
    joints = robot.indices(header['joints'])
    times, positions, rates, changes = (arrays[name] for name in KNOTS)
    asked = SplineTrajectory(times, positions, rates, changes)
    t, driven, _, _ = asked.table(min(LONGEST_STEP, asked.duration / SAMPLES))
    q = all_joints(robot, header['joints'], driven, arrays['posture'])
    tip = header['tip'] or None
    base = header['base'] if len(robot.base_indices) else None
    method, options = header['method'], dict(header['options'])
    if options.get('radius') is not None:  # its points, not the samples between them
        points = all_joints(robot, header['joints'], positions, arrays['posture'])
        between = points[1:-1, DrivenJoints(robot, method).places]
        options.update({'waypoints': between} if len(between) else {'radius': None})
    plan = shape_motion(robot, t, q, method, tip, base=base, **options)
    require_limits(robot, plan, joint_limits(robot, **header['limits']))
    rows = plan.q[:, joints], plan.qd[:, joints], plan.qdd[:, joints]
    servo = joint_servo(len(joints), **header['servo'])
    t, q, qd, qdd = _commands(plan, rows, servo)
    answer = {
        'delay': plan.delay,
        'preaction': plan.preaction + servo.preaction,
        'tip_error_end': float(plan.tip_error[-1]),
    }
    return answer, {'t': t, 'q': q, 'qd': qd, 'qdd': qdd}


def _commands(
    plan: Plan, rows: tuple[Array, Array, Array], servo: JointServo
) -> tuple[Array, Array, Array, Array]:
    """Times and commands with which the joints, behind their servos, follow the plan."""
    if servo.is_exact:
        return plan.t, *rows
    spline = rest_spline(plan.t, rows[0])
    first, last = float(plan.t[0]), float(plan.t[-1])

    def motion(times: Array, derivative: int) -> Array:
        found = np.array(spline(np.clip(times, first, last), derivative))
        if derivative:
            found[(times < first) | (times > last)] = 0.0
        return found

    step = (last - first) / (len(plan.t) - 1)
    before = int(np.ceil(servo.preaction / step - 1e-9))
    t: Array = first + step * np.arange(-before, len(plan.t), dtype=np.float64)
    return t, *servo.command(t, motion)
