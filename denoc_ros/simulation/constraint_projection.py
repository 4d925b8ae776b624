"""Projection onto the loops: removes the closure error of an integrator's step."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError
from denoc_ros.types import Array

Int = NDArray[np.int_]

# m, rad: where a correction ends; rounding leaves 1e-16 of a robot's size, and each one squares
# what a step left, 1e-6 at most
CLOSED = 1e-12
CORRECTIONS = 6
# Of the singular values of J I^-1 J^T, squares of those of the rows: those below are redundant.
RANK = 1e-12


class ConstraintProjection:
    """Projects states of a robot onto its loops and mimic joints.

    The change is the smallest in the metric of the inertia matrix: it does no more to a light
    coordinate's motion than to a heavy one's, and a projection of rates takes away just the
    kinetic energy of what opens the loops.

    Parameters
    ----------
    robot : Robot
        Its workspace is used.
    free : (f,) array of int
        The coordinates that may be moved; the others are prescribed.
    """

    def __init__(self, robot: Robot, free: Int) -> None:
        self._robot = robot
        self._free = free

    def positions(self, q: Array) -> None:
        """Close q (n,) in place.

        Raises
        ------
        SolverError
            It does not close from there.
        """
        for _ in range(CORRECTIONS):
            error = self._robot.closure(q)
            if np.max(np.abs(error), initial=0.0) <= CLOSED:
                return
            q[self._free] -= self._correction(q, error)
        raise SolverError(
            f'simulate: the loops must close, got an error of {np.max(np.abs(error)):.3g} m or '
            f'rad after {CORRECTIONS} corrections; a singular configuration, or too long a step'
        )

    def rates(self, q: Array, qd: Array) -> None:
        """Make qd (n,) keep the loops closed at q, in place."""
        qd[self._free] -= self._correction(q, self._robot.closure_jacobian(q) @ qd)

    def _correction(self, q: Array, error: Array) -> Array:
        """Return I^-1 J^T (J I^-1 J^T)^+ error of the free coordinates, (f,)."""
        free = self._free
        rows = self._robot.closure_jacobian(q)[:, free]
        inertia = self._robot.inertia_matrix(q)[np.ix_(free, free)]
        spread = scipy.linalg.cho_solve(scipy.linalg.cho_factor(inertia), rows.T)
        share = np.linalg.lstsq(rows @ spread, error, rcond=RANK)[0]
        return np.asarray(spread @ share)
