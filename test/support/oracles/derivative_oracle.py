"""Derivatives of the dense oracle by complex steps: exact to rounding, and sharing no code."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from oracles import Oracle

from denoc_ros.types import Array

STEP = 1e-30


def complex_step(function: Callable[[Array], Array], x: Array) -> Array:
    """Return the derivative (..., len(x)) of an analytic function at x."""
    columns = []
    for j in range(len(x)):
        moved = x.astype(complex)
        moved[j] += 1j * STEP
        columns.append(np.imag(function(moved)) / STEP)
    return np.stack(columns, axis=-1)


def inverse_derivatives(
    oracle: Oracle,
    q: Array,
    qd: Array,
    qdd: Array,
    wrenches: Mapping[str, Array] | None = None,
) -> tuple[Array, Array, Array]:
    """Return d tau / dq, d tau / dq' and I (n, n each)."""
    return (
        complex_step(lambda x: oracle.inverse_dynamics(x, qd, qdd, wrenches), q),
        complex_step(lambda x: oracle.inverse_dynamics(q, x, qdd, wrenches), qd),
        oracle.inertia_matrix(q),
    )


def forward_derivatives(
    oracle: Oracle,
    q: Array,
    qd: Array,
    qdd: Array,
    wrenches: Mapping[str, Array] | None = None,
) -> tuple[Array, Array, Array]:
    """Return d q'' / dq, d q'' / dq' and I^-1 (n, n each) where the accelerations are q''."""
    by_q, by_rate, inertia = inverse_derivatives(oracle, q, qd, qdd, wrenches)
    inverse: Array = np.linalg.inv(inertia).astype(np.float64)
    return -inverse @ by_q, -inverse @ by_rate, inverse
