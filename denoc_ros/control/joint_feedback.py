"""Feedback of each joint's own deviation from the plan: collocated, passive but for its delay."""

from __future__ import annotations

import numpy as np

from denoc_ros.control.deviation_model import DeviationModel
from denoc_ros.types import Array

DAMPING = 0.7  # ratio of the joints' motion, links rigid


def joint_inertia(model: DeviationModel) -> Array:
    """Return the inertia matrix (joints, joints) of the driven joints, links and springs rigid.

    Passive coordinates move freely.
    """
    k, rigid = model.joints, np.flatnonzero(model.stiff == 0.0)
    moved = model.measured[:k, rigid]
    mobility = moved @ np.linalg.solve(model.linear.inertia[np.ix_(rigid, rigid)], moved.T)
    return np.asarray(np.linalg.inv(mobility))


def joint_gains(model: DeviationModel, bandwidth: float) -> Array:
    """Return stiffness and damping (joints, 2 joints): torque = -gains [deviations; rates].

    Parameters
    ----------
    model : DeviationModel
    bandwidth : float
        Natural frequency of every joint, links rigid [Hz]; 0: no feedback.
    """
    inertia, omega = joint_inertia(model), 2.0 * np.pi * bandwidth
    return np.hstack([omega**2 * inertia, 2.0 * DAMPING * omega * inertia])
