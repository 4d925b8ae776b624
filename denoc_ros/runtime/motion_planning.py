"""The queue of whole motions through the planner, one at a time."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from denoc_ros.errors import ConfigError
from denoc_ros.runtime.input_error import InputError
from denoc_ros.runtime.motion_samples import RequestedMotion
from denoc_ros.runtime.parameters import Settings
from denoc_ros.runtime.planner import Answer, Planner

LOADING = 120.0  # s: a cold kernel cache compiles on a slow machine
LIMITS = ('velocity', 'acceleration', 'jerk', 'effort')


class MotionPlanning:
    """Keeps a motion until the planner has it, and the planner alive.

    Parameters
    ----------
    log : callable
        Takes what is to be logged.
    done : callable
        Takes a motion and the planner's answer.

    Attributes
    ----------
    planner : Planner
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
        self._loading = False

    @property
    def busy(self) -> bool:
        """Whether a motion waits for its plan."""
        return self._waiting is not None or self._solving is not None

    def load(self, robot: dict[str, Any], where: str) -> None:
        """Start the planner with a robot, so that the first motion does not wait for it.

        Raises
        ------
        ConfigError
            It cannot load it.
        """
        self.planner.close()
        self.planner.start()
        self.planner.submit({'job': 'load', 'robot': robot}, {}, LOADING)
        while (answer := self.planner.poll()) is None:
            time.sleep(0.01)
        self.load_error = answer.error
        if answer.error:
            raise ConfigError(where, [f'the planner must load the robot, got: {answer.error}'])

    def take(self, motion: RequestedMotion) -> None:
        """Keep a motion for the planner; there must be no other."""
        self._waiting = motion

    def drop(self) -> None:
        """Forget the motion that waits for its plan."""
        self._waiting = self._solving = None
        if not self._loading:
            self.planner.drop()

    def look(self, settings: Settings, robot: dict[str, Any]) -> None:
        """Take the planner's answer, start it anew where it died, hand it the next motion."""
        planner = self.planner
        answer = planner.poll()
        if answer is not None:
            self._take(answer)
        if planner.pid is None and planner.start():
            self._log('the planner is started anew')
            self._loading = True
            planner.submit({'job': 'load', 'robot': robot}, {}, LOADING)
        if self._waiting is not None and planner.pid is not None and not planner.busy:
            motion, self._waiting = self._waiting, None
            try:
                t, q = motion.samples()
            except InputError as error:
                self._done(motion, Answer(0, str(error), {}, {}))
                return
            self._solving = motion
            job = shape_job(settings, robot)
            planner.submit(job, {'t': t, 'q': q}, settings.number('solve_timeout'))

    def _take(self, answer: Answer) -> None:
        motion, self._solving = self._solving, None
        if self._loading:
            self._loading = False
            self.load_error = answer.error
            if answer.error:
                self._log(f'the planner must load the robot, got: {answer.error}')
        elif motion is not None:
            self._done(motion, answer)


def shape_job(settings: Settings, robot: dict[str, Any]) -> dict[str, Any]:
    """Return what the planner is asked for, but for the motion."""
    method = settings.text('method')
    limits = given_limits(settings)
    options: dict[str, Any] = {'output_step': settings.number('output_step')}
    if method == 'tip':
        options.update({what: limit for what, limit in limits.items() if what != 'jerk'})
    else:
        options.update(limits, modes=settings.integer('modes') or None)
    if method == 'rest_to_rest':
        options['robustness'] = settings.number('robustness')
    return {
        'job': 'shape',
        'robot': robot,
        'method': method,
        'tip': settings.text('tip'),
        'options': options,
        'limits': limits,
        'servo': servo_columns(settings),
    }


def given_limits(settings: Settings) -> dict[str, list[float] | float]:
    """Return the limits that are given: one number for all joints, or one for each."""
    found: dict[str, list[float] | float] = {}
    for what in LIMITS:
        values = settings.numbers(f'limits.{what}')
        if values:
            found[what] = values if len(values) > 1 else values[0]
    return found


def servo_columns(settings: Settings) -> dict[str, list[float]]:
    """Return what is known of the joints' servos, as `joint_servo` takes it."""
    found = {
        'damping': settings.numbers('servo.damping') or [1.0],
        'delay': settings.numbers('servo.delay') or [0.0],
    }
    bandwidth = settings.numbers('servo.bandwidth')
    return {**found, 'bandwidth': bandwidth} if bandwidth else found
