"""Model-error estimate from the filter's innovations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from denoc_ros.control.feedback_design import PostureGains
from denoc_ros.control.gain_schedule import GainSchedule
from denoc_ros.control.model_errors import ModelErrors, terms, terms_rate
from denoc_ros.types import Array

LIKELY = 0.2  # standard deviation of an error before anything is measured
LARGEST = 0.4  # error that is believed
TRUST = 0.3  # the innovations' spread counts so much: the filter allows for more than is true
# in its place, where robots have modes beyond the design: what no error explains, and for how
# long [s] that stays alike, and over which time its size is averaged
ALIKE, AVERAGED = 0.1, 1.0
GATE = 4.0  # of the innovations' spread: beyond it something else was at work
QUIET = 0.3  # s after a pause of the loop in which its trace is not taken for an error's
DOUBT = 1.0  # standard deviations within which a combination of errors may well be none
SMOOTH = 0.03  # s over which an error comes in
WALK = 0.01  # standard deviation of what an error changes within a second


class ErrorEstimate:
    """Errors of the model along a plan, and the plan of the robot that has them.

    The filter of deviations takes the robot for one with the errors `used`, on that robot's plan,
    its tip where it was: deviations stay small however wrong the model is. The filter is then off
    by `seen` @ (errors - used), whatever the deviations are, and its innovations show the errors.
    Filter, gains and the proof of their stability stay as they are.

    What the innovations have beyond the errors' own uncertainty no error explains: noise, a gauge
    that sticks, a beam that bends otherwise. It counts as noise: nothing is learned of it.

    Parameters
    ----------
    schedule : GainSchedule
        With errors.

    Attributes
    ----------
    values : (errors,) array
        As estimated: of each beam's (spring's) compliance, then of the load.
    used : (errors,) array
        On which plan and filter rely: their independent combinations that are beyond their
        standard deviations, followed smoothly.
    seen : (e, errors) array
        How far the filter's estimate is from the truth, by unit errors.

    Notes
    -----
    Two-stage estimation of a constant bias: B. Friedland, Treatment of bias in recursive
    filtering, IEEE Transactions on Automatic Control 14 (1969). Noise from the innovations: R. K.
    Mehra, On the identification of variances and adaptive Kalman filtering, same 15 (1970).
    """

    def __init__(self, schedule: GainSchedule) -> None:
        assert schedule.errors is not None
        self._errors: ModelErrors = schedule.errors
        self._period = schedule.settings.period
        self.values, self.used = np.zeros((2, self._errors.count))
        self.seen: Array = np.zeros((len(schedule.gains[0].transition), self._errors.count))
        self._covariance: Array = LIKELY**2 * np.eye(self._errors.count)
        self._quiet = -np.inf
        self._unexplained = np.square(self._errors.noise)
        # at rest errors show no more: what is seen then is noise
        self._end = (len(self._errors.states) - 1) * self._errors.step
        self._states = np.zeros(self._errors.states.shape[1:])
        self._torques = np.zeros(self._errors.torques.shape[1:])

    def reset(self) -> None:
        """Forget the errors."""
        self.values[:] = self.used[:] = 0.0
        self._covariance = LIKELY**2 * np.eye(len(self.values))
        self._unexplained[:] = np.square(self._errors.noise)
        self.forget_deviations()

    def forget_deviations(self) -> None:
        """Take note that the filter has started anew from measurements."""
        self.seen[:] = 0.0

    def adopt(self, other: ErrorEstimate | None) -> None:
        """Go on with the values of another estimate of the same errors."""
        if other is not None and other.seen.shape == self.seen.shape:
            self.values[:], self.used[:], self.seen[:] = other.values, other.used, other.seen
            self._covariance, self._unexplained = other._covariance, other._unexplained

    def learns(self, time: float) -> bool:
        """Say whether a time of the plan [s] is one in which the errors show."""
        return 0.0 < time < self._end

    def doubt(self, time: float) -> None:
        """Learn nothing for a while from a time of the plan [s] on: the torque was not as told."""
        self._quiet = time + QUIET

    def correct(
        self, gains: PostureGains, innovation: Array, at: NDArray[np.intp], time: float
    ) -> None:
        """Learn from the innovations of the filter at some places, at a time of the plan [s]."""
        if not self._quiet <= time <= self._end or not len(at):
            return
        expected = gains.measured[at] @ self.seen
        left = innovation[at] - expected @ (self.values - self.used)
        if (np.abs(left) > GATE * gains.spread[at]).any():
            self.doubt(time)
            return
        across = self._covariance @ expected.T
        known = expected @ across
        noise = np.square(TRUST * gains.spread[at])
        if len(self._unexplained):
            beyond = np.maximum(left**2 - np.diag(known), 0.0)
            self._unexplained[at] += self._period / AVERAGED * (beyond - self._unexplained[at])
            noise = ALIKE / self._period * self._unexplained[at]
        gain = np.linalg.solve(known + np.diag(noise), across.T).T
        self.values += gain @ left
        np.clip(self.values, -LARGEST, LARGEST, out=self.values)
        self._covariance = self._covariance - gain @ across.T

    def follow(self, gains: PostureGains, correction: Array, at: NDArray[np.intp]) -> None:
        """Take note that the filter has corrected its estimate by the innovations at places."""
        self.seen -= correction[:, at] @ (gains.measured[at] @ self.seen)

    def go_on(self, gains: PostureGains, state: Array, time: float) -> Array:
        """Go on by a period from a time of the plan [s].

        A robot with the errors stays on its own plan under its torque.

        Parameters
        ----------
        gains : PostureGains
        state : (e,) array
            Of the filter; changed to that under the plan's torque.
        time : float

        Returns
        -------
        (2 m,) array
            What the torque of the errors `used` does to the deviations.
        """
        held = gains.push.reshape(len(gains.push), -1, len(self._torques)).sum(axis=1)
        s, rates = len(held), terms_rate(self.used)
        states, torques = self._plan(time)
        pushed = held @ torques
        away = gains.transition[:, :s] @ states
        away[:s] += pushed
        self.seen = gains.transition @ self.seen - away @ rates
        state -= away @ terms(self.used)
        states, _ = self._plan(time + self._period)
        self.seen[:s] += states @ rates
        state[:s] += states @ terms(self.used)
        self._covariance += WALK**2 * self._period * np.eye(len(self.values))
        believed = self.values
        if len(self._unexplained):
            variances, ways = np.linalg.eigh(self._covariance)
            along, doubt = ways.T @ self.values, DOUBT**2 * variances
            believed = ways @ (along * (1.0 - doubt / np.maximum(along**2, doubt)))
        change = self._period / (self._period + SMOOTH) * (believed - self.used)
        self.used += change
        state += self.seen @ change
        return np.asarray(pushed @ terms(self.used))

    def state(self, time: float) -> Array:
        """Return what the errors used change of the plan's deviations (2 m,) at a time of it."""
        return np.asarray(self._plan(time)[0] @ terms(self.used))

    def torque(self, time: float) -> Array:
        """Return what the errors used change of the plan's torque (joints,) at a time of it."""
        return np.asarray(self._plan(time)[1] @ terms(self.used))

    def _plan(self, time: float) -> tuple[Array, Array]:
        """Return what terms of errors change of the plan's states and torque at a time of it."""
        errors = self._errors
        return (
            errors.between(errors.states, time, self._states),
            errors.between(errors.torques, time, self._torques),
        )
