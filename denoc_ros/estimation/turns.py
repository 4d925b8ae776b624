"""Turns of continuous joints: positions that differ by a turn are the same."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from denoc_ros.bags.series import JointSeries
from denoc_ros.model.tree import Tree
from denoc_ros.types import Array, Flags

TURN = 2.0 * math.pi  # rad
JUMP_RATIO = 4.0  # A step is a jump if this many times farther from its neighbour without it.


def nearest_turns(position: Array, near: Array, continuous: NDArray[np.bool_]) -> Array:
    """Return positions (..., n), those of continuous joints in the turn nearest to `near`."""
    turns = np.where(continuous, np.round((near - position) / TURN), 0.0)
    return np.asarray(position + TURN * turns)


def unwrap_path(times: Array, positions: Array, continuous: NDArray[np.bool_]) -> Array:
    """Return the points of a trajectory without jumps by a turn.

    A step of more than half a turn is a jump if the step before it, or after the first one,
    explains the step without the turn much better.

    Parameters
    ----------
    times : (k,) array
        s, increasing.
    positions : (k, n) array
        rad or m.
    continuous : (n,) array of bool
        Whether a turn more or less is the same position.
    """
    steps = np.diff(positions, axis=0)
    places = np.argwhere((np.abs(steps) > 0.5 * TURN) & continuous)
    if len(positions) < 3 or not len(places):
        return positions
    elapsed, jumps = np.diff(times), np.zeros_like(steps)
    for k, joint in places:
        other = k - 1 if k else 1
        rate = (steps[other, joint] - jumps[other, joint]) / elapsed[other]
        jump = TURN * round(steps[k, joint] / TURN)
        raw, shifted = steps[k, joint] / elapsed[k], (steps[k, joint] - jump) / elapsed[k]
        if abs(raw - rate) > JUMP_RATIO * abs(shifted - rate):
            jumps[k, joint] = jump
    unwrapped: Array = positions.copy()
    unwrapped[1:] -= np.cumsum(jumps, axis=0)
    return unwrapped


def continuous_joints(tree: Tree, names: Sequence[str]) -> Flags:
    """Return which of some names are continuous joints of a robot."""
    joints = tree.joints
    return np.array([name in joints and joints[name].continuous for name in names], dtype=bool)


def without_turns(series: JointSeries, tree: Tree | None = None) -> JointSeries:
    """Return joint states without jumps by a turn, as of :func:`unwrap_path`.

    Parameters
    ----------
    series : JointSeries
        With rising stamps; rows without a position of a joint stay so.
    tree : Tree, optional
        The robot: its continuous joints turn; default: every joint may.
    """
    turning = np.ones(len(series.names), dtype=bool)
    if tree is not None:
        turning = continuous_joints(tree, series.names)
    if not turning.any():
        return series
    position = series.position.copy()
    for joint in np.flatnonzero(turning):
        known = np.flatnonzero(np.isfinite(position[:, joint]))
        path = position[known, joint][:, None]
        position[known, joint] = unwrap_path(series.t[known], path, turning[[joint]])[:, 0]
    return replace(series, position=position)
