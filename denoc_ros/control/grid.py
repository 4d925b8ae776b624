"""Motions on a uniform grid of times: derivatives by differences, values between nodes."""

from __future__ import annotations

import numpy as np

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
        self._start, self._step, self._first, self._last = start, step, q[0], q[-1]
        h = step
        gap = q[1:] - q[:-1] - h * (qd[:-1] + 0.5 * h * qdd[:-1])
        slope = h * (qd[1:] - qd[:-1] - h * qdd[:-1])
        bend = h * h * (qdd[1:] - qdd[:-1])
        # powers of s = (t - t_k) / step
        self._pieces = np.stack(
            (
                q[:-1],
                h * qd[:-1],
                0.5 * h * h * qdd[:-1],
                10.0 * gap - 4.0 * slope + 0.5 * bend,
                -15.0 * gap + 7.0 * slope - bend,
                6.0 * gap - 3.0 * slope + 0.5 * bend,
            )
        )

    def sample(self, times: Array) -> tuple[Array, Array, Array]:
        """Return positions, rates and accelerations (m, n) at times (m,) [s]."""
        at = (np.asarray(times, dtype=np.float64) - self._start) / self._step
        count = self._pieces.shape[1]
        piece = np.clip(np.floor(at).astype(np.int64), 0, count - 1)
        s = np.clip(at - piece, 0.0, 1.0)[:, None]
        c = self._pieces[:, piece]
        q = c[0] + s * (c[1] + s * (c[2] + s * (c[3] + s * (c[4] + s * c[5]))))
        qd = c[1] + s * (2.0 * c[2] + s * (3.0 * c[3] + s * (4.0 * c[4] + s * 5.0 * c[5])))
        qdd = 2.0 * c[2] + s * (6.0 * c[3] + s * (12.0 * c[4] + s * 20.0 * c[5]))
        outside = (at < 0.0) | (at > count)
        qd[outside] = qdd[outside] = 0.0
        return q, qd / self._step, qdd / self._step**2
