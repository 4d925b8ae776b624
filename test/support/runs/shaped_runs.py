"""Simulated robots whose joints do a planned motion, and the swing they are left with."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline

import denoc_ros as dn
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.stepper import Stepper
from denoc_ros.types import Array

STEP = 5e-4


def cycloid(t: Array, duration: float) -> Array:
    """Return the cycloid from 0 to 1, held outside of its duration."""
    s = np.clip(t / duration, 0.0, 1.0)
    return np.asarray(s - np.sin(2.0 * np.pi * s) / (2.0 * np.pi))


def held_spline(t: Array, q: Array) -> Any:
    """Return time, derivative -> rows of the quintic spline of a motion, held outside of it."""
    rest = [(order, np.zeros(q.shape[1])) for order in (1, 2)]
    spline = make_interp_spline(t, q, k=5, bc_type=(rest, rest))

    def at(time: Any, derivative: int = 0) -> Array:
        time = np.asarray(time, dtype=np.float64)
        rows = np.array(spline(np.clip(time, t[0], t[-1]), derivative))
        if derivative:
            rows[(time < t[0]) | (time > t[-1])] = 0.0
        return rows

    return at


def _largest(robot: Robot, states: Array, end: Array, frame: str) -> float:
    tips = robot.frame_pose(frame, np.ascontiguousarray(states))[:, :3, 3]
    settled = robot.frame_pose(frame, robot.static_deflection(end))[:3, 3]
    return float(np.linalg.norm(tips - settled, axis=1).max())


def swing_after(
    robot: Robot,
    t: Array,
    q: Array,
    frame: str,
    watch: float = 1.5,
    since: float | None = None,
    step: float = STEP,
) -> float:
    """Return how far a frame is from rest [m] within `watch` s after a joint motion (k, joints).

    After `since` [s], by default the motion's end. In fixed steps [s], the joints on the quintic
    spline of the motion; steps that turn a mode by 0.2 rad already shift its phase.
    """
    spline = held_spline(t, q)
    times = np.arange(t[0], t[-1] + watch, step)
    rows, rates = spline(times), spline(times, 1)
    accelerations = spline(times + 0.5 * step, 2)
    stepper = Stepper(robot, step)
    state, rate = robot.static_deflection(q[0]), np.zeros(robot.n)
    joints = robot.joint_indices
    states = np.zeros((len(times), robot.n))
    for k in range(len(times)):
        state[joints], rate[joints] = rows[k], rates[k]
        states[k] = state
        stepper.driven(state, rate, accelerations[k])
    return _largest(robot, states[times >= (t[-1] if since is None else since)], q[-1], frame)


def simulated_swing(robot: Robot, t: Array, q: Array, frame: str, watch: float = 1.0) -> float:
    """Return the same by `denoc_ros.simulate`, the adaptive integrator."""
    spline = held_spline(t, q)
    last: dict[str, Any] = {}

    def rows(time: float) -> Array:
        if last.get('time') != time:
            last.update(time=time, rows=[spline(time, order) for order in range(3)])
        return np.asarray(last['rows'])

    laws = {
        name: (lambda time, k=k: tuple(rows(time)[:, k]))
        for k, name in enumerate(robot.joint_names)
    }
    times = np.concatenate(([t[0]], np.linspace(t[-1], t[-1] + watch, 200)))
    start, rest = robot.static_deflection(q[0]), np.zeros(robot.n)
    run = dn.simulate(robot, start, rest, times, prescribed=laws, rtol=1e-6, atol=1e-8)
    return _largest(robot, run.q[1:], q[-1], frame)
