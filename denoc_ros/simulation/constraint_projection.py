"""Projection onto the loops: removes the closure error of an integrator's step."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from denoc_ros.dynamics.assembling import close_nearby
from denoc_ros.dynamics.constraints import RANK
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError
from denoc_ros.kernels.closing import CLOSED
from denoc_ros.types import Array

Int = NDArray[np.int_]

CORRECTIONS = 6  # each one squares what a step left, 1e-6 at most


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
        left = close_nearby(
            self._robot, q, self._free, lambda error, rows: self._change(q, error, rows),
            CLOSED, CORRECTIONS,
        )  # fmt: skip
        if left > CLOSED:
            raise SolverError(
                f'simulate: the loops must close, got an error of {left:.3g} m or rad after '
                f'{CORRECTIONS} corrections; a singular configuration, or too long a step'
            )

    def rates(self, q: Array, qd: Array) -> None:
        """Make qd (n,) keep the loops closed at q, in place."""
        rows = self._robot.closure_jacobian(q)
        qd[self._free] -= self._change(q, rows @ qd, rows[:, self._free])

    def _change(self, q: Array, error: Array, rows: Array) -> Array:
        """Return I^-1 J^T (J I^-1 J^T)^+ error of the free coordinates, (f,)."""
        free = self._free
        inertia = self._robot.inertia_matrix(q)[np.ix_(free, free)]
        spread = scipy.linalg.cho_solve(scipy.linalg.cho_factor(inertia), rows.T)
        share = np.linalg.lstsq(rows @ spread, error, rcond=RANK**2)[0]
        return np.asarray(spread @ share)
