"""Received whole motions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from denoc_ros.runtime.input_error import InputError
from denoc_ros.runtime.trajectory_messages import TrajectoryMessage
from denoc_ros.trajectories import SplineTrajectory
from denoc_ros.types import Array

LONGEST = 1e4  # s of a motion, of which a plan has a sample each 0.01 s
RESTING = 1e-3  # rad/s or m/s at the ends that count as rest


@dataclass(frozen=True)
class RequestedMotion:
    """A received motion.

    Attributes
    ----------
    message : TrajectoryMessage
    where : (joints,) array or None
        Where the joints stand.
    """

    message: TrajectoryMessage
    where: Array | None

    @property
    def named(self) -> list[int] | None:
        """Places of the joints that the message names; None: all."""
        if not self.message.held:
            return None
        joints = range(self.message.positions.shape[1])
        return [k for k in joints if k not in self.message.held]

    def whole(self) -> TrajectoryMessage:
        """Return the message with all joints: those that it does not name stay."""
        if not self.message.held:
            return self.message
        assert self.where is not None
        return self.message.holding(self.where)

    def trajectory(self) -> SplineTrajectory:
        """Return the motion of all joints, from time 0 on.

        Raises
        ------
        InputError
            Cause `not_at_rest`: it begins or ends in motion; `too_long`: it would have more
            samples than a plan may.
        """
        message = self.whole()
        if not message.times[-1] <= LONGEST:
            raise InputError(
                'too_long',
                f'a motion must take at most {LONGEST:g} s, got {message.times[-1]:g} s',
            )
        rates = message.velocities
        starts_here = message.times[0] == 0.0
        if rates is not None:
            ends = rates[[0, -1]] if starts_here else rates[[-1]]
            if (largest := float(np.abs(ends).max())) > RESTING:
                raise InputError(
                    'not_at_rest', f'a motion must begin and end at rest, got {largest:.3g} rad/s'
                )
        first = None
        if not starts_here:
            assert self.where is not None
            none = np.zeros(len(self.where))
            first = self.where, none, none
        trajectory = SplineTrajectory(
            message.times, message.positions, rates, message.accelerations, first
        )
        if not trajectory.duration > 0.0:
            raise InputError('not_at_rest', 'a motion must take time, got a single posture')
        return trajectory
