"""Diagnostics of the feedforward's torque."""

from __future__ import annotations

from collections.abc import Mapping

from denoc_ros.runtime.safety import TorqueLimiter
from denoc_ros.runtime.status import ERROR, WARN, Status


class TorqueStatus:
    """State of the torque, with warnings for events since the last report."""

    def __init__(self) -> None:
        self._clamped = self._failures = 0

    def status(
        self, cause: str, limiter: TorqueLimiter, model_failures: int, more: Mapping[str, object]
    ) -> Status:
        """Return the status.

        Parameters
        ----------
        cause : str
            What the torque follows, or why it does not.
        limiter : TorqueLimiter
            What it leaves through.
        model_failures : int
            How often the model gave no torque.
        more : mapping
            Further values.
        """
        status = Status('torque', message=cause)
        status.values = {
            'cause': cause,
            **more,
            'clamped': ' '.join(map(str, limiter.clamped.tolist())),
            'non_finite': limiter.non_finite,
            'model_failures': model_failures,
        }
        clamped = int(limiter.clamped.sum())
        if clamped > self._clamped:
            status.worsen(WARN, 'torque clamped')
        if cause.startswith('stale'):
            status.worsen(WARN, cause)
        failures = limiter.non_finite + model_failures
        if failures > self._failures:
            status.worsen(ERROR, 'torque of the model not finite')
        self._clamped, self._failures = clamped, failures
        return status
