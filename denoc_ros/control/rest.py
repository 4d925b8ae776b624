"""Postures at rest with the tip where it should be: elasticity and gravity in balance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from denoc_ros.control.tip_problem import TipProblem
from denoc_ros.errors import SolverError

Array = NDArray[np.float64]

ITERATIONS = 60
SETTLED = 1e-11
LONGEST = 0.5  # rad or m of a joint in one step


def rest_posture(problem: TipProblem, node: int, start: Array) -> Array:
    """Return the posture (n,) at rest whose frames come nearest to a node's targets.

    Parameters
    ----------
    problem : TipProblem
    node : int
    start : (n,) array
        Near it.

    Raises
    ------
    SolverError
        None was found (a load beyond buckling).
    """
    q, n = start[None].copy(), len(start)
    rows = slice(node, node + 1) if node >= 0 else slice(node, None)
    rest = np.zeros((1, n))
    p = len(problem.undriven)
    moved = left = np.inf
    for _ in range(ITERATIONS):
        equations = problem.equations(q, rest, rest)
        errors = problem.errors(q, rows)
        jacobian = problem.error_derivatives(q, errors)[0]
        matrix, right = np.zeros((n + p, n + p)), np.zeros(n + p)
        matrix[:n, :n] = jacobian.T @ jacobian
        j = problem.driven
        matrix[j, j] += problem.draw**2
        matrix[n:, :n] = equations.by_q[0]
        matrix[:n, n:] = equations.by_q[0].T
        right[:n] = -jacobian.T @ errors[0]
        right[j] -= problem.draw**2 * (q[0] - problem.asked[node])[j]
        right[n:] = -equations.value[0]
        try:
            change = np.linalg.solve(matrix, right)[:n]
        except np.linalg.LinAlgError:
            break
        largest = float(np.abs(change[j]).max(initial=0.0))
        q = q + change * min(1.0, LONGEST / max(largest, 1e-300))
        moved, left = float(np.abs(change).max()), float(np.abs(equations.value).max(initial=0.0))
        if moved <= SETTLED * (1.0 + np.abs(q).max()):
            return np.asarray(q[0])
        if not np.isfinite(q).all():
            break
    raise SolverError(
        f'shape_motion: {problem.robot.tree.name}: the posture at rest must be found in '
        f'{ITERATIONS} iterations, got a last change of {moved:.3g} and forces of {left:.3g} m '
        'over their stiffness (buckling, or a tip out of reach?)'
    )
