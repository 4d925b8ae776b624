"""Truncated power series: order 2 in time, order 1 in any number of directions.

The arithmetic of test/support/oracles/oracles.py. A `Jet` holds `c[i, 0]`, the coefficient of t^i,
and `c[i, 1 + k]`, the coefficient of t^i e_k with e_k e_l = 0. Derivatives come out exact.
Coefficients may be complex: a step along the imaginary axis gives one more derivative.
"""

from __future__ import annotations

from collections.abc import Callable
from math import factorial

import numpy as np

from denoc_ros.types import Array

ORDERS = 3


class Jet:
    """A series with coefficients `c` of shape (3, 1 + directions, *shape)."""

    __array_ufunc__ = None  # so that ndarray @ Jet and ndarray * Jet come to us

    def __init__(self, c: Array) -> None:
        self.c = c

    @classmethod
    def constant(cls, value: Array, directions: int) -> Jet:
        """Series of a constant."""
        c = np.zeros((ORDERS, 1 + directions, *np.shape(value)), np.result_type(value, float))
        c[0, 0] = value
        return cls(c)

    @property
    def value(self) -> Array:
        """Value at t = 0."""
        return np.asarray(self.c[0, 0])

    @property
    def rate(self) -> Array:
        """First time derivative."""
        return np.asarray(self.c[1, 0])

    @property
    def acceleration(self) -> Array:
        """Second time derivative."""
        return np.asarray(2 * self.c[2, 0])

    def __getitem__(self, key: object) -> Jet:
        keys = key if isinstance(key, tuple) else (key,)
        return Jet(self.c[(slice(None), slice(None)) + keys])

    def __add__(self, other: Jet | Array | float) -> Jet:
        if isinstance(other, Jet):
            return Jet(self.c + other.c)
        c = self.c.astype(np.result_type(self.c, other))
        c[0, 0] += other
        return Jet(c)

    def __neg__(self) -> Jet:
        return Jet(-self.c)

    def __sub__(self, other: Jet | Array | float) -> Jet:
        return self + (-other)

    def __mul__(self, other: Jet | Array | float) -> Jet:
        """Elementwise; shapes must be equal, or `other` a constant."""
        if isinstance(other, Jet):
            return _bilinear(self.c, other.c, np.multiply)
        return Jet(self.c * other)

    __rmul__ = __mul__
    __radd__ = __add__

    def __matmul__(self, other: Jet | Array) -> Jet:
        if isinstance(other, Jet):
            return _bilinear(self.c, other.c, np.matmul)
        return Jet(self.c @ other)

    def __rmatmul__(self, other: Array) -> Jet:
        return Jet(other @ self.c)

    def transpose(self) -> Jet:
        """Of the last two axes."""
        return Jet(np.swapaxes(self.c, -1, -2))

    def derivative(self) -> Jet:
        """By time; the highest order is lost (left zero)."""
        c = np.zeros_like(self.c)
        c[0], c[1] = self.c[1], 2 * self.c[2]
        return Jet(c)


def _bilinear(a: Array, b: Array, product: Callable[..., Array]) -> Jet:
    pairs = [(i, j) for i in range(ORDERS) for j in range(ORDERS - i)]
    shape = product(a[0, 0], b[0, 0]).shape
    c = np.zeros((ORDERS, a.shape[1], *shape), np.result_type(a, b))
    for i, j in pairs:
        c[i + j, 0] += product(a[i, 0], b[j, 0])
        c[i + j, 1:] += product(a[i, 1:], b[j, :1]) + product(a[i, :1], b[j, 1:])
    return Jet(c)


def compose(derivatives: list[Array], x: Jet) -> Jet:
    """f(x) from f and its first three derivatives at `x.value`."""
    step = Jet(x.c.copy())
    step.c[0, 0] = 0
    total, power = Jet.constant(derivatives[0], x.c.shape[1] - 1), step
    for order in range(1, ORDERS + 1):
        total = total + power * (derivatives[order] / factorial(order))
        power = power * step
    return total


def sin(x: Jet) -> Jet:
    """Sine."""
    s, c = np.sin(x.value), np.cos(x.value)
    return compose([s, c, -s, -c], x)


def cos(x: Jet) -> Jet:
    """Cosine."""
    s, c = np.sin(x.value), np.cos(x.value)
    return compose([c, -s, -c, s], x)


def even_series(x: Jet, first: int, terms: int = 24) -> Jet:
    """Sum of (-x)^k / (2 k + first)!: sin(r)/r (first 1), (1 - cos r)/r^2 (2), at x = r^2."""
    coefficients = np.array([(-1.0) ** k / factorial(2 * k + first) for k in range(terms)])
    polynomial = np.polynomial.Polynomial(coefficients)
    return compose(
        [polynomial.deriv(k)(x.value) if k else polynomial(x.value) for k in range(4)], x
    )


def stack(parts: list[Jet], axis: int = 0) -> Jet:
    """Join scalar or array series along a new axis of the value."""
    return Jet(np.stack([part.c for part in parts], axis=2 + axis))


def cross_matrix(v: Jet) -> Jet:
    """(3,) series to the (3, 3) series of its cross product."""
    zero = v[0] * 0.0
    rows = [[zero, -v[2], v[1]], [v[2], zero, -v[0]], [-v[1], v[0], zero]]
    return stack([stack(row) for row in rows])


def rotation(vector: Jet) -> Jet:
    """Exp of a rotation vector (3,): a (3, 3) series."""
    square = vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]
    K = cross_matrix(vector)
    a = even_series(square, 1)[None, None]
    b = even_series(square, 2)[None, None]
    tile = np.ones((3, 3))
    return K * (a * tile) + (K @ K) * (b * tile) + np.eye(3)
