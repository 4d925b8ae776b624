"""A robot under joint feedback, for steps that take the feedback implicitly."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from denoc_ros.errors import StateError
from denoc_ros.kernels.handle import DAMPING, STIFFNESS

if TYPE_CHECKING:
    from denoc_ros.dynamics.robot import Robot


def with_joint_feedback(
    robot: Robot, index: NDArray[np.int64], kp: ArrayLike, kd: ArrayLike
) -> Robot:
    """Return a copy of a robot whose joints also resist by kp q + kd q'.

    Under the generalized force kp q_wanted + kd q'_wanted it is the robot under the feedback
    kp (q_wanted - q) + kd (q'_wanted - q'), which a linearly implicit step then takes without a
    limit on the gains.

    Parameters
    ----------
    robot : Robot
    index : (k,) int array
        Coordinates of the joints.
    kp, kd : (k,) or scalar
        [N m/rad, N/m] and [N m s/rad, N s/m], >= 0.

    Raises
    ------
    StateError
        A gain is negative or not finite.
    """
    gains = np.array([np.broadcast_to(kp, len(index)), np.broadcast_to(kd, len(index))])
    if not np.isfinite(gains).all() or (gains < 0.0).any():
        raise StateError(f'gains kp, kd must be finite and >= 0, got {gains.tolist()}')
    held = robot.copy()
    diagonals = held.diagonals()
    diagonals[STIFFNESS, index] += gains[0]
    diagonals[DAMPING, index] += gains[1]
    held.arrays = held.arrays.with_diagonals(diagonals)
    # a copy makes its workspace from the arrays
    return held.copy()
