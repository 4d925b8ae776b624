"""What each sample tells beyond those before it, where noise of the joints makes links vibrate.

Noise of the measured joint motion drives the amplitudes of the model, and they remember it: the
residuals of a simulation hang together over many periods. A Kalman filter over the linear model of
the amplitudes follows that vibration by the residuals; what it does not foresee is white, and its
squares are the likelihood (L. Ljung, System Identification, 1999, section 7.4).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from denoc_ros.identification.model.nearby_motion import NearbyMotion
from denoc_ros.types import Array

Int = NDArray[np.int64]

MOST_APART = 1.5  # usual times between joint stamps: a row farther from all of them is not linked


@dataclass(frozen=True)
class LinkedRows:
    """How the residuals of a run hang on the amplitudes.

    Attributes
    ----------
    places : list of int arrays
        For each stamp of the joints the rows nearest to it.
    slopes : (m, 2f) array
        Derivatives of the residuals by amplitudes and rates at that stamp.
    """

    places: list[Int]
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
    return LinkedRows([order[a:b] for a, b in pairwise(edges)], slopes)


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
        self._nearby, self._rows, self._deviation = nearby, rows, deviation
        self._gains: list[Array] = []
        self._roots: list[Array] = []
        f = len(nearby.free)
        by_joints = nearby.by_joints * rate_noise
        # white noise v of a rate: with y = x - B v the model is y' = A y + A B v
        shaking = np.concatenate([by_joints, nearby.slopes[:, f:, f:] @ by_joints], axis=1)
        spread = np.zeros((2 * f, 2 * f))
        step = np.diff(t, prepend=t[0])
        for k, places in enumerate(rows.places):
            if nearby.starts[k]:
                spread = np.zeros((2 * f, 2 * f))
            else:
                phi = nearby.transitions[k - 1]
                noise = shaking[k] @ shaking[k].T * step[k]
                spread = phi @ spread @ phi.T + noise
            spread = self._add(places, spread)

    def _add(self, places: Int, spread: Array) -> Array:
        """Keep gain and root of the next rows; return what they leave of the spread."""
        if not len(places):
            self._gains.append(spread[:, :0])
            self._roots.append(spread[:0, :0])
            return spread
        seen = self._rows.slopes[places]
        shared = spread @ seen.T
        whole = seen @ shared
        whole.flat[:: len(places) + 1] += self._deviation[places] ** 2
        root = np.linalg.inv(np.linalg.cholesky(whole))
        rooted = root @ shared.T
        self._gains.append(rooted.T @ root)
        self._roots.append(root)
        return np.asarray(spread - rooted.T @ rooted)

    def whitened(self, residuals: Array) -> Array:
        """Return residuals (m,) or (m, c) in deviations of what was not foreseen of them."""
        one = residuals.ndim == 1
        given = residuals[:, None] if one else residuals
        found: Array = given / self._deviation[:, None]
        state = np.zeros((self._rows.slopes.shape[1], given.shape[1]))
        starts, transitions = self._nearby.starts, self._nearby.transitions
        for k, places in enumerate(self._rows.places):
            state = np.zeros_like(state) if starts[k] else transitions[k - 1] @ state
            if len(places):
                missed = given[places] - self._rows.slopes[places] @ state
                found[places] = self._roots[k] @ missed
                state += self._gains[k] @ missed
        return found[:, 0] if one else found
