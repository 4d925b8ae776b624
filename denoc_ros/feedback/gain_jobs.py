"""Gains of the state feedback as a job of another process: request and result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.feedback.closed_loop import Settling
from denoc_ros.feedback.feedback_design import PostureGains
from denoc_ros.feedback.feedback_settings import FeedbackSettings
from denoc_ros.feedback.gain_schedule import LOWERED, GainSchedule, design, design_along
from denoc_ros.feedback.model_errors import ModelErrors
from denoc_ros.feedback.planned_states import motion_along, state_at
from denoc_ros.feedback.residual_modes import with_residual_modes
from denoc_ros.trajectories import KNOTS, SplineTrajectory
from denoc_ros.types import Array

CHANGED = ('joint_bandwidth', *LOWERED)  # settings that a design may change
ERROR_ARRAYS = ('states', 'torques', 'likely')
INDICES = ('coordinates', 'joints', 'sensors')


@dataclass(frozen=True)
class GainJob:
    """Request for gains, without the robot.

    Attributes
    ----------
    joints : tuple of str
        That are driven.
    limits : (joints,) array
        Effort limits [N m, N].
    posture : (n,) array
        Near which loops are closed.
    settings : FeedbackSettings
    position : (joints,) array
        Where the joints are, if there is no trajectory [rad, m].
    trajectory : SplineTrajectory or None
        Along which gains are wanted.
    """

    joints: tuple[str, ...]
    limits: Array
    posture: Array
    settings: FeedbackSettings
    position: Array
    trajectory: SplineTrajectory | None = None

    def schedule(self, robot: Robot) -> GainSchedule:
        """Return the gains for a robot, shown to be stable.

        Raises
        ------
        StateError, SolverError
            As of :func:`denoc_ros.feedback.gain_schedule.design`.
        """
        settings, path = self.settings, self.trajectory
        robot = with_residual_modes(robot, self.joints)
        if path is None:
            torque = settings.effort_share * self.limits
            states = [state_at(robot, self.joints, self.position, torque, self.posture)]
            return design(robot, self.joints, self.limits, np.zeros(1), states, settings)
        motion = motion_along(
            robot, self.joints, path.sample, path.duration, settings.period, self.posture
        )
        return design_along(robot, self.joints, self.limits, motion, settings)

    def message(self) -> tuple[dict[str, Any], dict[str, Array]]:
        """Return the job as a header that JSON has words for, and arrays."""
        arrays = {'limits': self.limits, 'posture': self.posture, 'position': self.position}
        if self.trajectory is not None:
            arrays.update(zip(KNOTS, self.trajectory.knots(), strict=True))
        # JSON has no infinity
        given = {name: str(value) for name, value in asdict(self.settings).items()}
        return {'job': 'gains', 'joints': list(self.joints), 'settings': given}, arrays


def read_job(header: Mapping[str, Any], arrays: Mapping[str, Array]) -> GainJob:
    """Return the job of a message."""
    given: dict[str, Any] = {
        name: value if name == 'tip' else float(value)
        for name, value in header['settings'].items()
    }
    path = None
    if 'times' in arrays:
        path = SplineTrajectory(arrays['times'], arrays['q'], arrays['qd'], arrays['qdd'])
    return GainJob(
        tuple(header['joints']),
        arrays['limits'],
        arrays['posture'],
        FeedbackSettings(**given),
        arrays['position'],
        path,
    )


def schedule_message(schedule: GainSchedule) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return gains as a header that JSON has words for, and arrays."""
    slowest = schedule.slowest
    arrays = {
        'times': schedule.times,
        'postures': schedule.postures,
        'slowest_posture': slowest.posture,
        **{name: np.asarray(getattr(schedule, name), dtype=np.float64) for name in INDICES},
    }
    for entry in fields(PostureGains):
        arrays[f'gains_{entry.name}'] = np.array(
            [getattr(one, entry.name) for one in schedule.gains]
        )
    errors = schedule.errors
    if errors is not None:
        arrays |= {name: getattr(errors, name) for name in ERROR_ARRAYS}
    proof = (
        slowest.modulus, slowest.stiffness, slowest.load, slowest.frequency, slowest.plant,
        slowest.share,
    )  # fmt: skip
    step = None if errors is None else errors.step
    lower = {name: str(getattr(schedule.settings, name)) for name in CHANGED}
    return {'slowest': list(proof), 'step': step, 'lower': lower}, arrays


def read_schedule(
    header: Mapping[str, Any], arrays: Mapping[str, Array], job: GainJob
) -> GainSchedule:
    """Return the gains that answer a job."""
    modulus, stiffness, load, *rest = header['slowest']
    names = [entry.name for entry in fields(PostureGains)]
    rows = [arrays[f'gains_{name}'] for name in names]
    coordinates, joints, sensors = (arrays[name].astype(np.intp) for name in INDICES)
    lower: dict[str, Any] = {name: float(value) for name, value in header['lower'].items()}
    errors = None
    if header['step'] is not None:
        errors = ModelErrors(header['step'], *(arrays[name] for name in ERROR_ARRAYS))
    return GainSchedule(
        times=arrays['times'],
        gains=tuple(PostureGains(*one) for one in zip(*rows, strict=True)),
        postures=arrays['postures'],
        coordinates=coordinates,
        names=job.joints,
        joints=joints,
        sensors=sensors,
        limits=job.limits,
        settings=replace(job.settings, **lower),
        slowest=Settling(modulus, arrays['slowest_posture'], stiffness, load, *rest),
        errors=errors,
    )


def answer(
    robot: Robot, header: Mapping[str, Any], arrays: Mapping[str, Array]
) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return the gains that a job of the worker process asks for."""
    return schedule_message(read_job(header, arrays).schedule(robot))
