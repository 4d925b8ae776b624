"""Model-error estimate from the filter's innovations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from denoc_ros.control.feedback_design import PostureGains
from denoc_ros.control.gain_schedule import GainSchedule
from denoc_ros.control.model_errors import ModelErrors, drive
from denoc_ros.types import Array

LIKELY = 0.2  # standard deviation of an error before anything is measured
LARGEST = 0.4  # error that is believed
TRUST = 0.3  # the innovations' spread counts so much: the filter allows for more than is true
# in its place, where robots have modes beyond the design: factors of the noise of joints and of
# sensors. Noise in the estimate, and modes that nobody knows, stay alike over many periods
COLOURED = 3.0, 10.0
GATE = 4.0  # of the innovations' spread: beyond it something else was at work
QUIET = 0.3  # s after a pause of the loop in which its trace is not taken for an error's
DOUBT = 1.0  # standard deviations within which an error may well be none
SMOOTH = 0.2  # s over which an error comes in
WALK = 0.01  # standard deviation of what an error changes within a second


class ErrorEstimate:
    """Errors of the model along a plan, one for each beam's stiffness and the load.

    A filter of deviations that does not know of the errors is off by `seen` @ values, whatever
    the deviations are; so are its innovations, which show the values. Torque and estimate then
    take the values into account, and the filter and the proof of its stability stay as they are.

    Parameters
    ----------
    schedule : GainSchedule
        With errors.

    Attributes
    ----------
    values : (errors,) array
        As estimated.
    used : (errors,) array
        On which torque and estimate rely; of a robot that has modes beyond the design, those that
        are beyond their standard deviation, followed smoothly.
    seen : (e, errors) array
        How far the estimate is from the truth, by unit errors.

    Notes
    -----
    Two-stage estimation of a constant bias: B. Friedland, Treatment of bias in recursive
    filtering, IEEE Transactions on Automatic Control 14 (1969).
    """

    def __init__(self, schedule: GainSchedule) -> None:
        assert schedule.errors is not None
        self._errors: ModelErrors = schedule.errors
        self._period = schedule.settings.period
        count = self._errors.accelerations.shape[2]
        self.values, self.used = np.zeros((2, count))
        self.seen: Array = np.zeros((len(schedule.gains[0].transition), count))
        self._covariance: Array = LIKELY**2 * np.eye(count)
        self._quiet = -np.inf
        self._variance: Array | None = None
        if len(noise := self._errors.noise):
            own = 2 * len(schedule.names)
            factors = np.repeat(COLOURED, (own, len(noise) - own))
            self._variance = np.square(factors * noise)
        # at rest errors show no more: what is seen then is noise
        self._end = (len(self._errors.accelerations) - 1) * self._errors.step
        self._now = np.zeros(self._errors.accelerations.shape[1:])
        self._ahead = np.zeros(self._errors.ahead.shape[1:])

    def reset(self) -> None:
        """Forget the errors."""
        self.values[:] = self.used[:] = 0.0
        self._covariance = LIKELY**2 * np.eye(len(self.values))
        self.forget_deviations()

    def forget_deviations(self) -> None:
        """Take note that the filter has started anew from measurements."""
        self.seen[:] = 0.0

    def adopt(self, other: ErrorEstimate | None) -> None:
        """Go on with the values of another estimate of the same errors."""
        if other is not None and other.seen.shape == self.seen.shape:
            self.values[:], self.used[:], self.seen[:] = other.values, other.used, other.seen
            self._covariance = other._covariance

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
        left = innovation[at] - expected @ self.values
        if (np.abs(left) > GATE * gains.spread[at]).any():
            self.doubt(time)
            return
        across = self._covariance @ expected.T
        trusted = np.square(TRUST * gains.spread) if self._variance is None else self._variance
        noise = np.diag(trusted[at])
        gain = np.linalg.solve(expected @ across + noise, across.T).T
        self.values += gain @ left
        np.clip(self.values, -LARGEST, LARGEST, out=self.values)
        self._covariance = self._covariance - gain @ across.T

    def follow(self, gains: PostureGains, correction: Array, at: NDArray[np.intp]) -> None:
        """Take note that the filter has corrected its estimate by the innovations at places."""
        self.seen -= correction[:, at] @ (gains.measured[at] @ self.seen)

    def go_on(self, gains: PostureGains, time: float) -> None:
        """Go on by a period from a time of the plan [s]."""
        added = self._errors.between(self._errors.accelerations, time, self._now)
        self.seen = gains.transition @ self.seen + drive(added, self._period, len(self.seen))
        self._covariance += WALK**2 * self._period * np.eye(len(self.values))
        if self._variance is None:
            self.used[:] = self.values
            return
        doubt = DOUBT**2 * np.diag(self._covariance)
        believed = self.values * np.maximum(0.0, 1.0 - doubt / np.maximum(self.values**2, doubt))
        self.used += self._period / (self._period + SMOOTH) * (believed - self.used)

    def torque(self, time: float) -> Array:
        """Return the torque (joints,) that undoes the errors from a time of the plan on."""
        return -self._errors.between(self._errors.ahead, time, self._ahead) @ self.used
