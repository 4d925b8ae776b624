"""Where an estimate of deviations began, by all that has been measured since."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from denoc_ros.types import Array

# m or rad, and per s: deviations of the softest beam of a robot that stands or was on its plan,
# and of one that has gone astray
NEAR, ASTRAY = 0.001, 0.1


class Beginning:
    """Least squares of the deviations with which a settled filter began.

    The filter's constant gains suit an estimate that is good already: what it began with wrongly
    would stay for seconds, that of beams most. Its innovations show it much earlier.

    Parameters
    ----------
    size : int
        Of the estimate.
    likely : (2 m,) array
        Standard deviations of what the estimate begins with, before anything is measured.

    Notes
    -----
    Two-stage estimation: B. Friedland, Treatment of bias in recursive filtering, IEEE Transactions
    on Automatic Control 14 (1969).
    """

    def __init__(self, size: int, likely: Array) -> None:
        count = len(likely)
        # what is left in the estimate of likely deviations
        self._left: Array = np.zeros((size, count))
        self._left[:count] = np.diag(likely)
        self._information: Array = np.eye(count)
        self._explained = np.zeros(count)

    def go_on(self, transition: Array) -> None:
        """Go on by a period; transition (e, e)."""
        self._left = transition @ self._left

    def watch(self, rows: Array, innovation: Array, spread: Array, at: NDArray[np.intp]) -> None:
        """Take the information of innovations (measured,) at places (k,).

        `rows` (measured, e) and `spread` (measured,) are the filter's.
        """
        seen = rows[at] @ self._left
        weighted = seen.T / np.square(spread[at])
        self._information += weighted @ seen
        self._explained += weighted @ innovation[at]

    def correct(self, correction: Array, rows: Array, at: NDArray[np.intp]) -> None:
        """Take note that innovations at places (k,) corrected it, by correction (e, measured)."""
        self._left -= correction[:, at] @ (rows[at] @ self._left)

    def give(self, rows: Array, places: NDArray[np.intp]) -> None:
        """Take note that parts of the estimate, at places, explain all of values (k,) by rows."""
        self._left[places] -= rows @ self._left

    def change(self) -> Array:
        """Return the change of the estimate (e,) by all information so far."""
        try:
            deviations = np.linalg.solve(self._information, self._explained)
        except np.linalg.LinAlgError:  # it grew beyond all bounds, and the estimate as well
            return np.zeros(len(self._left))
        self._explained[:] = 0.0
        return self._left @ deviations
