"""The torque that holds a robot against gravity."""

from __future__ import annotations

import time

import numpy as np

from denoc_ros.dynamics.feedforward import TorqueFeedforward
from denoc_ros.errors import SolverError, StateError
from denoc_ros.runtime.conversions import is_torque
from denoc_ros.runtime.rate_limiter import Backoff
from denoc_ros.types import Array

SHARE = 0.1  # of a processor that postures without a torque may cost
LONGEST_WAIT = 0.25  # s until such a posture is looked at again


class CarryingTorque:
    """Gravity torque of the last posture that has one.

    A measured posture may have none: one in which the loops of a mechanism do not close, or whose
    numbers overflow.

    Parameters
    ----------
    joints : int

    Attributes
    ----------
    posture, torque : (n,) array
        The last posture with a torque [rad or m], and that torque [N m or N].
    found : bool
        Whether there is any.
    failure : str
        Why the newest posture has none, '' if it has.
    """

    def __init__(self, joints: int) -> None:
        self.posture, self.torque = np.zeros((2, joints))
        self._wrong = np.full(joints, np.nan)
        self._source: TorqueFeedforward | None = None
        self._backoff = Backoff(SHARE, LONGEST_WAIT)
        self.forget()

    def forget(self) -> None:
        """Discard the result."""
        self.found = False
        self.failure = ''

    def hurry(self) -> None:
        """Look at the next posture at once: time has begun anew."""
        self._backoff.reset()

    def update(self, source: TorqueFeedforward, posture: Array, now: float) -> str:
        """Find the torque of a posture (n,) at steady `now` [s].

        Returns
        -------
        str
            Why there is none, '' if there is, if it was too soon to look again, or for the same
            posture and model as before.
        """
        changed, self._source = source is not self._source, source
        again = bool(self.failure) and not changed and bool((posture == self._wrong).all())
        if self.failure and not changed and not self._backoff.due(now):
            return ''
        begin = time.thread_time()
        try:
            torque = source.gravity(posture)
            self.failure = '' if is_torque(torque) else f'{posture} must have a finite weight'
        except (StateError, SolverError) as error:
            self.failure = str(error)
        if self.failure:
            self._wrong[:] = posture
            self._backoff.failed(now, time.thread_time() - begin)
            return '' if again else self.failure
        self.posture[:], self.torque[:] = posture, torque
        self.found = True
        return ''
