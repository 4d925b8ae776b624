"""Proof that state feedback is stable, also on robots with modes that it does not know."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from denoc_ros.control.closed_loop import (
    Settling,
    closed_loop,
    joint_loop,
    plants,
    slow_modes,
    slowest_mode,
)
from denoc_ros.control.deviation_model import DeviationModel, PlannedState
from denoc_ros.control.feedback_design import PostureGains
from denoc_ros.control.feedback_settings import FeedbackSettings
from denoc_ros.control.planned_states import state_at
from denoc_ros.control.residual_modes import other_robots
from denoc_ros.dynamics.measured_side import MeasuredStates
from denoc_ros.dynamics.robot import Robot
from denoc_ros.types import Array

TRIED = 3  # postures at which robots with other modes are tried, at most
PARTS = (1.0, 0.5)  # of the feedback: it comes in and goes
Plant = tuple[DeviationModel, float, float, str]


class Proof:
    """Linear models of all the robots that feedback along a plan must hold.

    Parameters
    ----------
    robot : Robot
        Of the design.
    joints : sequence of str
        That are driven.
    sensors : sequence of int
        As of :func:`denoc_ros.control.deviation_model.deviation_model`.
    states : sequence of PlannedState
        Moments of the plan.
    settings : FeedbackSettings
    hard : bool
        Whether to try robots with other modes, too.

    Notes
    -----
    At every posture the robot of the design, its stiffness and the load at its tip off by 20 %
    either way; at some also robots with other shape functions and with beams in segments.
    """

    def __init__(
        self, robot: Robot, joints: Sequence[str], sensors: Sequence[int],
        states: Sequence[PlannedState], settings: FeedbackSettings, hard: bool,
    ) -> None:  # fmt: skip
        seen = MeasuredStates(robot, joints)
        self._settings, self.hard = settings, hard
        self._postures = [seen.posture(state.q) for state in states]
        self._plants: list[list[Plant]] = [
            [(*plant, '') for plant in plants(robot, joints, sensors, state, settings)]
            for state in states
        ]
        others = other_robots(robot) if hard else {}
        for place in np.unique(np.linspace(0, len(states) - 1, TRIED).astype(int)):
            for name, other in others.items():
                self._plants[place][:0] = self._others(
                    robot, other, name, joints, sensors, states[place], self._postures[place]
                )

    def _others(
        self, robot: Robot, other: Robot, name: str, joints: Sequence[str],
        sensors: Sequence[int], state: PlannedState, position: Array,
    ) -> Iterator[Plant]:  # fmt: skip
        posture = np.zeros(other.n)
        posture[other.joint_indices] = state.q[robot.joint_indices]
        there = state_at(other, joints, position, state.torque, posture)
        for model, stiffness, load in plants(other, joints, sensors, there, self._settings):
            yield slow_modes(model), stiffness, load, name

    def slowest(self, gains: Sequence[PostureGains]) -> Settling:
        """Return the slowest mode over all postures and robots, or the first unstable one.

        Parameters
        ----------
        gains : sequence of PostureGains
            Of the loop at each of the states.
        """
        settings, found = self._settings, []
        for posture, here, gain in zip(self._postures, self._plants, gains, strict=True):
            for model, stiffness, load, name in here:
                for part in PARTS if self.hard else PARTS[:1]:
                    step = closed_loop(model, gain, settings, part)
                    modulus, hertz = slowest_mode(step, settings.period)
                    found.append(Settling(modulus, posture, stiffness, load, hertz, name, part))
                    if not modulus < 1.0 and self.hard:
                        return found[-1]
        return max(found, key=lambda one: one.modulus)

    def slowest_of_joints(self, gains: Sequence[Array]) -> Settling:
        """Return the slowest mode that vibrates with the joints' own feedback alone.

        Parameters
        ----------
        gains : sequence of (joints, 2 joints) arrays
            Of the joints at each of the states.
        """
        settings, found = self._settings, []
        for posture, here, gain in zip(self._postures, self._plants, gains, strict=True):
            for model, stiffness, load, name in here:
                modulus, hertz = slowest_mode(joint_loop(model, gain, settings), settings.period)
                found.append(Settling(modulus, posture, stiffness, load, hertz, name, 0.0))
        return max(found, key=lambda one: one.modulus)
