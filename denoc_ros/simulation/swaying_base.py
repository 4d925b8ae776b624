"""A base that sways: six harmonic motions, as of a ship in waves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from denoc_ros.dynamics.base_motion import BaseMotion
from denoc_ros.model.poses import rotation_rpy
from denoc_ros.types import Array

SHIFTS = ('surge', 'sway', 'heave')  # m, along the world's x, y, z
TURNS = ('roll', 'pitch', 'yaw')  # rad, about x, then the turned y, then the turned z


@dataclass(frozen=True)
class Harmonic:
    """amplitude * sin(2 pi t / period + phase)."""

    amplitude: float  # m or rad
    period: float  # s
    phase: float = 0.0  # rad

    def __call__(self, t: float) -> tuple[float, float, float]:
        """Return value, rate and acceleration at a time [s]."""
        w = 2.0 * np.pi / self.period
        sine, cosine = np.sin(w * t + self.phase), np.cos(w * t + self.phase)
        return self.amplitude * sine, self.amplitude * w * cosine, -self.amplitude * w * w * sine


class SwayingBase:
    """The motion of a base by harmonics of its position and of roll, pitch and yaw.

    Parameters
    ----------
    motions : mapping of str to Harmonic
        Of `SHIFTS` and `TURNS`; what is not named stays zero.
    """

    def __init__(self, motions: Mapping[str, Harmonic]) -> None:
        still = Harmonic(0.0, 1.0)
        self._motions = [motions.get(name, still) for name in (*SHIFTS, *TURNS)]

    def __call__(self, t: float) -> BaseMotion:
        """Return twist, acceleration and pose at a time [s]."""
        place, rate, up = np.array([motion(t) for motion in self._motions]).T
        turn = rotation_rpy(place[3:])
        spin, grow = _turning(place[3:], rate[3:], up[3:])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn, place[:3]
        twist = np.concatenate([rate[:3] @ turn, spin])
        return BaseMotion(twist, np.concatenate([up[:3] @ turn, grow]), pose)


def _turning(angles: Array, rates: Array, up: Array) -> tuple[Array, Array]:
    """Return angular velocity and acceleration in base axes of roll, pitch and yaw."""
    (ca, cb, _), (sa, sb, _) = np.cos(angles), np.sin(angles)
    a, b, _ = rates
    axes = np.array([[1.0, 0.0, -sb], [0.0, ca, cb * sa], [0.0, -sa, cb * ca]])
    change = np.array(
        [
            [0.0, 0.0, -b * cb],
            [0.0, -a * sa, -b * sb * sa + a * cb * ca],
            [0.0, -a * ca, -b * sb * ca - a * cb * sa],
        ]
    )
    return axes @ rates, axes @ up + change @ rates
