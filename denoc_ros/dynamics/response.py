"""Response of the free coordinates to forces and impulses, with the others' motion given."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.constraints import RANK, jacobian
from denoc_ros.types import Array

if TYPE_CHECKING:
    from denoc_ros.dynamics.robot import Robot

Int = NDArray[np.int64]


def response(robot: Robot, q: Array, free: Int) -> Array:
    """Return the accelerations (f, f) of the free coordinates by unit forces on them.

    Loops stay closed and mimic joints on their leaders: the inverse of I_FF, less what the
    multipliers take back, I_FF^-1 J^T (J I_FF^-1 J^T)^+ J I_FF^-1.
    """
    inverse = np.linalg.inv(robot.inertia_matrix(q, check=False)[np.ix_(free, free)])
    rows = jacobian(robot, q)[0][:, free]
    if rows.any():
        spread = rows @ inverse
        products = np.linalg.pinv(spread @ rows.T, rcond=RANK**2, hermitian=True)
        inverse -= spread.T @ products @ spread
    return np.asarray(inverse, dtype=np.float64)


def impulse_response(robot: Robot, q: Array, free: Int, jump: Array) -> Array:
    """Return the jump (n,) of all rates where some are made to jump and the free ones answer.

    Parameters
    ----------
    robot : Robot
    q : (n,)
    free : (f,) int array
        Coordinates that no impulse acts on.
    jump : (n,)
        One that obeys the loops; what it has of free coordinates does not matter otherwise.
    """
    answer: Array = jump.copy()
    if len(free):
        momentum = robot.inertia_matrix(q, check=False)[free] @ jump
        answer[free] -= response(robot, q, free) @ momentum
    return answer
