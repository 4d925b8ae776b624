"""Postures at rest with the tip where it should be: elasticity and gravity in balance."""

from __future__ import annotations

import numpy as np

from denoc_ros.errors import SolverError
from denoc_ros.planning.tip.tip_problem import Equations, TipProblem
from denoc_ros.types import Array

ITERATIONS = 60
SETTLED = 1e-11
LONGEST = 0.5  # rad or m of a joint in one step


def rest_posture(problem: TipProblem, node: int, start: Array) -> tuple[Array, Array]:
    """Return the posture at rest whose frames come nearest to a node's targets.

    Parameters
    ----------
    problem : TipProblem
    node : int
    start : (n,) array
        Near it.

    Returns
    -------
    q : (n,) array
    multipliers : (m,) array
        Of loops and mimic joints, over the problem's stiffness.

    Raises
    ------
    SolverError
        None was found (a load beyond buckling).
    """
    q, n, m = start[None].copy(), len(start), problem.loops.count
    multipliers, rest = np.zeros((1, m)), np.zeros((1, n))
    rows = slice(node, node + 1) if node >= 0 else slice(node, None)
    moved = left = np.inf
    for _ in range(ITERATIONS):
        equations = problem.equations(q, rest, rest, multipliers)
        residual, errors = problem.residual(q, rest, rest, multipliers), problem.errors(q, rows)
        change = _newton(problem, equations, q, (residual, errors), problem.asked[node])
        if change is None:
            break
        largest = float(np.abs(change[problem.driven]).max(initial=0.0))
        share = min(1.0, LONGEST / max(largest, 1e-300))
        q, multipliers = q + share * change[:n], multipliers + share * change[n:]
        moved = float(np.abs(change[:n]).max())
        left = float(np.abs(residual).max(initial=0.0))
        if moved <= SETTLED * (1.0 + np.abs(q).max()):
            return q[0], multipliers[0]
        if not np.isfinite(q).all():
            break
    raise SolverError(
        f'shape_motion: {problem.robot.tree.name}: the posture at rest must be found in '
        f'{ITERATIONS} iterations, got a last change of {moved:.3g} and forces of {left:.3g} m '
        'over their stiffness (buckling, or a tip out of reach?)'
    )


def _newton(
    problem: TipProblem, equations: Equations, q: Array, left: tuple[Array, Array], asked: Array
) -> Array | None:
    """Return the change (n + m,) of posture and multipliers in one Gauss-Newton step.

    `left` has the equations' values and the errors. A floating base stays where it is.
    """
    n, driven, (residual, errors) = q.shape[1], problem.driven, left
    jacobian = problem.error_derivatives(q, errors)[0]
    by = np.concatenate([equations.by_q[0], equations.by_multipliers[0]], axis=1)
    p, size = by.shape
    matrix, right = np.zeros((size + p, size + p)), np.zeros(size + p)
    matrix[:n, :n] = jacobian.T @ jacobian
    matrix[driven, driven] += problem.draw**2
    matrix[size:, :size], matrix[:size, size:] = by, by.T
    matrix[problem.base] = matrix[:, problem.base] = 0.0
    matrix[problem.base, problem.base] = 1.0
    right[:n] = -jacobian.T @ errors[0]
    right[driven] -= problem.draw**2 * (q[0] - asked)[driven]
    right[problem.base] = 0.0
    right[size:] = -residual[0]
    try:
        return np.asarray(np.linalg.solve(matrix, right)[:size])
    except np.linalg.LinAlgError:
        return None
