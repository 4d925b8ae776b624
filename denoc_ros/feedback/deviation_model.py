"""Linear model of small deviations from a planned motion, with sensor rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.linalg

from denoc_ros.dynamics.driven.driven_motion import driven_motion
from denoc_ros.dynamics.linear.linear_model import DiscreteModel, LinearModel
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import StateError
from denoc_ros.model.coordinates import spring_name
from denoc_ros.model.link_side import motors_behind
from denoc_ros.types import Array


@dataclass(frozen=True)
class PlannedState:
    """A moment of the plan.

    q, qd (n,) coordinates and rates; tau (n,) generalized forces; `torque` (joints,) and `bent`
    (flexible,) sizes of torques [N m, N] and amplitudes [m, rad] about that moment.
    """

    q: Array
    qd: Array
    tau: Array
    torque: Array
    bent: Array


@dataclass(frozen=True)
class DeviationModel:
    """Deviations y = [minimal coordinates; rates] about a moment of a plan.

    Attributes
    ----------
    linear : LinearModel
        Inputs: the driven joints, then generalized forces on the amplitudes.
    joints : int
        How many joints are driven.
    measured : (2 joints + sensors, 2 m) array
        Of the driven joints' positions and rates, as joint states have them, and of the sensors'
        values, by y.
    tip : (6, m) array
        Of the tip's position and small rotation.
    stiff : (m,) array
        Elastic stiffness of the coordinates.
    """

    linear: LinearModel
    joints: int
    measured: Array
    tip: Array
    stiff: Array
    _sampled: dict[tuple[float, float], DiscreteModel] = field(
        init=False, repr=False, compare=False, default_factory=dict
    )

    @property
    def size(self) -> int:
        """How many minimal coordinates there are."""
        return len(self.linear.inertia)

    @property
    def softness(self) -> Array:
        """Deviations (m,) of equal elastic energy, the largest 1; 1 where nothing is elastic."""
        least = self.stiff[self.stiff > 0.0].min(initial=np.inf)
        return np.asarray(
            np.sqrt(np.divide(least, self.stiff, np.ones(self.size), where=self.stiff > 0.0))
        )

    def varied(self, stiffness: float) -> DeviationModel:
        """Return the model with all elastic stiffness times a factor."""
        m, linear = self.size, self.linear
        a = linear.a.copy()
        a[m:, :m] -= (stiffness - 1.0) * np.linalg.solve(linear.inertia, np.diag(self.stiff))
        return replace(self, linear=replace(linear, a=a))

    def damped(self, above: float, ratio: float) -> DeviationModel:
        """Return the model with modes above a frequency [Hz] damped by a ratio more."""
        m, linear = self.size, self.linear
        values, shapes = scipy.linalg.eigh(np.diag(self.stiff), linear.inertia)
        omega = np.sqrt(np.maximum(values, 0.0))
        more = np.where(omega > 2.0 * np.pi * above, 2.0 * ratio * omega, 0.0)
        a = linear.a.copy()
        a[m:, m:] -= (shapes * more) @ shapes.T @ linear.inertia
        return replace(self, linear=replace(linear, a=a))

    def sampled(self, period: float, delay: float) -> DiscreteModel:
        """Return y under torques of the driven joints that act `delay` later and are held."""
        if (period, delay) not in self._sampled:
            k, linear = self.joints, self.linear
            driven = replace(
                linear, b=linear.b[:, :k], d=linear.d[:, :k], input_names=linear.input_names[:k]
            )
            self._sampled[period, delay] = driven.discrete(period, delay)
        return self._sampled[period, delay]

    def disturbed(self, period: float, correlation: float) -> Array:
        """Return the transition over a period of [y; forces], forces that fade slowly."""
        a, b = self.linear.a, self.linear.b
        s, d = b.shape
        block = np.zeros((s + d, s + d))
        block[:s, :s], block[:s, s:] = a, b
        block[s:, s:] = -np.eye(d) / correlation
        return np.asarray(scipy.linalg.expm(block * period))


def deviation_model(
    robot: Robot, joints: Sequence[str], sensors: Sequence[int], tip: str, state: PlannedState
) -> DeviationModel:
    """Return the model of small deviations from a moment of a plan.

    Parameters
    ----------
    robot : Robot
        With all its springs.
    joints : sequence of str
        That are driven.
    sensors : sequence of int
        Places of the values that are read, in file order; specific forces cannot be.
    tip : str
        A frame.
    state : PlannedState

    Raises
    ------
    StateError
        Unknown names, or a state in which loops are open.
    """
    amplitudes = [robot.coordinate_names[k] for k in robot.flexible_indices]
    linear = robot.linearize(
        state.q, state.qd, state.tau, inputs=[*joints, *amplitudes],
        outputs=[*joints, *(f'{joint}_rate' for joint in joints), 'sensors', f'pose:{tip}'],
        locked=_standing(robot, joints), friction=False,
    )  # fmt: skip
    k, m = len(joints), len(linear.inertia)
    rows = [*range(2 * k), *(2 * k + place for place in sensors)]
    names = linear.state_names[:m]
    index = [robot.coordinate_names.index(name) for name in names]
    stiff = robot.stiffness[index]
    measured = linear.c[rows]
    for place, joint in enumerate(joints):
        if joint in motors_behind(robot.tree):  # its states are those of motor and spring together
            spring = names.index(spring_name(joint))
            measured[place, spring] += 1.0
            measured[k + place, m + spring] += 1.0
    return DeviationModel(linear, k, measured, linear.c[-6:, :m], np.asarray(stiff))


def require_same_coordinates(models: Sequence[DeviationModel]) -> None:
    """Refuse models of different coordinates.

    Raises
    ------
    StateError
        With the names that differ.
    """
    first = models[0].linear.state_names
    for model in models:
        if model.linear.state_names != first:
            got = sorted(set(model.linear.state_names) ^ set(first))
            raise StateError(
                'state feedback: the same coordinates must determine the loops along the whole '
                f'plan, got a change of {", ".join(got)}'
            )


def _standing(robot: Robot, joints: Sequence[str]) -> list[str]:
    """Return the fixed joints: neither driven nor moved by loops or leaders."""
    standing = {*robot.tree.non_mimic_joints} - {*joints}
    return [name for name in driven_motion(robot, joints).given if name in standing]
