"""A process that plans motions and gains: jobs on standard input, answers on standard output.

:class:`denoc_ros.runtime.worker.worker.Planner` starts it. It ends with its input, or with the
process that started it.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
import time
from contextlib import suppress
from typing import Any, BinaryIO

import numpy as np

from denoc_ros.dynamics.driven.driven_joints import DrivenJoints, all_joints
from denoc_ros.dynamics.driven.joint_limits import joint_limits, require_limits
from denoc_ros.dynamics.driven.measured_side import measured_robot
from denoc_ros.dynamics.driven.motion_plan import Plan
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import DenocError
from denoc_ros.feedback.gain_jobs import KNOTS, read_job, schedule_message
from denoc_ros.planning.shape_motion import shape_motion
from denoc_ros.planning.shapers.joint_servo import JointServo, joint_servo
from denoc_ros.planning.shapers.shaped_samples import rest_spline
from denoc_ros.runtime.worker.worker_messages import read_message, write_message
from denoc_ros.trajectories import SplineTrajectory
from denoc_ros.types import Array

LOOK = 0.5  # s between looks whether the parent is there
LONGEST_STEP = 0.01  # s between samples that are planned from
SAMPLES = 200  # of a motion, at least
PR_SET_PDEATHSIG = 1  # of <linux/prctl.h>


class Planning:
    """Answers jobs, with the robot of the last one at hand."""

    def __init__(self) -> None:
        self._base: tuple[Any, Robot] | None = None
        self._changed: tuple[Any, Robot] | None = None

    def robot(self, wanted: dict[str, Any]) -> Robot:
        """Return the robot of a job: `source`, `gravity`, `geometric_stiffness`, `overrides`."""
        key = wanted['source'], tuple(wanted['gravity']), wanted['geometric_stiffness']
        if self._base is None or self._base[0] != key:
            self._base = key, measured_robot(load_robot(*key))
            self._changed = None
        overrides = wanted['overrides']
        if self._changed is None or self._changed[0] != overrides:
            base = self._base[1]
            self._changed = overrides, base.with_overrides(overrides) if overrides else base
        return self._changed[1]

    def answer(
        self, header: dict[str, Any], arrays: dict[str, Array]
    ) -> tuple[dict[str, Any], dict[str, Array]]:
        """Return the answer to a job: `error`, or the arrays `t`, `q`, `qd`, `qdd`, or gains."""
        began = time.perf_counter()
        try:
            robot = self.robot(header['robot'])
            if header['job'] == 'load':
                self._rehearse(robot, header, arrays)
                answer: dict[str, Any] = {'joints': list(robot.joint_names)}
                rows: dict[str, Array] = {}
            elif header['job'] == 'gains':
                answer, rows = schedule_message(read_job(header, arrays).schedule(robot))
            else:
                answer, rows = self._shape(robot, header, arrays)
        except (DenocError, OSError) as error:
            answer, rows = {'error': str(error)}, {}
        except Exception as error:  # a defect of ours must not end the process
            answer, rows = {'error': f'{type(error).__name__}: {error}'}, {}
        return {**answer, 'id': header['id'], 'took': time.perf_counter() - began}, rows

    def _rehearse(self, robot: Robot, header: dict[str, Any], arrays: dict[str, Array]) -> None:
        """Plan a motion that stands still: kernels compile here, not in the time of the first."""
        still = arrays['posture'][robot.indices(header['joints'])]
        rest = np.zeros((2, len(still)))
        knots = np.array([0.0, 1.0]), np.array([still, still]), rest, rest
        with suppress(DenocError):  # a motion may be possible where standing still is not
            self._shape(robot, header, {**dict(zip(KNOTS, knots, strict=True)), **arrays})

    def _shape(
        self, robot: Robot, header: dict[str, Any], arrays: dict[str, Array]
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


def serve(jobs: BinaryIO, answers: BinaryIO) -> None:
    """Answer jobs until there are no more."""
    planning = Planning()
    while (job := read_message(jobs)) is not None:
        write_message(answers, *planning.answer(*job))


def main() -> None:
    """Serve the process that started this one, and end with it."""
    parent = os.getppid()
    _end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(LOOK)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
    # what anything prints must not get between the answers
    answers = os.fdopen(os.dup(sys.stdout.fileno()), 'wb')
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    try:
        serve(sys.stdin.buffer, answers)
    except BrokenPipeError:
        os._exit(1)


def _end_with_parent() -> None:
    """Have the kernel kill this process when its parent ends, even while it is stopped."""
    with suppress(OSError, AttributeError):  # where there is no Linux, `watch` ends it
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
