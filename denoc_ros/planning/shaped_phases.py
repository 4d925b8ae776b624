"""The plans of a session's phases that shape their reference."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Any

import numpy as np

from denoc_ros.cli.session.session_config import Phase, SessionConfig
from denoc_ros.dynamics.driven.driven_joints import all_joints
from denoc_ros.dynamics.driven.motion_plan import Plan
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError, SolverError, StateError
from denoc_ros.planning.shape_motion import shape_motion
from denoc_ros.trajectories import Trajectory
from denoc_ros.types import Array

ASKED_STEP = 0.01  # s between the points of the motion that is asked for


def plans_of(
    config: SessionConfig,
    phases: Sequence[Phase],
    robot: Robot,
    trajectory: Trajectory | None,
    joints: Sequence[str],
    step: Callable[[str], AbstractContextManager[Any]],
) -> dict[str, Plan]:
    """Return the plan of each phase that shapes the reference, by the phase's name.

    Parameters
    ----------
    phases : sequence of Phase
        Those that are planned for.
    robot : Robot
        As the file has it; the plan is made with the overrides that the nodes have.

    Raises
    ------
    ConfigError
        There is nothing to shape, the method refuses its options, or finds no motion.
    """
    plans: dict[str, Plan] = {}
    shaped = [phase for phase in phases if phase.shape]
    if trajectory is None:
        raise ConfigError(str(config.path), ['phases that shape must have a reference, got none'])
    for phase in shaped:
        overrides = config.model_in(phase)
        model = robot.with_overrides(overrides) if overrides else robot.copy()
        times, q = _asked(config, model, trajectory, joints)
        options = dict(phase.shape)
        method = options.pop('method')
        if config.joints and method == 'tip':
            options = {'joints': list(joints), **options}
        if len(model.base_indices) and _flies(config, phase):
            options = {'base': 'free_flying', **options}
        try:
            with step(f'shaping the reference: {phase.name}'):
                plans[phase.name] = shape_motion(
                    model, times, q, method, options.pop('tip', config.tip or None), **options
                )
        except (StateError, SolverError, TypeError) as error:
            found = [f'phase {phase.name!r}: shape: {error}']
            raise ConfigError(str(config.path), found) from error
    return plans


def _flies(config: SessionConfig, phase: Phase) -> bool:
    """Say whether the feedforward takes a base that would float for one that thrusters hold."""
    nodes = (config.nodes, phase.nodes)
    given = {key: value for part in nodes for key, value in part.get('feedforward', {}).items()}
    return given.get('base') == 'free_flying'


def _asked(
    config: SessionConfig, robot: Robot, trajectory: Trajectory, joints: Sequence[str]
) -> tuple[Array, Array]:
    """Return times (k,) and positions (k, joints) of all joints for the driven ones' motion."""
    times, driven, _, _ = trajectory.table(ASKED_STEP)
    posture = np.zeros(robot.n)
    posture[robot.joint_indices] = config.nodes['plant'].get('posture') or 0.0
    try:
        return times, all_joints(robot, joints, driven, posture)
    except (StateError, SolverError) as error:
        raise ConfigError(str(config.path), [f'reference: {error}']) from error
