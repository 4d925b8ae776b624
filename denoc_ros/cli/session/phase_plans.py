"""Planned motions of a session's phases: what the joints and the plant do in them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from denoc_ros.cli.progress import Progress
from denoc_ros.cli.session.session_config import Phase, SessionConfig
from denoc_ros.dynamics.driven.motion_plan import Plan
from denoc_ros.dynamics.robot import Robot
from denoc_ros.parts import required
from denoc_ros.trajectories import SplineTrajectory, Trajectory


@dataclass(frozen=True)
class Task:
    """The task of a session: follow a trajectory, phase by phase, or play a bag."""

    trajectory: Trajectory | None  # None: the reference comes from elsewhere, phases just last
    joints: list[str]  # the trajectory's
    duration: float  # of each phase [s]
    bag: Path | None = None  # Joint states to play instead of running a plant
    # what the joints do instead of the trajectory in phases that shape it
    plans: Mapping[str, Plan] = field(default_factory=dict)


@dataclass(frozen=True)
class PlannedPhases:
    """Phases whose plant starts where their plan does, and the task with these plans."""

    phases: tuple[Phase, ...]
    task: Task


def with_plans(
    config: SessionConfig, robot: Robot, task: Task, phases: Sequence[Phase], progress: Progress
) -> PlannedPhases:
    """Plan phases that shape the reference; others stay as they are.

    Raises
    ------
    DenocError
        The planner is not there or finds no motion.
    """
    if not any(phase.shape for phase in phases):
        return PlannedPhases(tuple(phases), task)
    planner = required('planning.shaped_phases', f'{config.path}: phases: shape')
    plans: dict[str, Plan] = planner.plans_of(
        config, phases, robot, task.trajectory, task.joints, progress.step
    )
    started = tuple(
        started_on_the_plan(phase, plans[phase.name], task.joints)
        if phase.name in plans
        else phase
        for phase in phases
    )
    return PlannedPhases(started, replace(task, plans={**task.plans, **plans}))


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
