"""Derivatives of a motion's equations in the band that a Gauss-Newton step solves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from denoc_ros.control.block_band import BlockBand
from denoc_ros.control.grid import BETWEEN, FIRST, REACH, SECOND, SLOPE
from denoc_ros.control.tip_problem import Equations, Momentum
from denoc_ros.types import Array

Int = NDArray[np.int64]


def add_equations(equations: Equations, band: BlockBand, step: float, end: Int) -> None:
    """Write the equations' derivatives by all nodes, and their transposes, into the band.

    Of the first node no coordinate moves, of the last one those of `end`. Where none moves,
    closure is no equation.
    """
    k, p, n = equations.by_q.shape
    m = equations.by_multipliers.shape[2]
    at, fixed = n + m, np.setdiff1d(np.arange(n), end)
    for column, (first, second) in enumerate(zip(FIRST, SECOND, strict=True)):
        offset = column - REACH
        entry = (first / step) * equations.by_qd + (second / step**2) * equations.by_qdd
        if offset == 0:
            entry += equations.by_q
        # the row of node j has the column of node j + offset
        entry = entry[max(0, -offset) : k - max(0, offset)]
        if offset <= 0:
            entry[0] = 0.0
        if offset >= 0:
            entry[-1] = _by_end(equations, step, offset)
            entry[-1][:, fixed] = 0.0
        band.blocks(-offset, at, 0, p, n)[...] = entry
        band.blocks(offset, 0, at, n, p)[...] = entry.transpose(0, 2, 1)
    if m:
        band.blocks(0, at, n, p, m)[...] = equations.by_multipliers
        band.blocks(0, n, at, m, p)[...] = equations.by_multipliers.transpose(0, 2, 1)
        closure, ends = np.arange(p - m, p), np.array([0] if len(end) else [0, k - 1])
        band.blocks(0, at, at, p, p)[np.ix_(ends, closure, closure)] += np.eye(m)


def _by_end(equations: Equations, step: float, offset: int) -> Array:
    """Return how the equations (p, n) of the node `offset` before the last change with the last.

    All nodes beyond it are as it is.
    """
    row, beyond = len(equations.by_q) - 1 - offset, REACH + offset
    found = (FIRST[beyond:].sum() / step) * equations.by_qd[row]
    found = found + (SECOND[beyond:].sum() / step**2) * equations.by_qdd[row]
    return np.asarray(found if offset else found + equations.by_q[row])


def add_momentum(momentum: Momentum, band: BlockBand, step: float, end: Int, at: int) -> None:
    """Write the derivatives of the momentum half-way after each node into rows from `at` on.

    Of the first node no coordinate moves, of the last one those of `end`.
    """
    between, six, n = momentum.by_q.shape
    if not six:
        return
    fixed = np.setdiff1d(np.arange(n), end)
    for column, (share, slope) in enumerate(zip(BETWEEN, SLOPE, strict=True)):
        offset = column - 1
        entry = share * momentum.by_q + (slope / step) * momentum.by_qd
        if offset == 1:  # the node beyond the last is as the last
            entry[-1] += BETWEEN[-1] * momentum.by_q[-1] + SLOPE[-1] / step * momentum.by_qd[-1]
        # the row after node j has the column of node j + offset
        entry = entry[max(0, -offset) : between - max(0, offset - 1)]
        if offset <= 0:
            entry[0] = 0.0
        if offset >= 1:
            entry[-1][:, fixed] = 0.0
        band.blocks(-offset, at, 0, six, n)[: len(entry)] = entry
        band.blocks(offset, 0, at, n, six)[: len(entry)] = entry.transpose(0, 2, 1)
    band.blocks(0, at, at, six, six)[-1] = np.eye(six)
