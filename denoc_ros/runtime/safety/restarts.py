"""Failures of an estimate, and what it does not know after it started from equilibrium."""

from __future__ import annotations

import math

import numpy as np

from denoc_ros.dynamics.elastic.deflection import TipDeflections
from denoc_ros.dynamics.elastic.state_bounds import StateBounds
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import DenocError
from denoc_ros.runtime.loop.status import ERROR, WARN, Status
from denoc_ros.types import Array

SETTLED_SHARE = 0.05  # Below this share the missing vibration does not count.
State = tuple[Array, Array]  # coordinates and rates (n,)


class Restarts:
    """Owns cause and end of the time in which an estimate misses the robot's vibration.

    An estimate that starts again begins in equilibrium, while the robot vibrates as before. The
    difference decays as the robot's slowest vibration does, unless sensors correct it earlier.

    Parameters
    ----------
    bounds : StateBounds or None
        Of the model, with its period and decay time; None: nothing vibrates in it.

    Attributes
    ----------
    failures : int
        States that the robot cannot have, and models that could not go on.
    """

    def __init__(self, bounds: StateBounds | None) -> None:
        self.bounds = bounds
        self.failures = 0
        self._failure, self._reported = '', 0
        self.clear()

    def clear(self) -> None:
        """Forget the last restart; failures that were not reported stay."""
        self._cause, self._begin, self._values = '', -math.inf, 0
        self._state: State | None = None
        self._keeps_state, self._size = False, math.nan

    def note_failure(self, cause: str) -> None:
        """Take a state that must not be published; the next report is an error."""
        self.failures += 1
        self._failure = cause

    def note_restart(
        self,
        cause: str,
        now: float,
        values: int = 0,
        state: State | None = None,
        keeps_state: bool = False,
    ) -> None:
        """Take a restart.

        Parameters
        ----------
        cause : str
        now : float
            s.
        values : int
            Sensors' values that the estimate had taken by then, of all times.
        state : pair of (n,) arrays, optional
            Coordinates and rates of the last estimate, from which the error follows.
        keeps_state : bool
            Whether the estimate goes on from that state after a time without measurements.
        """
        self._cause, self._begin, self._values = cause, now, values
        self._state, self._keeps_state, self._size = state, keeps_state, math.nan

    def missing(self, now: float, values: int = 0, amplitudes: int = 0) -> float:
        """Return the largest share of the vibration that the estimate still misses.

        It is 0 once sensors have corrected the estimate for a period of the slowest vibration,
        with at least as many values as there are amplitudes.

        Parameters
        ----------
        now : float
            s.
        values, amplitudes : int
            Sensors' values that the estimate has taken, of all times; amplitudes of the model.
        """
        bounds, age = self.bounds, max(now - self._begin, 0.0)
        if not self._cause or bounds is None:
            return 0.0
        corrected = values - self._values >= max(amplitudes, 1) and age >= bounds.longest_period
        share = math.exp(-age / bounds.decay_time) if bounds.decay_time > 0.0 else 0.0
        if corrected or share < SETTLED_SHARE:
            self.clear()
            return 0.0
        return share

    def worsen(
        self,
        status: Status,
        now: float,
        values: int = 0,
        amplitudes: int = 0,
        robot: Robot | None = None,
    ) -> None:
        """Add failures since the last report, and the missing vibration; see :meth:`missing`.

        `robot`, of which a copy is used, turns the state of a restart into its error [m].
        """
        failed, self._reported = self.failures > self._reported, self.failures
        if failed:
            status.worsen(ERROR, f'{self._failure}: not published')
        share = self.missing(now, values, amplitudes)
        if not share or self.bounds is None:
            return
        decay = self.bounds.decay_time
        end = 'until sensors correct it or ~/reset'
        if decay < math.inf:
            left = decay * math.log(share / SETTLED_SHARE)
            end = f'below {100.0 * SETTLED_SHARE:g} % in {left:.3g} s'
        # An error says its cause already.
        cause = '' if failed and self._cause == self._failure else f' ({self._cause})'
        age = max(now - self._begin, 0.0)
        begins = 'went on after a gap' if self._keeps_state else 'started from equilibrium'
        missing = f'up to {100.0 * share:.0f} % of the vibration of then is missing'
        if self._state is not None and robot is not None:
            if math.isnan(self._size):
                self._size = lost_vibration(robot.copy(), self._state, self._keeps_state)
            status.values['expected_error_m'] = share * self._size
            missing += f', an expected error of {share * self._size:.2g} m'
        status.worsen(WARN, f'{begins} {age:.3g} s ago{cause}: {missing}, {end}')


def lost_vibration(robot: Robot, state: State, keeps_state: bool) -> float:
    """Return the amplitude [m] of the tips' vibration that an estimate lost.

    Parameters
    ----------
    robot : Robot
        Its workspace is used.
    state : pair of (n,) arrays
        Coordinates and rates of the last estimate.
    keeps_state : bool
        Whether the estimate goes on from this state; else it starts from equilibrium.
    """
    q, qd = state
    try:
        still = robot.static_deflection(q[robot.joint_indices])
        omega = 2.0 * math.pi * robot.natural_frequencies(still)
    except DenocError:  # Buckled, or of another kind: all of the deflection may be lost.
        still, omega = q.copy(), np.zeros(0)
        still[robot.flexible_indices] = 0.0
    deflections = TipDeflections(robot)
    offset, rate = (np.array(each) for each in deflections.evaluate(q, qd))
    offset -= deflections.evaluate(still, np.zeros(robot.n))[0]
    links = len(deflections.links)
    # Of the six parts of each link, the first three are displacements.
    parts = [row.reshape(links, 6)[:, :3] for row in (offset, rate)]
    moved, speed = (float(np.linalg.norm(part, axis=1).max(initial=0.0)) for part in parts)
    slowest = float(omega[omega > 0.0].min(initial=math.inf))
    size = math.hypot(moved, speed / slowest)
    # Two vibrations of one size may have any difference of phase.
    return math.sqrt(2.0) * size if keeps_state else size
