"""The rates at which the feedback of a session is stable, shown before it runs there."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from denoc_ros.cli.config import Parameters, Phase, SessionConfig
from denoc_ros.cli.node_parameters import node_parameters, node_table
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError, SolverError, StateError
from denoc_ros.runtime.live_state_feedback import LiveStateFeedback
from denoc_ros.runtime.strain_feedback import StrainFeedback
from denoc_ros.runtime.torque import torque_limits

FEEDFORWARD = 'feedforward'
PATIENCE = 60.0  # s for the gains of a phase


def feedback_refusal(
    config: SessionConfig, robot: Robot, rate: float, patience: float = PATIENCE
) -> str:
    """Why a phase's feedback cannot run at a rate, by the design's own check; '' if all can.

    Parameters
    ----------
    config : SessionConfig
        Its phases may each have another feedback.
    robot : Robot
        As its file describes it.
    rate : float
        Of the feedforward's loop [Hz].
    patience : float
        For the gains of a phase [s].
    """
    model = robot.with_overrides(config.model)
    shown: list[Parameters] = []
    for phase in config.phases:
        given = _given(config, phase, rate)
        if given in shown:
            continue
        if trouble := _trouble(model, given, patience):
            return f'feedback of phase “{phase.name}” does not hold at {rate:g} Hz: {trouble}'
        shown.append(given)
    return ''


def _given(config: SessionConfig, phase: Phase, rate: float) -> Parameters:
    given = node_parameters(config, FEEDFORWARD, phase, Path())
    given.pop('use_sim_time', None)
    if 'update_rate' not in phase.nodes.get(FEEDFORWARD, {}):
        given['update_rate'] = rate
    return given


def _trouble(robot: Robot, given: Parameters, patience: float) -> str:
    """Why the feedback of these parameters is refused, '' if it is not."""
    settings = node_table(FEEDFORWARD).settings(given, FEEDFORWARD)
    joints = settings.texts('joints') or list(robot.tree.non_mimic_joints)
    posture = np.zeros(robot.n)
    posture[robot.joint_indices] = settings.numbers('posture') or 0.0
    state = LiveStateFeedback(FEEDFORWARD)
    try:
        limits = torque_limits(robot, joints, settings)
        StrainFeedback(FEEDFORWARD).build(robot, joints, settings, limits)
        state.build(robot, joints, settings, limits, posture, patience)
        return f'no gains within {patience:g} s' if state.busy else ''
    except ConfigError as error:
        return '; '.join(error.findings)
    except (StateError, SolverError, ValueError) as error:
        return str(error)
    finally:
        state.close()
