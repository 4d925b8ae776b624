"""A planar cantilever as rigid rods on sprung hinges: an oracle for large bending.

Exact for any rotation, of second order in the length of a rod: two numbers of rods and
Richardson's extrapolation give the inextensible elastica. Nothing of denoc_ros is used.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh

from denoc_ros.types import Array


class HingedRods:
    """Length 1 m, EI 1 N m^2, mass 1 kg, clamped horizontally, under gravity across it.

    Parameters
    ----------
    rods : int
    weight : float
        [N/m], downwards.

    Notes
    -----
    Absolute angles a_k of the rods; midpoints at h sum_{j<k} t_j + h t_k / 2. Hinge springs
    EI / h between rods and 2 EI / h at the clamp, half a rod away from the first midpoint.
    """

    def __init__(self, rods: int, weight: float) -> None:
        self.h, self.weight, self.rods = 1.0 / rods, weight, rods
        # position of each midpoint per tangent of each rod, (rods, rods)
        self.reach = self.h * (np.tril(np.ones((rods, rods)), -1) + 0.5 * np.eye(rods))
        difference = np.eye(rods) - np.eye(rods, k=-1)
        spring = np.full(rods, 1.0 / self.h)
        spring[0] *= 2.0
        self.stiffness = difference.T @ (spring[:, None] * difference)
        self.lever = weight * self.h * self.reach.sum(axis=0)  # dV/da_k = lever_k cos a_k
        self.angles = self._rest()

    def _rest(self) -> Array:
        angles = np.zeros(self.rods)
        for _ in range(50):
            force = self.stiffness @ angles + self.lever * np.cos(angles)
            step = np.linalg.solve(self._tangent(angles), force)
            angles -= step
            if np.abs(step).max() < 1e-14:
                break
        return angles

    def _tangent(self, angles: Array) -> Array:
        return np.asarray(self.stiffness - np.diag(self.lever * np.sin(angles)))

    @property
    def tip(self) -> Array:
        """Position of the tip (x, y) [m]."""
        return self.h * np.array([np.cos(self.angles).sum(), np.sin(self.angles).sum()])

    @property
    def frequency(self) -> float:
        """Lowest natural frequency about rest [Hz]."""
        across = np.cos(self.angles[:, None] - self.angles)
        mass = self.h * (self.reach.T @ self.reach) * across
        mass += np.eye(self.rods) * self.h**3 / 12.0
        square = eigh(self._tangent(self.angles), mass, eigvals_only=True, subset_by_index=[0, 0])
        return float(np.sqrt(square[0]) / (2.0 * np.pi))


def sagging(weight: float, rods: int = 80) -> tuple[Array, float]:
    """Return the tip (x, y) [m] and the lowest frequency [Hz] of the strip, extrapolated."""
    coarse, fine = HingedRods(rods, weight), HingedRods(2 * rods, weight)
    frequency = fine.frequency + (fine.frequency - coarse.frequency) / 3.0
    return np.asarray(fine.tip + (fine.tip - coarse.tip) / 3.0), frequency
