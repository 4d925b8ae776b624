"""Simulation of a planned motion: the robot during the motion and after it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from denoc_ros.dynamics.driven.motion_grid import GridMotion
from denoc_ros.dynamics.driven.motion_plan import Plan
from denoc_ros.dynamics.equilibrium import Equilibrium
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.stepper import Stepper
from denoc_ros.planning.tip.reaction import base_change, in_free_fall
from denoc_ros.types import Array

# times (k,) -> positions, rates and accelerations (k, driven) of the driven joints
JointLaw = Callable[[Array], tuple[Array, Array, Array]]

STEPS_PER_PERIOD = 60.0  # of the fastest mode
LONGEST_STEP = 1e-3  # s
MOST_STEPS = 400_000


@dataclass(frozen=True)
class CarriedOut:
    """Times (k,) [s], all coordinates (k, n), and the coordinates (n,) at rest after it."""

    t: Array
    q: Array
    rest: Array

    def tip(self, robot: Robot, frame: str) -> Array:
        """Return the positions (k, 3) of a frame [m]."""
        return np.asarray(robot.frame_pose(frame, self.q)[:, :3, 3])

    def swing(self, robot: Robot, frame: str, since: float) -> float:
        """Return the largest distance of a frame from its rest position, from a time on [m]."""
        rest = robot.frame_pose(frame, self.rest)[:3, 3]
        apart = self.tip(robot, frame)[self.t >= since] - rest
        return float(np.linalg.norm(apart, axis=1).max(initial=0.0))


def planned(plan: Plan, joints: Sequence[str]) -> JointLaw:
    """Motion of the joints in a plan, by quintics between its rows."""
    columns = [plan.coordinate_names.index(name) for name in joints]
    step = float(plan.t[-1] - plan.t[0]) / (len(plan.t) - 1)
    rows = (plan.q[:, columns], plan.qd[:, columns], plan.qdd[:, columns])
    return GridMotion(float(plan.t[0]), step, *rows).sample


def carry_out(
    robot: Robot,
    motion: JointLaw,
    joints: Sequence[str],
    near: Array,
    times: Array,
) -> CarriedOut:
    """Motion of all coordinates while the driven joints make a motion exactly.

    Parameters
    ----------
    robot : Robot
        It begins in equilibrium. A base that floats reacts from its coordinates in `near` on, and
        falls freely.
    motion : callable
    joints : sequence of str
        The driven joints, in the order of the motion's columns; all others are free.
    near : (n,) array
        A posture, with its loops closed, from which the equilibrium is looked for.
    times : (k,) array
        Evenly spaced [s]; the motion is stepped through more finely where modes are fast.
    """
    own = in_free_fall(robot)
    driven = own.indices(joints)
    undriven = np.setdiff1d(np.arange(own.n), np.union1d(driven, own.base_indices))

    def at_rest(time: float, guess: Array) -> Array:
        q: Array = guess.copy()
        q[driven] = motion(np.array([time]))[0][0]
        if own.constraint_names:
            q = np.asarray(own.assemble(q, fixed=list(joints)))
        if len(undriven):
            Equilibrium(own, undriven).find(q)
        if len(own.base_indices):
            q[own.base_indices] += base_change(own, guess, q)
        return q

    interval = float(times[1] - times[0])
    start = at_rest(float(times[0]), near)
    start[own.base_indices] = near[own.base_indices]
    parts = _parts(own, start, interval, len(times))
    step = interval / parts
    fine = times[0] + step * np.arange((len(times) - 1) * parts + 1)
    q_driven, qd_driven, _ = motion(fine)
    between = motion(0.5 * (fine[1:] + fine[:-1]))[2]
    stepper = Stepper(own, step, joints)
    rows = np.zeros((len(times), own.n))
    state, rate = start.copy(), np.zeros(own.n)
    for k in range(len(fine)):
        state[driven], rate[driven] = q_driven[k], qd_driven[k]
        if k % parts == 0:
            rows[k // parts] = state
        if k < len(between):
            stepper.driven(state, rate, between[k])
    return CarriedOut(times, rows, at_rest(float(times[-1]), rows[-1]))


def _parts(robot: Robot, q: Array, interval: float, rows: int) -> int:
    """Return the number of steps of an interval."""
    longest = LONGEST_STEP
    if len(robot.flexible_indices):
        fastest = float(np.max(robot.natural_frequencies(q)))
        longest = min(longest, 1.0 / (STEPS_PER_PERIOD * max(fastest, 1e-9)))
    return max(1, min(int(np.ceil(interval / longest - 1e-9)), MOST_STEPS // rows))
