"""Friction of joints: viscous, and Coulomb friction that rises with the rate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from denoc_ros.types import Array

SLIP_RATE = 1e-3  # rad/s or m/s, at which Coulomb friction has risen to tanh 1 of its force


def slip(rate: Array | float) -> Array:
    """Return the share of Coulomb friction that acts at rates."""
    return np.asarray(np.tanh(rate / SLIP_RATE))


@dataclass(frozen=True)
class Friction:
    """Friction viscous q' + coulomb tanh(q' / SLIP_RATE) of joints, against their motion."""

    viscous: Array  # (joints,) [N m s/rad, N s/m]
    # (joints,) [N m, N]; the offset is an effort's beside friction
    coulomb: Array
    offset: Array | float = 0.0

    def force(self, rate: Array | float) -> Array:
        """Return viscous and Coulomb friction (..., joints) at rates; the offset is not in it."""
        return np.asarray(self.viscous * rate + self.coulomb * slip(rate))

    def slope(self, rate: Array | float) -> Array:
        """Return the derivative of the force by the rates (..., joints)."""
        return np.asarray(self.viscous + self.coulomb / SLIP_RATE * (1.0 - slip(rate) ** 2))
