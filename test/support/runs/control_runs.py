"""Motions that the tests of plans ask for, and plans carried out by the simulation."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.interpolate import make_interp_spline

import denoc_ros as dn
from denoc_ros.dynamics.driven.motion_plan import Plan
from denoc_ros.simulation.simulate import Run
from denoc_ros.types import Array

Reference = Callable[[Array], Array]
ROBOTS = Path(__file__).resolve().parents[3] / 'config' / 'robots'


def cycloid(start: Array, end: Array, duration: float) -> Reference:
    """Return the motion (k, joints) at times (k,) from rest to rest of eq. 4.1."""

    def sample(t: Array) -> Array:
        phase = 2.0 * np.pi * np.clip(t, 0.0, duration) / duration
        share = (phase - np.sin(phase)) / (2.0 * np.pi)
        return np.asarray(start + (np.asarray(end) - start) * share[:, None])

    return sample


def carried_out(
    robot: dn.Robot, plan: Plan, after: float, step: float = 0.02, rtol: float = 1e-9
) -> Run:
    """Return what a robot does under a plan's torque alone, and some seconds at rest after it."""
    torque = make_interp_spline(plan.t, plan.torque, k=3)
    driven, zero = robot.indices(plan.joint_names), np.zeros(robot.n)

    def given(t: float, _q: Array, _qd: Array) -> Array:
        tau = zero.copy()
        tau[driven] = torque(min(t, float(plan.t[-1])))
        return np.asarray(tau)

    times = np.arange(plan.t[0], plan.t[-1] + after, step)
    run: Run = dn.simulate(robot, plan.q[0], zero, times, torque=given, rtol=rtol, atol=1e-12)
    return run


def strayed(robot: dn.Robot, frame: str, run: Run, asked_joints: Array) -> Array:
    """Return how far (k,) [m] a frame is from where the undeformed robot would have it."""
    asked = np.zeros_like(run.q)
    asked[:, robot.joint_indices] = asked_joints
    apart = robot.frame_pose(frame, run.q)[:, :3, 3] - robot.frame_pose(frame, asked)[:, :3, 3]
    return np.asarray(np.linalg.norm(apart, axis=1))
