"""Finite rotations of cross-sections: Exp, its left Jacobian and its inverse, over any rows."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from denoc_ros.kernels.algebra.rotation import write_quaternion
from denoc_ros.types import Array

SMALL = 1e-2  # rad^2, below which series take over


def cross_matrices(vectors: Array) -> Array:
    """Return v x (..., 3, 3) of vectors (..., 3)."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    cross = np.zeros((*vectors.shape, 3))
    cross[..., 0, 1], cross[..., 0, 2], cross[..., 1, 2] = -z, y, -x
    cross[..., 1, 0], cross[..., 2, 0], cross[..., 2, 1] = z, -y, x
    return cross


def rotations(vectors: Array) -> Array:
    """Return Exp of rotation vectors: (..., 3) [rad] to (..., 3, 3)."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    cross = cross_matrices(vectors)
    return np.asarray(np.eye(3) + first * cross + second * np.matmul(cross, cross))


def rotation_vectors(turns: Array) -> Array:
    """Return the rotation vectors (..., 3) [rad], at most pi long, of rotations (..., 3, 3)."""
    found = Rotation.from_matrix(turns.reshape(-1, 3, 3)).as_rotvec()
    return np.asarray(found.reshape(turns.shape[:-1]))


def quaternion(rotation: Array) -> Array:
    """Return the quaternion x, y, z, w of a rotation (3, 3): w >= 0, or the first other > 0."""
    found = np.empty(4)
    write_quaternion(np.ascontiguousarray(rotation, dtype=np.float64), found)
    return found


def left_jacobians(vectors: Array) -> Array:
    """Return J (..., 3, 3) with omega = J d(phi)/dt of rotation vectors phi (..., 3).

    Notes
    -----
    J = 1 + b K + c K^2 with K = phi x, b = (1 - cos t) / t^2, c = (1 - sin t / t) / t^2 and
    t = |phi|.
    """
    b, c = _coefficients(np.sum(vectors * vectors, axis=-1))
    cross = cross_matrices(vectors)
    return np.asarray(
        np.eye(3) + b[..., None, None] * cross + c[..., None, None] * np.matmul(cross, cross)
    )


def left_jacobian_rates(vectors: Array, rates: Array) -> Array:
    """Return dJ/dt (..., 3, 3) of rotation vectors (..., 3) and their rates (..., 3)."""
    square = np.sum(vectors * vectors, axis=-1)
    b, c = _coefficients(square)
    b_rate, c_rate = (slope * np.sum(vectors * rates, axis=-1) for slope in _slopes(square, b, c))
    k, k_rate = cross_matrices(vectors), cross_matrices(rates)
    b, c, b_rate, c_rate = (value[..., None, None] for value in (b, c, b_rate, c_rate))
    mixed = np.matmul(k_rate, k) + np.matmul(k, k_rate)
    return np.asarray(b_rate * k + b * k_rate + c_rate * np.matmul(k, k) + c * mixed)


def _coefficients(square: Array) -> tuple[Array, Array]:
    """Return b and c at squares of angles."""
    angle = np.sqrt(square)
    b = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    safe = np.where(square < SMALL, 1.0, square)
    series = 1 / 6 - square / 120 * (1 - square / 42 * (1 - square / 72))
    return b, np.where(square < SMALL, series, (1.0 - np.sinc(angle / np.pi)) / safe)


def _slopes(square: Array, b: Array, c: Array) -> tuple[Array, Array]:
    """Return (db/dt) / (phi . phi') and (dc/dt) / (phi . phi')."""
    safe = np.where(square < SMALL, 1.0, square)
    of_b = (np.sinc(np.sqrt(square) / np.pi) - 2.0 * b) / safe
    of_c = (b - 3.0 * c) / safe
    series_b = -1 / 12 + square / 180 * (1 - square * 3 / 112)
    series_c = -1 / 60 + square / 1260 * (1 - square / 48)
    return np.where(square < SMALL, series_b, of_b), np.where(square < SMALL, series_c, of_c)
