"""A robot that swings and rests in turn under a siege, and the laws of what adapts to its payload.

The predictor's model has another payload than the robot: it has something to find while it is
attacked.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from node_robots import GRAVITY, JOINTS, two_links
from rcl_interfaces.msg import ParameterEvent
from sensor_msgs.msg import JointState
from tracked_runs import simulated, with_noise
from trust.stage import stamp

from denoc_ros.dynamics.robot import load_robot
from denoc_ros.types import Array

PAYLOAD = 'payload.two.mass'
KNOWN, TRUE = 1.0, 1.2  # kg, of the predictor's model and of the robot
BOUNDS = (0.6, 1.8)  # kg
MIDDLE = (0.4, -0.7)  # rad
SIZES = (0.15, -0.2)  # rad
SWINGS = (2, 3)  # of each joint
MOVES, RESTS = 5.0, 7.0  # s
SETTLED = 3.0  # s of rest after which nothing changes
DRIFT = 1e-3  # of the width of the bounds: what rounding may make of a rest
ADOPTED = 10.0  # s within which a predictor has taken over other bounds
ROUNDING = 1e-9


def stiff_arm() -> str:
    """Return the two flexible links with damping that lets them settle within a rest."""
    return two_links().replace('damping_ratio="0.02"', 'damping_ratio="0.2"')


class Swing:
    """What the joints say of a robot that swings and rests, again and again.

    Parameters
    ----------
    rate : float
        Of joint states [Hz].

    Attributes
    ----------
    begin : int
        Of the first swing [ns].
    """

    def __init__(self, rate: float) -> None:
        robot = load_robot(stiff_arm(), gravity=tuple(GRAVITY))
        robot.set_payload('two', TRUE)
        self._rate, self.begin = rate, time.time_ns()
        run = with_noise(simulated(robot, self._motion, MOVES + RESTS, 1.0 / rate))
        self._rows = run.q, run.qd, run.effort

    @staticmethod
    def _motion(t: float) -> tuple[Array, Array, Array]:
        sizes = np.array(SIZES)
        if t >= MOVES:
            return np.array(MIDDLE), np.zeros(2), np.zeros(2)
        rates = 2.0 * np.pi * np.array(SWINGS) / MOVES
        # (1 - cos)^2 / 4 has neither rate nor acceleration at its ends
        c, s = np.cos(rates * t), np.sin(rates * t)
        position = 0.25 * (1.0 - c) ** 2
        rate = 0.5 * rates * (1.0 - c) * s
        acceleration = 0.5 * rates**2 * (s**2 + c - c**2)
        return np.array(MIDDLE) + sizes * position, sizes * rate, sizes * acceleration

    def _phase(self, now_ns: int) -> float:
        return (1e-9 * (now_ns - self.begin)) % (MOVES + RESTS)

    def rested(self, now_ns: int) -> float:
        """Return for how long the robot has been at rest [s]; 0 while it moves."""
        return max(0.0, self._phase(now_ns) - MOVES)

    def state(self, now_ns: int) -> JointState:
        """Return what a good robot says now."""
        q, qd, effort = self._rows
        row = min(int(self._phase(now_ns) * self._rate), len(q) - 1)
        message = JointState(name=list(JOINTS), position=q[row].tolist())
        message.velocity, message.effort = qd[row].tolist(), effort[row].tolist()
        stamp(message, now_ns)
        return message


class Estimates:
    """Holds what the predictor publishes of a payload to its bounds.

    Attributes
    ----------
    count : int
        Messages.
    lowest, highest : float
        Of all values [kg].
    rests : list of float
        The value in each rest that was watched [kg].
    """

    def __init__(self) -> None:
        self.count, self.lowest, self.highest = 0, np.inf, -np.inf
        self.rests: list[float] = []
        self._broken: list[str] = []
        self._seen: list[tuple[float, float]] = []  # perf_counter [s], value: newest
        self._mass = KNOWN
        self.restart()

    def restart(self) -> None:
        """A new process begins with the bounds that it is given."""
        self._mass, self._bounds = KNOWN, [(-np.inf, *BOUNDS)]

    def take_event(self, event: ParameterEvent) -> None:
        """Take over bounds that somebody has asked for."""
        if event.node != '/predictor':
            return
        bounds: tuple[float, ...] = self._bounds[-1][1:]
        for parameter in (*event.new_parameters, *event.changed_parameters):
            if parameter.name == PAYLOAD:
                self._mass = parameter.value.double_value
            if parameter.name == 'adapt_bounds':
                given = tuple(parameter.value.double_array_value)
                bounds = given if len(given) == 2 else ()
        low, high = bounds or (0.5 * self._mass, 1.5 * self._mass)
        if (low, high) != self._bounds[-1][1:]:
            self._bounds.append((time.perf_counter(), low, high))

    def take(self, message: JointState) -> None:
        """Judge a message of `~/model_parameters`."""
        self.count += 1
        said = [*message.position, *message.effort]
        if not np.isfinite(said).all():
            self._broken.append(f'predictor: what it adapts must be finite, got {said}')
        if list(message.name) != [PAYLOAD]:  # somebody asked for others
            return
        now, (value,) = time.perf_counter(), message.position
        while len(self._bounds) > 1 and self._bounds[1][0] < now - ADOPTED:
            del self._bounds[0]
        low = min(each[1] for each in self._bounds)
        high = max(each[2] for each in self._bounds)
        if not low - ROUNDING <= value <= high + ROUNDING:
            self._broken.append(
                f'predictor: {PAYLOAD} must be within {low:g} to {high:g} kg, got {value!r}'
            )
        self.lowest, self.highest = min(self.lowest, value), max(self.highest, value)
        self._seen = [*self._seen[-400:], (now, value)]

    def judge_rest(self, begin: float) -> None:
        """Hold the values since a moment (perf_counter, s), in which nothing moved, to stay."""
        values = [value for at, value in self._seen if at > begin]
        if not values:
            self._broken.append('predictor: must say at rest what it adapts, got nothing')
            return
        self.rests.append(values[-1])
        change = max(values) - min(values)
        if change > DRIFT * (BOUNDS[1] - BOUNDS[0]):
            self._broken.append(
                f'predictor: {PAYLOAD} must not drift at rest, got {change:g} kg of {values[-1]:g}'
            )

    def told(self) -> list[str]:
        """Return the broken laws since the last call."""
        broken, self._broken = self._broken, []
        return broken

    def summary(self) -> dict[str, float | Sequence[float]]:
        """Return what was published."""
        return {
            'messages': self.count,
            'lowest': self.lowest,
            'highest': self.highest,
            'at_rest': self.rests,
        }
