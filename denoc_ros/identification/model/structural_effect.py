"""Readings of a robot at random states, by which a number without effect shows.

The load of a planar robot may lie anywhere across the plane of its motion: neither torque nor
deflection nor sensor depends on it. No recording is to blame for that, and no motion helps.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.types import Array

STATES = 24  # random states that robots are compared at
BENT = 1e-3  # m or rad: deviation of the amplitudes in them


def reading_changes(robot: Robot, others: Iterable[Robot]) -> Array:
    """Return how readings at random states differ from a robot's (readings, robots).

    Readings are generalized forces and sensor values, each as a share of its rms: with all joints
    and amplitudes at random, what changes none of them changes nothing that can be measured.
    """
    states = np.random.default_rng(0).standard_normal((3, STATES, robot.n))
    states[0][:, robot.flexible_indices] *= BENT
    here = _readings(robot, states)
    size = np.maximum(np.sqrt(np.mean(here**2, axis=0)), 1e-300)
    changes = [((_readings(other, states) - here) / size).ravel() for other in others]
    return np.asarray(np.reshape(changes, (len(changes), here.size)).T)


def _readings(robot: Robot, states: Array) -> Array:
    return np.hstack([robot.inverse_dynamics(*states), robot.sensor_values(*states)])
