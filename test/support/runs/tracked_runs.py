"""Runs of robots whose numbers change, as joint states, efforts and sensors tell of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.stepper import Stepper
from denoc_ros.identification.tracking.parameter_tracker import ParameterTracker
from denoc_ros.types import Array

INSIDE = 4  # steps of the truth between samples

Motion = Callable[[float], tuple[Array, Array, Array]]


@dataclass(frozen=True)
class TrackedRun:
    """What is measured: times (k,), joints (k, j), their efforts too, sensors (k, s)."""

    t: Array
    q: Array
    qd: Array
    effort: Array
    sensors: Array


def swinging(joints: int, size: float = 0.15, rate: float = 2.0) -> Motion:
    """Return sines of all joints from rest, each with a rate of its own."""
    rates = rate * (1.0 + 0.37 * np.arange(joints))
    sizes = size / (1.0 + np.arange(joints))

    def at(t: float) -> tuple[Array, Array, Array]:
        return (
            sizes * (1.0 - np.cos(rates * t)),
            sizes * rates * np.sin(rates * t),
            sizes * rates**2 * np.cos(rates * t),
        )

    return at


def resting(joints: int) -> Motion:
    """Return joints that stand still."""
    return lambda t: (np.full(joints, 0.3), np.zeros(joints), np.zeros(joints))


def simulated(
    true: Robot,
    motion: Motion,
    duration: float,
    period: float = 1e-3,
    change: Callable[[float, Robot], None] = lambda t, robot: None,
) -> TrackedRun:
    """Return what a robot does along a motion; `change` may alter the robot on the way."""
    robot, index = true.copy(), true.joint_indices
    step = period / INSIDE
    stepper = Stepper(robot, step)
    q = robot.static_deflection(motion(0.0)[0])
    qd = np.zeros(robot.n)
    count = round(duration / period)
    rows: list[list[Array]] = [[], [], [], []]
    linear = robot.beam_sensor_rows(q) if robot.tree.sensors else np.zeros((0, robot.n))
    for k in range(count):
        t = k * period
        change(t, robot)
        q[index], qd[index], acceleration = motion(t)
        torque = robot.hybrid_dynamics(q, qd, acceleration)[0]
        for row, value in zip(rows, (q[index], qd[index], torque, linear @ q), strict=True):
            row.append(value.copy())
        for part in range(INSIDE):
            stepper.driven(q, qd, motion(t + (part + 0.5) * step)[2])
    times = period * np.arange(count, dtype=np.float64)
    return TrackedRun(times, *(np.array(row) for row in rows))


def with_noise(
    run: TrackedRun, seed: int = 0, rate: float = 1e-4, effort: float = 0.005, sensor: float = 0.01
) -> TrackedRun:
    """Return a run with noise: of positions 1e-5, of rates, and shares of efforts and sensors."""
    draw = np.random.default_rng(seed)

    def noisy(values: Array, size: float | Array) -> Array:
        return np.asarray(values + size * draw.standard_normal(values.shape))

    return TrackedRun(
        run.t,
        noisy(run.q, 1e-5),
        noisy(run.qd, rate),
        noisy(run.effort, effort * np.abs(run.effort).max(axis=0, initial=0.0)),
        noisy(run.sensors, sensor * np.abs(run.sensors).max(axis=0, initial=0.0)),
    )


def follow(
    tracker: ParameterTracker,
    run: TrackedRun,
    effort: bool = True,
    sensors: bool = False,
    rates: bool = True,
) -> Array:
    """Let a tracker hear a run; return its values after each sample (k, p)."""
    values = np.empty((len(run.t), len(tracker.paths)))
    for k, t in enumerate(run.t.tolist()):
        if sensors:
            for place, value in enumerate(run.sensors[k].tolist()):
                tracker.sense(place, t, value)
        tracker.measure(
            t, run.q[k], run.qd[k] if rates else None, run.effort[k] if effort else None
        )
        values[k] = tracker.values
    return values
