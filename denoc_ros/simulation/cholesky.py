"""Conventional forward dynamics: the whole inertia matrix and its Cholesky factor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from denoc_ros.dynamics.base_motion import Base
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.validation import as_output
from denoc_ros.errors import SolverError
from denoc_ros.types import Array

Dense = TypeVar('Dense', bound='CholeskyRobot')


class CholeskyRobot(Robot):
    """A robot whose forward dynamics solves I q'' = tau - h with a dense Cholesky factor of I.

    O(n^3) in the coordinates, and what the book's chapter 7 compares its recursion with. Inertia
    matrix and bias forces are the same model's; all other verbs are those of :class:`Robot`.
    """

    @classmethod
    def of(cls: type[Dense], robot: Robot) -> Dense:
        """Return the same model and payloads with this forward dynamics."""
        _, arguments, state = robot.__reduce__()
        dense = cls(*arguments)
        dense.__setstate__(state)
        return dense

    def forward_dynamics(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        wrenches: Mapping[str, ArrayLike] | None = None,
        out: Array | None = None,
        check: bool = True,
        base: Base | None = None,
    ) -> Array:
        """Return the accelerations (n,) under generalized forces tau (n,).

        Parameters and errors as in :meth:`Robot.forward_dynamics`, single states only.
        """
        result = as_output(out, (self.n,))
        force = np.asarray(tau) - self.inverse_dynamics(
            q, qd, self._zero, wrenches, check=check, base=base
        )
        inertia = self.inertia_matrix(q, check=check)
        try:
            factor = cho_factor(inertia, lower=True, overwrite_a=True, check_finite=False)
        except LinAlgError as error:
            raise SolverError(
                f'{self.tree.name}: the inertia must be positive definite, got {error}'
            ) from error
        result[:] = cho_solve(factor, force, overwrite_b=True, check_finite=False)
        return result
