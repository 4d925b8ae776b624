"""Viscous and Coulomb friction of joints, and an offset, as torque."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from denoc_ros.model.arrays import SLIP_RATE
from denoc_ros.types import Array


@dataclass(frozen=True)
class JointFriction:
    """Friction of joints: viscous q' + coulomb tanh(q' / 1e-3) + offset.

    Attributes
    ----------
    viscous : (joints,) array
        [N m s/rad, N s/m]
    coulomb, offset : (joints,) array
        [N m, N]
    """

    viscous: Array
    coulomb: Array
    offset: Array

    def torque(self, qd: Array) -> Array:
        """Return viscous and Coulomb friction (k, joints) at rates; the offset is not in it."""
        friction: Array = self.viscous * qd + self.coulomb * np.tanh(qd / SLIP_RATE)
        return friction
