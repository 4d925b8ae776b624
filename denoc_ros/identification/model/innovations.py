"""Innovations of each sample, where noise of the joints makes links vibrate.

Noise of the measured joint motion drives the amplitudes of the model, and they remember it: the
residuals of a simulation hang together over many periods. A Kalman filter over the linear model of
the amplitudes follows that vibration by the residuals; what it does not foresee is white, and its
squares are the likelihood (L. Ljung, System Identification, 1999, section 7.4).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from denoc_ros.identification.model.nearby_motion import NearbyMotion
from denoc_ros.kernels.compiled import ready
from denoc_ros.kernels.kalman import filter_gains, filter_values
from denoc_ros.types import Array

Int = NDArray[np.int64]

MOST_APART = 1.5  # usual times between joint stamps: a row farther from all of them is not linked


@dataclass(frozen=True)
class LinkedRows:
    """How the residuals of a run hang on the amplitudes.

    Attributes
    ----------
    order : (l,) int array
        The rows that are near a stamp, by stamps.
    edges : (k + 1,) int array
        Where in this order those nearest to each stamp begin, and end.
    alone : (m - l,) int array
        All others.
    slopes : (m, 2f) array
        Derivatives of the residuals by amplitudes and rates at that stamp.
    """

    order: Int
    edges: Int
    alone: Int
    slopes: Array


def linked_rows(nearby: NearbyMotion, t: Array, row_t: Array, by_state: Array) -> LinkedRows:
    """Return which rows hang on which stamp.

    Parameters
    ----------
    nearby : NearbyMotion
    t : (k,) array
        Its stamps [s].
    row_t : (m,) array
        When what the rows show was so [s].
    by_state : (m, 2f) array
        Derivatives of the residuals by amplitudes and rates at the rows' own times.
    """
    period = float(np.median(np.diff(t)))
    after = np.clip(np.searchsorted(t, row_t), 1, len(t) - 1)
    nearest = after - (row_t - t[after - 1] < t[after] - row_t)
    apart = row_t - t[nearest]
    # x at the row's time is about (1 + A dt) x at the stamp
    slopes = by_state + apart[:, None] * np.einsum('mi,mij->mj', by_state, nearby.slopes[nearest])
    near = np.flatnonzero(np.abs(apart) <= MOST_APART * period)
    order = near[np.argsort(nearest[near], kind='stable')]
    edges = np.searchsorted(nearest[order], np.arange(len(t) + 1))
    alone = np.setdiff1d(np.arange(len(row_t)), near)
    return LinkedRows(order, edges, alone, np.ascontiguousarray(slopes))


class Innovations:
    """A filter that is fixed: it makes residuals and their derivatives white alike.

    Parameters
    ----------
    nearby : NearbyMotion
    rows : LinkedRows
    deviation : (m,) array
        Of each row's own noise.
    rate_noise : (joints of the robot,) array
        Density of the noise of the joints' rates [rad/s per root of Hz].
    t : (k,) array
        Stamps [s].
    """

    def __init__(
        self,
        nearby: NearbyMotion,
        rows: LinkedRows,
        deviation: Array,
        rate_noise: Array,
        t: Array,
    ) -> None:
        f = len(nearby.free)
        by_joints = nearby.by_joints * rate_noise
        # white noise v of a rate: with y = x - B v the model is y' = A y + A B v
        shaking = np.concatenate([by_joints, nearby.slopes[:, f:, f:] @ by_joints], axis=1)
        added = shaking @ shaking.transpose(0, 2, 1) * np.diff(t, prepend=t[0])[:, None, None]
        ready(filter_gains, filter_values)
        self._way = nearby.transitions, nearby.starts
        self._linked = rows.edges, rows.order, rows.slopes
        self._alone = rows.alone
        self._gains, self._deviation = np.zeros(rows.slopes.shape), deviation.copy()
        filter_gains(*self._way, added, *self._linked, self._gains, self._deviation)

    def whitened(self, residuals: Array) -> Array:
        """Residuals (m,) or (m, c) as innovations over their standard deviations."""
        found = residuals.reshape(len(residuals), -1).copy()
        found[self._alone] /= self._deviation[self._alone, None]
        filter_values(*self._way, *self._linked, self._gains, self._deviation, found)
        return np.asarray(found.reshape(residuals.shape))
