"""Expected error of an estimate that had a break while the links may vibrate."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from denoc_ros.dynamics.deflection import TipDeflections
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import DenocError
from denoc_ros.runtime.status import WARN, Status
from denoc_ros.types import Array

NEGLIGIBLE_SHARE = 0.01  # A smaller share of the first error needs no warning.


@dataclass(frozen=True)
class Restart:
    """A break in the estimate at a time [s]."""

    time: float
    state: tuple[Array, Array]  # coordinates and rates (n,) of the last estimate
    kept: bool  # The estimate goes on from this state; else it starts from equilibrium.


class RemainingError:
    """Vibration that the estimate lost in its last restart, and how much of it is left.

    Attributes
    ----------
    restart : Restart or None
        The last one whose vibration has not decayed.
    """

    def __init__(self) -> None:
        self.restart: Restart | None = None
        self._judged: Restart | None = None
        self._size = self._time_constant = 0.0

    def warn(self, status: Status, robot: Robot, now: float) -> None:
        """Have a status warn until the vibration has decayed; the robot's workspace is used."""
        restart = self.restart
        if restart is None:
            return
        if restart is not self._judged:
            self._judge(restart, robot)
            self._judged = restart
        age = max(0.0, now - restart.time)
        share = math.exp(-age / self._time_constant)
        if share < NEGLIGIBLE_SHARE or self._size == 0.0:
            self.restart = None
            return
        status.values['expected_error_m'] = share * self._size
        status.worsen(
            WARN,
            f'the estimate started again {age:.1f} s ago: its expected error '
            f'is {share * self._size:.2g} m, with a time constant of {self._time_constant:.2g} s',
        )

    def _judge(self, restart: Restart, robot: Robot) -> None:
        """Find the amplitude of the lost vibration [m], and its time constant [s]."""
        q, qd = restart.state
        try:
            still = robot.static_deflection(q[robot.joint_indices])
        except DenocError:  # Buckled, or of another kind: all of the deflection may be lost.
            still = q.copy()
            still[robot.flexible_indices] = 0.0
        frequency, self._time_constant = _slowest(robot, still)
        deflections = TipDeflections(robot)
        offset, rate = (np.array(each) for each in deflections.evaluate(q, qd))
        offset -= deflections.evaluate(still, np.zeros(robot.n))[0]
        links = len(deflections.links)
        # Of the six parts of each link, the first three are displacements.
        parts = [row.reshape(links, 6)[:, :3] for row in (offset, rate)]
        moved, speed = (float(np.linalg.norm(part, axis=1).max(initial=0.0)) for part in parts)
        self._size = math.hypot(moved, speed / frequency) if frequency else moved
        if restart.kept:  # Two vibrations of one size, with any difference of phase.
            self._size *= math.sqrt(2.0)


def _slowest(robot: Robot, q: Array) -> tuple[float, float]:
    """Return the lowest angular frequency [rad/s] and the longest time constant [s] of modes."""
    try:
        modes = robot.natural_modes(q)
    except DenocError:  # No linearization there: the vibration is taken to stay.
        return 0.0, math.inf
    omega = 2.0 * math.pi * modes.frequencies
    moving = omega > 0.0
    if not moving.any():
        return 0.0, math.inf
    decay = float((modes.damping_ratios * omega)[moving].min())
    return float(omega[moving].min()), 1.0 / decay if decay > 0.0 else math.inf
