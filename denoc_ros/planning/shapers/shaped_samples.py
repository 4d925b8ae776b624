"""A whole joint motion through input shapers whose modes change along it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline, make_interp_spline

from denoc_ros.dynamics.driven.driven_joints import DrivenJoints
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import StateError
from denoc_ros.model.mode_table import ModeTable
from denoc_ros.planning.shapers.impulses import impulse_weights
from denoc_ros.planning.shapers.ringing import modes_along, ringing_modes
from denoc_ros.types import Array

POSTURES = 33  # along a motion at which modes are worked out, at least
POSTURES_PER_PERIOD = 2.0  # of the slowest mode
ROUNDS = 3  # the modes are those of the shaped motion, which depends on them
PER_PERIOD = 40  # samples of the fastest shaped mode


class JointSamples(NamedTuple):
    """A joint motion on a grid: times (k,) [s], q, qd, qdd (k, joints)."""

    t: Array
    q: Array
    qd: Array
    qdd: Array


def rest_spline(times: Array, q_joints: Array) -> Any:
    """Return the quintic spline through positions (k, joints) that starts and ends at rest.

    Raises
    ------
    StateError
        Times do not increase, there are fewer than two, or a number is not finite.
    """
    times = np.asarray(times, dtype=np.float64)
    q_joints = np.asarray(q_joints, dtype=np.float64)
    if times.ndim != 1 or len(times) < 2 or q_joints.ndim != 2 or len(q_joints) != len(times):
        raise StateError(
            'shape: times and q_joints must have shapes (k,) and (k, joints) with k >= 2, '
            f'got {times.shape} and {q_joints.shape}'
        )
    if not (np.isfinite(times).all() and np.isfinite(q_joints).all()):
        raise StateError('shape: times and q_joints must be finite')
    if (np.diff(times) <= 0.0).any():
        raise StateError(f'shape: times must increase, got {times}')
    rest = [(1, np.zeros(q_joints.shape[1])), (2, np.zeros(q_joints.shape[1]))]
    return make_interp_spline(times, q_joints, k=5, bc_type=(rest, rest))


def shape_samples(
    robot: Robot,
    times: Array,
    q_joints: Array,
    method: str,
    modes: int | None = None,
    table: ModeTable | None = None,
) -> tuple[JointSamples, float]:
    """Return a joint motion shaped for the robot's modes at the postures it goes through.

    Parameters
    ----------
    robot : Robot
        With the payload it carries.
    times : (k,) array
        s, increasing.
    q_joints : (k, joints) array
        Positions [rad, m], from rest to rest; mimic joints follow their leaders.
    method : str
        ``zv``, ``zvd`` or ``ei``.
    modes : int, optional
        How many modes, from the lowest; default those below ten times the lowest.
    table : ModeTable, optional
        Measured modes, in place of the robot's own.

    Returns
    -------
    JointSamples
        From `times[0]` to the end of the shaped motion.
    delay : float
        How much later it ends [s].

    Raises
    ------
    StateError, SolverError
        A bad motion; modes that do not oscillate (see :func:`ringing_modes`).
    """
    driven = DrivenJoints(robot, 'an input shaper')
    spline = rest_spline(times, q_joints)
    start, end = float(times[0]), float(times[-1])
    first = ringing_modes(robot, driven.following(spline(start)), modes, table)
    slowest = float(first.frequencies[0])
    postures = max(POSTURES, int(np.ceil(POSTURES_PER_PERIOD * slowest * (end - start))))
    path = driven.following(spline(np.linspace(start, end, postures)))
    found = modes_along(robot, path, modes, table)
    half_periods = len(impulse_weights(method, 0.0)) - 1
    for _ in range(ROUNDS):
        delay = float((0.5 * half_periods / found.frequencies.min(axis=0)).sum())
        step = 1.0 / (PER_PERIOD * float(found.frequencies.max()))
        count = max(2, int(np.ceil((end + delay - start) / step)) + 1)
        t = np.linspace(start, end + delay, count)
        knots = np.linspace(start, end + delay, postures)
        weights = [impulse_weights(method, r) for r in found.ratios.mean(axis=0)]
        frequencies = CubicSpline(knots, found.frequencies)(t)
        q = driven.following(spline(np.clip(t, start, end)))
        for k in reversed(range(len(weights))):  # last the slowest: it is at the present phase
            q = _through(t, q, frequencies[:, k], weights[k])
        shaped = make_interp_spline(t, q, k=5)
        found = modes_along(robot, np.asarray(shaped(knots)), found.ratios.shape[1], table)
    return JointSamples(t, q, shaped(t, 1), shaped(t, 2)), delay


def _through(t: Array, q: Array, frequency: Array, weights: Array) -> Array:
    """Return samples (k, joints) through the impulses of one mode of changing frequency (k,) [Hz].

    An impulse is not a time but a half turn of the mode's phase back: a mode that becomes slower
    on the way is met as well as one that does not.
    """
    phase = 2.0 * np.concatenate(([0.0], np.cumsum(0.5 * (frequency[1:] + frequency[:-1]))))
    phase = phase * (t[1] - t[0])
    when = CubicSpline(phase, t)
    motion = CubicSpline(t, q)
    result = weights[0] * q
    for turns, weight in enumerate(weights[1:], 1):
        earlier = phase - turns
        moments = np.where(earlier > 0.0, when(np.maximum(earlier, 0.0)), t[0])
        result += weight * motion(moments)
    return np.asarray(result)
