"""Derivatives of the dense oracle with loops: complex steps of its equations, solved whole.

All rows must count. The equations are I q'' + h = tau + J^T multipliers + S torques and
J q'' + J' q' = 0, with q'' of the held coordinates given: linear in what they determine.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from derivative_oracle import complex_step
from loop_oracle import LoopOracle

from denoc_ros.types import Array


def motion_derivatives(
    oracle: LoopOracle,
    state: tuple[Array, Array, Array],
    multipliers: Array,
    held: Sequence[int] = (),
    wrenches: Mapping[str, Array] | None = None,
) -> tuple[list[Array], list[Array], list[Array]]:
    """Return q'' (n), multipliers and torques of the held coordinates; (…, columns) each.

    Each by q (n), q' (n), all generalized forces (n) and the held accelerations, in that order.
    """
    q, qd, qdd = state
    n, a = oracle.n, len(held)
    select = np.eye(n)[:, list(held)]
    J = oracle.rows(q, qd).jacobian
    r = len(J)

    def equations(q: Array, qd: Array) -> Array:
        rows = oracle.rows(q, qd)
        force = oracle.inverse_dynamics(q, qd, qdd, wrenches) - oracle.loop_forces(q, qd)
        return np.concatenate(
            [force - rows.jacobian.T @ multipliers, rows.jacobian @ qdd + rows.bias]
        )

    matrix = np.zeros((n + r + a, n + r + a))
    matrix[:n, :n], matrix[:n, n : n + r], matrix[:n, n + r :] = (
        oracle.inertia_matrix(q),
        -J.T,
        -select,
    )
    matrix[n : n + r, :n], matrix[n + r :, :n] = J, select.T
    wanted = [np.zeros((n + r + a, count)) for count in (n, n, n, a)]
    wanted[0][: n + r] = -complex_step(lambda x: equations(x, qd), q)
    wanted[1][: n + r] = -complex_step(lambda x: equations(q, x), qd)
    wanted[2][:n] = np.eye(n)
    wanted[3][n + r :] = np.eye(a)
    found: list[Array] = [np.asarray(np.linalg.solve(matrix, each), float) for each in wanted]
    return (
        [each[:n] for each in found],
        [each[n : n + r] for each in found],
        [each[n + r :] for each in found],
    )
