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
# of the largest acceleration of an amplitude: what gets less from any motion of the joints stays
LEAST_PUSH = 1e-6


def reading_changes(robot: Robot, others: Iterable[Robot]) -> Array:
    """Return how readings at random states differ from a robot's (readings, robots).

    Readings are generalized forces and sensor values, each as a share of its rms: with all joints
    and amplitudes at random, what changes none of them changes nothing that can be measured.
    """
    states = _random_states(robot)
    here = _readings(robot, states)
    size = np.maximum(np.sqrt(np.mean(here**2, axis=0)), 1e-300)
    changes = [((_readings(other, states) - here) / size).ravel() for other in others]
    return np.asarray(np.reshape(changes, (len(changes), here.size)).T)


def _random_states(robot: Robot) -> Array:
    """Return coordinates, rates and accelerations (3, k, n), 0 of amplitudes that stay at rest.

    Those are amplitudes that neither the joints nor the other amplitudes accelerate.
    """
    bends, joints = robot.flexible_indices, robot.joint_indices
    states: Array = np.random.default_rng(0).standard_normal((3, STATES, robot.n))
    states[0][:, bends] *= BENT
    is_bend = np.isin(np.setdiff1d(np.arange(robot.n), joints), bends)
    at_rest = np.ones(len(bends), dtype=bool)
    while True:
        found: Array = states.copy()
        found[:, :, bends[at_rest]] = 0.0
        _, free = robot.hybrid_dynamics(found[0], found[1], found[2][:, joints])
        pushed = np.abs(free[:, is_bend]).max(axis=0, initial=0.0)
        still = at_rest & (pushed <= LEAST_PUSH * pushed.max(initial=0.0))
        if (still == at_rest).all():
            return np.asarray(found)
        at_rest = still


def _readings(robot: Robot, states: Array) -> Array:
    return np.hstack([robot.inverse_dynamics(*states), robot.sensor_values(*states)])
