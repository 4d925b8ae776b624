"""Failures of an estimate, and what it does not know after it started from equilibrium."""

from __future__ import annotations

import math

from denoc_ros.dynamics.state_bounds import StateBounds
from denoc_ros.runtime.status import ERROR, WARN, Status

SETTLED_SHARE = 0.05  # Below this share the missing vibration does not count.


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

    def note_failure(self, cause: str) -> None:
        """Take a state that must not be published; the next report is an error."""
        self.failures += 1
        self._failure = cause

    def note_restart(self, cause: str, now: float, values: int = 0) -> None:
        """Take a restart.

        Parameters
        ----------
        cause : str
        now : float
            s.
        values : int
            Sensors' values that the estimate had taken by then, of all times.
        """
        self._cause, self._begin, self._values = cause, now, values

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

    def worsen(self, status: Status, now: float, values: int = 0, amplitudes: int = 0) -> None:
        """Add failures since the last report, and the missing vibration; see :meth:`missing`."""
        failed, self._reported = self.failures > self._reported, self.failures
        if failed:
            status.worsen(ERROR, f'{self._failure}: not published')
        share = self.missing(now, values, amplitudes)
        if share > 0.0 and self.bounds is not None:
            decay = self.bounds.decay_time
            end = 'until sensors correct it or ~/reset'
            if decay < math.inf:
                left = decay * math.log(share / SETTLED_SHARE)
                end = f'below {100.0 * SETTLED_SHARE:g} % in {left:.3g} s'
            # An error says its cause already.
            cause = '' if failed and self._cause == self._failure else f' ({self._cause})'
            status.worsen(
                WARN,
                f'started from equilibrium {max(now - self._begin, 0.0):.3g} s ago{cause}: up to '
                f'{100.0 * share:.0f} % of the vibration of then is missing, {end}',
            )
