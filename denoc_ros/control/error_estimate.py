"""Model-error estimate from the filter's innovations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from denoc_ros.control.feedback_design import PostureGains
from denoc_ros.control.gain_schedule import GainSchedule
from denoc_ros.control.model_errors import ModelErrors, drive, terms
from denoc_ros.types import Array

LIKELY = 0.2  # standard deviation of an error before anything is measured
LARGEST = 0.4  # error that is believed
# factor of the noise: it stays alike over many periods in the estimate, as do modes that nobody
# knows
COLOURED = 3.0
GATE = 4.0  # of the innovations' spread: beyond it something else was at work
QUIET = 0.3  # s after a pause of the loop in which its trace is not taken for an error's
DOUBT = 1.0  # standard deviations within which an error may well be none
SMOOTH = 0.1  # s over which an error comes in
# share of the further modes of the design that a robot shows, and its standard deviation: the
# model has none of them, a beam has all
FURTHER = 0.5
WALK = 0.01  # standard deviation of what an error changes within a second


class ErrorEstimate:
    """Errors of the model along a plan, and the plan of the robot that has them.

    A filter of deviations that is off by `seen` @ (errors - values), whatever the deviations are,
    has innovations which show the errors. The plan then follows: that of a robot with the errors
    `used`, its tip where it was. Deviations are from that plan, so they stay small however wrong
    the model is; filter, gains and the proof of their stability stay as they are. What is not
    `used` is left out of the filter's estimate, too: an error that may be none moves nothing.

    The measured values of the plan are between those of the model and those of the design's
    robot, which has more modes. Where is estimated with the errors: a gauge near a beam's root
    shows the difference, which would otherwise be taken for an error of compliance.

    Parameters
    ----------
    schedule : GainSchedule
        With errors.

    Attributes
    ----------
    values : (errors,) array
        As estimated: of each beam's (spring's) compliance, then of the load.
    used : (errors,) array
        On which the plan relies: those beyond their standard deviation, followed smoothly.
    further : float
        Share of the further modes of the design that the robot shows.
    seen : (e, errors + 1) array
        How far the estimate is from the truth, by unit errors and by `further`.

    Notes
    -----
    Two-stage estimation of a constant bias: B. Friedland, Treatment of bias in recursive
    filtering, IEEE Transactions on Automatic Control 14 (1969).
    """

    def __init__(self, schedule: GainSchedule) -> None:
        assert schedule.errors is not None
        self._errors: ModelErrors = schedule.errors
        self._period = schedule.settings.period
        count = self._errors.count
        self.values, self.used = np.zeros((2, count))
        self.further = FURTHER
        self.seen: Array = np.zeros((len(schedule.gains[0].transition), count + 1))
        self._covariance = self._unknown()
        self._quiet = -np.inf
        self._variance = np.square(COLOURED * self._errors.noise)
        # at rest errors show no more: what is seen then is noise
        self._end = (len(self._errors.states) - 1) * self._errors.step
        self._states = np.zeros(self._errors.states.shape[1:])
        self._torques = np.zeros(self._errors.torques.shape[1:])
        self._values = np.zeros(self._errors.measured.shape[1:])
        self._added = np.zeros(self._errors.accelerations.shape[1:])

    def reset(self) -> None:
        """Forget the errors."""
        self.values[:] = self.used[:] = 0.0
        self.further = FURTHER
        self._covariance = self._unknown()
        self.forget_deviations()

    def _unknown(self) -> Array:
        """Return the covariance before anything is measured."""
        return np.diag(np.append(np.full(len(self.values), LIKELY**2), FURTHER**2))

    def forget_deviations(self) -> None:
        """Take note that the filter has started anew from measurements."""
        self.seen[:] = 0.0

    def adopt(self, other: ErrorEstimate | None) -> None:
        """Go on with the values of another estimate of the same errors."""
        if other is not None and other.seen.shape == self.seen.shape:
            self.values[:], self.used[:], self.seen[:] = other.values, other.used, other.seen
            self.further, self._covariance = other.further, other._covariance

    def doubt(self, time: float) -> None:
        """Learn nothing for a while from a time of the plan [s] on: the torque was not as told."""
        self._quiet = time + QUIET

    def correct(
        self, gains: PostureGains, innovation: Array, at: NDArray[np.intp], time: float
    ) -> tuple[Array, Array] | None:
        """Learn from the innovations of the filter at some places, at a time of the plan [s].

        Returns what that changes of the filter's estimate (e,), and of the values (measured,)
        that are expected; None: nothing.
        """
        if not self._quiet <= time <= self._end or not len(at):
            return None
        shown = self._errors.between(self._errors.measured, time, self._values)
        expected = gains.measured[at] @ self.seen
        expected[:, -1] += shown[at]
        if (np.abs(innovation[at]) > GATE * gains.spread[at]).any():
            self.doubt(time)
            return None
        across = self._covariance @ expected.T
        noise = np.diag(self._variance[at])
        gain = np.linalg.solve(expected @ across + noise, across.T).T
        before = np.append(self.values, self.further)
        after = before + gain @ innovation[at]
        self.values[:] = np.clip(after[:-1], -LARGEST, LARGEST)
        self.further = after[-1] = min(max(float(after[-1]), 0.0), 2.0 * FURTHER)
        after[:-1] = self.values
        self._covariance = self._covariance - gain @ across.T
        change = self.seen @ (after - before)
        return change, gains.measured @ change + (after[-1] - before[-1]) * shown

    def follow(self, gains: PostureGains, correction: Array, at: NDArray[np.intp]) -> None:
        """Take note that the filter has corrected its estimate by the innovations at places."""
        expected = gains.measured[at] @ self.seen
        expected[:, -1] += self._values[at]
        self.seen -= correction[:, at] @ expected

    def go_on(self, gains: PostureGains, time: float) -> None:
        """Go on by a period from a time of the plan [s]."""
        errors, count = self._errors, len(self.values)
        rows = errors.between(errors.accelerations, time, self._added)
        added = rows[:, :count] + np.einsum(
            'mpe,p->me', rows[:, count:].reshape(len(rows), count, count), self.values
        )
        self.seen = gains.transition @ self.seen
        self.seen[:, :count] += drive(added, self._period, len(self.seen))
        self._covariance[:count, :count] += WALK**2 * self._period * np.eye(count)
        doubt = DOUBT**2 * np.diag(self._covariance)[:count]
        believed = self.values * np.maximum(0.0, 1.0 - doubt / np.maximum(self.values**2, doubt))
        self.used += self._period / (self._period + SMOOTH) * (believed - self.used)

    def doubtful(self) -> Array:
        """Return what errors that are not used have done to the filter's estimate (e,)."""
        return np.asarray(self.seen[:, :-1] @ (self.values - self.used))

    def state(self, time: float, errors: Array) -> Array:
        """Return what errors change of the plan's deviations (2 m,) at a time of it [s]."""
        rows = self._errors.between(self._errors.states, time, self._states)
        return np.asarray(rows @ terms(errors))

    def measured(self, time: float) -> Array:
        """Return what further modes add to the plan's measured values (measured,)."""
        return self.further * self._errors.between(self._errors.measured, time, self._values)

    def torque(self, time: float, errors: Array) -> Array:
        """Return what errors change of the plan's torque (joints,) at a time of it [s]."""
        rows = self._errors.between(self._errors.torques, time, self._torques)
        return np.asarray(rows[:, 0] + rows[:, 1:] @ terms(errors))
