"""Motions on a uniform grid of times: derivatives by differences, values between nodes."""

from __future__ import annotations

import numpy as np

from denoc_ros.trajectories import SplineTrajectory
from denoc_ros.types import Array

REACH = 2  # nodes on either side that a derivative takes
FIRST = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0
SECOND = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / 12.0

# half-way to the next node, by the nodes from the one before on
BETWEEN = np.array([-1.0, 9.0, 9.0, -1.0]) / 16.0
SLOPE = np.array([1.0, -27.0, 27.0, -1.0]) / 24.0


def differences(q: Array, step: float) -> tuple[Array, Array]:
    """Return rates and accelerations (k, n) of a motion (k, n) that rests before and after.

    Central differences of fourth order; nodes beyond the ends are as the ends are.
    """
    k = len(q)
    ends = [np.repeat(end, REACH, axis=0) for end in (q[:1], q[-1:])]
    padded = np.concatenate([ends[0], q, ends[1]])
    qd, qdd = np.zeros((2, *q.shape))
    for j, (first, second) in enumerate(zip(FIRST, SECOND, strict=True)):
        qd += (first / step) * padded[j : j + k]
        qdd += (second / step**2) * padded[j : j + k]
    qd[[0, -1]] = qdd[[0, -1]] = 0.0
    return qd, qdd


def halfway(q: Array, step: float) -> tuple[Array, Array]:
    """Return positions and rates (k - 1, n) half-way between nodes of a motion (k, n), by rest.

    Of fourth order, as :func:`differences`; of a motion that goes to and fro from node to node
    they see the rates.
    """
    k = len(q) - 1
    padded = np.concatenate([q[:1], q, q[-1:]])
    parts = [padded[j : j + k] for j in range(len(BETWEEN))]
    position = sum(share * part for share, part in zip(BETWEEN, parts, strict=True))
    rate = sum(share * part for share, part in zip(SLOPE, parts, strict=True))
    return np.asarray(position), np.asarray(rate) / step


class GridMotion:
    """A twice continuously differentiable motion: quintics between the nodes of a grid.

    Parameters
    ----------
    start, step : float
        Time of the first node, and between nodes [s].
    q, qd, qdd : (k, n) arrays
        At the nodes. Before the first and after the last the motion rests.
    """

    def __init__(self, start: float, step: float, q: Array, qd: Array, qdd: Array) -> None:
        self._start = start
        self._pieces = SplineTrajectory(np.arange(len(q)) * np.float64(step), q, qd, qdd)

    def sample(self, times: Array) -> tuple[Array, Array, Array]:
        """Return positions, rates and accelerations (m, n) at times (m,) [s]."""
        at = np.asarray(times, dtype=np.float64) - self._start
        inside = np.clip(at, 0.0, self._pieces.duration)
        q, qd, qdd = self._pieces.rows(inside)
        qd[inside != at] = qdd[inside != at] = 0.0
        return q, qd, qdd
