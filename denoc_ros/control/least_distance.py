"""A strictly convex quadratic program, by Lawson and Hanson's least distance programming."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from scipy.optimize import nnls

from denoc_ros.types import Array

INFEASIBLE = 1e-9  # 1 / (1 + distance^2) below which there is no point within the bounds


def solve_bounded(
    hessian: Array, gradient: Array, equality: tuple[Array, Array], bounds: tuple[Array, Array]
) -> Array | None:
    """Return x (n,) that minimises x.H x / 2 + g.x with E x = e and G x <= h; None: none does.

    Parameters
    ----------
    hessian : (n, n) array
        Positive definite, scaled so that the least cost is some 1e6 at most.
    gradient : (n,) array
    equality : (E (m, n), e (m,))
        Rows that depend on others are left out where they agree.
    bounds : (G (b, n), h (b,))

    Notes
    -----
    With the equalities eliminated and the Hessian factored the problem is: the shortest w with
    A w <= b. Its dual is a non-negative least-squares problem (Solving Least Squares Problems,
    chapter 23).
    """
    rows, right = equality
    start, free = _eliminate(rows, right, len(gradient))
    if start is None:
        return None
    factor = np.linalg.cholesky(free.T @ hessian @ free)
    centre = -scipy.linalg.solve_triangular(
        factor, free.T @ (hessian @ start + gradient), lower=True
    )
    # x = start + free @ L^-T (w + centre)
    back = scipy.linalg.solve_triangular(factor, free.T, lower=True).T
    offset = start + back @ centre
    limit, most = bounds
    room = most - limit @ offset
    if not len(room) or room.min() >= 0.0:
        return np.asarray(offset)
    a = limit @ back
    scale = np.maximum(np.linalg.norm(a, axis=1), 1e-12)
    dual = -np.vstack((a.T, room)) / scale
    wanted = np.zeros(len(dual))
    wanted[-1] = 1.0
    weights, _ = nnls(dual, wanted, maxiter=20 * len(room))
    residual = wanted - dual @ weights
    if residual[-1] < INFEASIBLE:
        return None
    return np.asarray(offset - back @ (residual[:-1] / residual[-1]))


def _eliminate(rows: Array, right: Array, n: int) -> tuple[Array | None, Array]:
    """Return a point (n,) of E x = e, None if there is none, and E's null space (n, n - rank)."""
    if not len(right):
        return np.zeros(n), np.eye(n)
    scale = np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-300)
    u, s, vt = np.linalg.svd(rows / scale)
    rank = int(np.count_nonzero(s > 1e-9 * s[0]))
    wanted = u.T @ (right / scale[:, 0])
    if np.abs(wanted[rank:]).max(initial=0.0) > 1e-6 * max(np.abs(wanted).max(), 1e-12):
        return None, vt[rank:].T
    return np.asarray(vt[:rank].T @ (wanted[:rank] / s[:rank])), np.asarray(vt[rank:].T)
