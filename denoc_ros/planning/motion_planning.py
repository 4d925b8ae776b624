"""The queue of whole motions through the planner, one at a time."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from denoc_ros.dynamics.driven.driven_joints import DrivenJoints
from denoc_ros.dynamics.driven.joint_limits import joint_limits
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import StateError
from denoc_ros.model.mode_table import ModeTable, read_mode_table
from denoc_ros.model.numbers import FAMILIES
from denoc_ros.planning.shaper_parameters import OF_STREAMS
from denoc_ros.planning.shapers.joint_servo import joint_servo
from denoc_ros.planning.shapers.ringing import require_flexible
from denoc_ros.planning.timing.limit_rows import JOINTS
from denoc_ros.runtime.inputs.input_monitor import InputError
from denoc_ros.runtime.inputs.trajectory_messages import RequestedMotion
from denoc_ros.runtime.parameters.parameter_table import Settings
from denoc_ros.runtime.worker.worker import Answer, Planner
from denoc_ros.trajectories import KNOTS
from denoc_ros.types import Array

LOADING = 300.0  # s: a cold kernel cache compiles on a slow machine
LOOK = 0.01  # s between looks for an answer that is waited for
FASTEST = ('tip', 'rest_to_rest')


class MotionPlanning:
    """Keeps a motion until the planner has it, and the planner alive.

    Attributes
    ----------
    load_error : str
        Why the planner could not load the robot; '' where it could.
    """

    def __init__(
        self, log: Callable[[str], None], done: Callable[[RequestedMotion, Answer], None]
    ) -> None:
        self.planner = Planner()
        self.load_error = ''
        self._log, self._done = log, done
        self._waiting: RequestedMotion | None = None
        self._solving: RequestedMotion | None = None
        self.loading = False
        self._joints: Sequence[str] = ()
        self._posture: Array = np.zeros(0)

    @property
    def busy(self) -> bool:
        """Whether a motion waits for its plan."""
        return self._waiting is not None or self._solving is not None

    def load(self, job: dict[str, Any], posture: Array, patience: float = 0.0) -> None:
        """Start the planner with a robot and a method, whose kernels compile before a motion.

        A planner that takes longer than `patience` goes on beside, motions wait for it. What is
        wrong is in `load_error`.

        Parameters
        ----------
        job : dict
            As of :func:`shape_job`, with the driven joints in the order of motions.
        posture : (n,) array
            Near which the loops of a motion's first row close.
        patience : float
            s to wait until it has loaded it.
        """
        self._joints, self._posture = job['joints'], posture
        self.planner.close()
        self._start(job)
        end = time.perf_counter() + patience
        while self.loading and time.perf_counter() < end:
            time.sleep(LOOK)
            self._poll()

    def _start(self, job: dict[str, Any]) -> bool:
        """Start the planner, if it may be started; say whether it was."""
        if not self.planner.start():
            return False
        self.loading = True
        self.planner.submit({**job, 'job': 'load'}, {'posture': self._posture}, LOADING)
        return True

    def take(self, motion: RequestedMotion) -> None:
        """Keep a motion for the planner; there must be no other."""
        self._waiting = motion

    def drop(self) -> None:
        """Forget the motion that waits for its plan."""
        self._waiting = self._solving = None
        if not self.loading:
            self.planner.drop()

    def look(self, settings: Settings, robot: dict[str, Any]) -> None:
        """Take the planner's answer, start it anew where it died, hand it the next motion."""
        planner = self.planner
        self._poll()
        if not planner.running and self._start(shape_job(settings, robot, self._joints)):
            self._log('the planner is started anew')
        if self._waiting is not None and planner.running and not planner.busy:
            motion, self._waiting = self._waiting, None
            try:
                knots = motion.trajectory().knots()
            except InputError as error:
                self._done(motion, Answer(0, str(error), {}, {}))
                return
            self._solving = motion
            job = shape_job(settings, robot, self._joints)
            arrays = dict(zip(KNOTS, knots, strict=True), posture=self._posture)
            planner.submit(job, arrays, settings.number('solve_timeout'))

    def _poll(self) -> None:
        answer = self.planner.poll()
        if answer is None:
            return
        motion, self._solving = self._solving, None
        if self.loading:
            self.loading = False
            self.load_error = answer.error
            if answer.error:
                self._log(f'the planner must load the robot, got: {answer.error}')
        elif motion is not None:
            self._done(motion, answer)


def shape_job(settings: Settings, robot: dict[str, Any], joints: Sequence[str]) -> dict[str, Any]:
    """Return the planner's job without the motion of the joints."""
    method = settings.text('method')
    limits = given_limits(settings, joints)
    options: dict[str, Any] = {'output_step': settings.number('output_step')}
    if method == 'tip':
        options.update(limits, joints=list(joints))
    else:
        options.update(limits, modes=settings.integer('modes') or None)
    if settings.flag('fastest') and method in FASTEST:
        options.update(time='minimum', margin=settings.number('margin'))
    elif method == 'rest_to_rest':
        options['robustness'] = settings.number('robustness')
    if method == 'rest_to_rest':
        options['radius'] = settings.number('radius') or None
    if method in OF_STREAMS and settings.text('mode_table'):
        options['mode_table'] = settings.text('mode_table')
    return {
        'job': 'shape',
        'robot': robot,
        'method': method,
        'tip': settings.text('tip'),
        'base': settings.text('base'),
        'joints': list(joints),
        'options': options,
        'limits': limits,
        'servo': servo_columns(settings),
    }


def robot_job(settings: Settings, description: str) -> dict[str, Any]:
    """Job of the planner's process."""
    return {
        'source': settings.text('urdf_path') or description,
        'gravity': settings.numbers('gravity'),
        'geometric_stiffness': settings.flag('geometric_stiffness'),
        'overrides': settings.family(*FAMILIES),
    }


def mode_table(settings: Settings) -> ModeTable | None:
    """Return the measured modes that a file has; None where none is named."""
    path = settings.text('mode_table')
    return read_mode_table(path) if path else None


def check_planning(
    robot: Robot, joints: Sequence[str], settings: Settings, table: ModeTable | None = None
) -> None:
    """Refuse limits and servos that do not fit the joints, and impossible methods."""
    method, tip = settings.text('method'), settings.text('tip')
    if table is None:
        require_flexible(robot)
    elif method in OF_STREAMS:
        table.at(robot.joint_names, np.zeros(len(robot.joint_names)))
    else:
        raise StateError(
            f"parameter 'mode_table' must stand beside method {', '.join(OF_STREAMS)}, "
            f'got {method}'
        )
    if method == 'tip':
        if tip:
            robot.frame_pose(tip, np.zeros(robot.n))
    else:
        DrivenJoints(robot, f'the shaper node with method {method}')
    if not robot.tree.loops and set(joints) != set(robot.tree.non_mimic_joints):
        rule = "parameter 'joints' must name all joints of a robot without loops"
        raise StateError(f'{rule}, {list(robot.tree.non_mimic_joints)}, got {list(joints)}')
    joint_limits(robot, **given_limits(settings, joints))
    joint_servo(len(joints), **servo_columns(settings))


def given_limits(settings: Settings, joints: Sequence[str]) -> dict[str, dict[str, float] | float]:
    """Return the limits that are given: one number for all joints, or each joint's."""
    found: dict[str, dict[str, float] | float] = {}
    for what in JOINTS:
        values = settings.numbers(f'limits.{what}')
        if len(values) == 1:
            found[what] = values[0]
        elif values:
            if len(values) != len(joints):
                raise StateError(
                    f'limits: {what} must have one element, or one for each of {len(joints)} '
                    f'joints, got {len(values)}'
                )
            found[what] = dict(zip(joints, values, strict=True))
    return found


def servo_columns(settings: Settings) -> dict[str, list[float]]:
    """Settings of the joints' servos, as `joint_servo` takes them."""
    found = {
        'damping': settings.numbers('servo.damping') or [1.0],
        'delay': settings.numbers('servo.delay') or [0.0],
    }
    bandwidth = settings.numbers('servo.bandwidth')
    return {**found, 'bandwidth': bandwidth} if bandwidth else found
