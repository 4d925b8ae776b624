"""Planned motions of a session's phases: what the joints and the plant do in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from denoc_ros.cli.session.session_config import Phase
from denoc_ros.dynamics.driven.motion_plan import Plan
from denoc_ros.trajectories import SplineTrajectory, Trajectory


def motion_of(plan: Plan, joints: Sequence[str]) -> SplineTrajectory:
    """Motion of the joints in a plan, from its first row on."""
    columns = [plan.coordinate_names.index(joint) for joint in joints]
    return SplineTrajectory(
        plan.t - plan.t[0], plan.q[:, columns], plan.qd[:, columns], plan.qdd[:, columns]
    )


def asked_at_pace(trajectory: Trajectory, plan: Plan, joints: Sequence[str]) -> Trajectory:
    """Wanted motion of the joints at the pace of a plan that changes it."""
    if plan.passed is None and plan.stretch == 1.0:
        return trajectory
    passed = plan.t / plan.stretch if plan.passed is None else plan.passed
    times = np.concatenate([[0.0], plan.t[plan.t > 0.0]])
    moments = np.clip(np.interp(times, plan.t, passed), 0.0, trajectory.duration)
    rows, rate, acceleration = np.zeros((len(times), len(joints))), *np.zeros((2, len(joints)))
    for moment, row in zip(moments.tolist(), rows, strict=True):
        trajectory.sample(moment, row, rate, acceleration)
    return SplineTrajectory(times, rows)


def started_on_the_plan(phase: Phase, plan: Plan, joints: Sequence[str]) -> Phase:
    """Return a phase whose plant starts where the plan does, unless it says where."""
    plant = phase.nodes.get('plant', {})
    if 'start' in plant:
        return phase
    columns = [plan.coordinate_names.index(joint) for joint in joints]
    start = plan.q[0, columns].tolist()
    return replace(phase, nodes={**phase.nodes, 'plant': {**plant, 'start': start}})
