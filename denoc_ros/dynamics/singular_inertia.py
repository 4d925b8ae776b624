"""Joints that move no inertia: forward dynamics has no acceleration for them."""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np

from denoc_ros.kernels.dynamics import composite
from denoc_ros.kernels.jit.compiled import entry
from denoc_ros.types import Array

# Of a coordinate's inertia, and of the largest one: what rounding leaves of none.
NO_INERTIA, NO_INERTIA_AT_ALL = 1e-13, 1e-16


class WithInertia(Protocol):
    """A robot, as far as its inertia matrix needs it."""

    n: int
    handle: Any
    coordinate_names: Any
    joint_names: Any
    joint_indices: Any


def coordinates_without_inertia(robot: WithInertia, q: Array | None = None) -> dict[str, str]:
    """Return the names of coordinates that move no inertia, and what each of them needs.

    They are those of which nothing remains of the inertia matrix when the coordinates behind them,
    towards the tips, are eliminated, as forward dynamics does.

    Parameters
    ----------
    q : (n,) or (k, n), optional
        Coordinates, of which the first with such a matrix counts; default none that is special.
    """
    if robot.n == 0:
        return {}
    inertia = np.empty((robot.n, robot.n))
    for row in np.atleast_2d(_generic_posture(robot) if q is None else q):
        entry(composite.inertia_matrix)(robot.handle, row.copy(), inertia)
        found = [robot.coordinate_names[index] for index in _without_pivot(inertia)]
        if found:
            return {name: _remedy(robot, name) for name in found}
    return {}


def _without_pivot(inertia: Array) -> list[int]:
    """Return the rows of an inertia matrix (n, n) that have no pivot, from the last one on."""
    rest, found = inertia.copy(), []
    least = NO_INERTIA_AT_ALL * float(np.max(np.diag(inertia), initial=0.0))
    for i in reversed(range(len(rest))):
        if rest[i, i] > max(least, NO_INERTIA * inertia[i, i]):
            rest[:i, :i] -= np.outer(rest[:i, i], rest[i, :i]) / rest[i, i]
        else:
            found.append(i)
    return found[::-1]


def _generic_posture(robot: WithInertia) -> Array:
    q, count = np.zeros(robot.n), len(robot.joint_indices)
    q[robot.joint_indices] = 0.3 + 0.7 * np.modf(np.arange(count) * math.sqrt(2.0))[0]
    return q


def _remedy(robot: WithInertia, coordinate: str) -> str:
    remedy = 'give what it moves an inertia'
    if coordinate in robot.joint_names:
        remedy += f', make it fixed, or add <actuator joint="{coordinate}" armature="…"/>'
    return remedy
