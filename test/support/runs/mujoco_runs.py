"""Recordings of a robot whose links are chains of hinges in MuJoCo, its joints under torque."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from identification_runs import sweeping
from scipy.interpolate import CubicSpline

from denoc_ros.dynamics.driven.driven_motion import driven_motion
from denoc_ros.dynamics.robot import Robot
from denoc_ros.export.mujoco_robot import MujocoRobot, MujocoSettings
from denoc_ros.identification.model.sources import Recording
from denoc_ros.simulation.simulated_robot import Drives
from denoc_ros.types import Array

STEP, EVERY = 1e-3, 5  # s of the plant, and its steps from sample to sample
BAND = 2.0 * np.pi * 0.5  # rad/s, of the joints' feedback
POSITION, RATE = 1e-5, 1e-4  # rad, rad/s: noise of encoders

Motion = tuple[Array, Array, Array]  # positions, rates and accelerations (joints,)


def followed(
    robot: Robot, wanted: Callable[[float], Motion], steps: int, every: int, hinges: int
) -> Iterator[tuple[float, MujocoRobot, Array]]:
    """Yield time [s], plant and effort (joints,) every so many steps of a followed motion.

    The effort is the mean of those before and after the sample.
    """
    motion, at = driven_motion(robot), robot.joint_indices
    zero = np.zeros(len(at))
    plant = MujocoRobot(
        robot,
        robot.tree,
        STEP,
        robot.static_deflection(zero),
        Drives(motion.given, motion.index, zero, zero),
        MujocoSettings(hinges),
    )
    inertia = np.diag(robot.inertia_matrix(np.zeros(robot.n)))[at]
    before, tau = zero, np.zeros(robot.n)
    for k in range(steps):
        now = k * STEP
        q, qd, qdd = wanted(now)
        pull = BAND**2 * (q - plant.q[at]) + 1.4 * BAND * (qd - plant.qd[at])
        effort = inertia * (qdd + pull)
        if k % every == 0:
            yield now, plant, 0.5 * (before + effort)
        tau[at] = before = effort
        plant.free(tau)


def chain_recording(
    robot: Robot, duration: float, size: float, hinges: int = 16, noise: float = 0.002
) -> Recording:
    """Return what a robot of hinged links shows while its joints follow three sines each.

    Parameters
    ----------
    robot : Robot
        With rotor inertia in its joints.
    duration : float
        [s]
    size : float
        Of the sines, 1: 0.1 to 0.3 rad.
    hinges : int
        Of each link.
    noise : float
        Of effort and gauges, a share of their own deviation.
    """
    at = robot.joint_indices
    t = np.arange(0.0, duration + 2.0 * STEP, STEP)
    path = CubicSpline(t, size * sweeping(len(at), 1)(t))

    def wanted(now: float) -> Motion:
        return path(now), path(now, 1), path(now, 2)

    rows = [
        (now, plant.q[at].copy(), plant.qd[at].copy(), effort, plant.sensor_values().copy())
        for now, plant, effort in followed(robot, wanted, len(t) - 1, EVERY, hinges)
    ]
    stamps, q, qd, effort, values = (np.array(part) for part in zip(*rows, strict=True))
    draw = np.random.default_rng(0)

    def noisy(column: Array) -> Array:
        spread = noise * column.std(axis=0)
        return np.asarray(column + spread * draw.standard_normal(column.shape))

    tree = robot.tree
    raw = {
        sensor.name: (stamps, noisy((values[:, place] - sensor.offset) / sensor.gain))
        for sensor, place in zip(tree.sensors, tree.beam_sensor_places, strict=True)
    }
    return Recording(
        stamps,
        tuple(robot.joint_names),
        q + POSITION * draw.standard_normal(q.shape),
        noisy(effort),
        qd + RATE * draw.standard_normal(qd.shape),
        raw,
        'mujoco',
    )
