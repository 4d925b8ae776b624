"""Recordings of robots whose numbers are known: motion, torque and gauges with noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.stepper import Stepper
from denoc_ros.identification.model.sources import Recording
from denoc_ros.types import Array

STEP = 0.005  # s between samples
INSIDE = 10  # steps of the truth between samples

Motion = Callable[[Array], Array]


def sweeping(joints: int, seed: int, ramp: float = 1.0) -> Motion:
    """Return positions (k, joints) at times (k,): three sines per joint, from rest."""
    draw = np.random.default_rng(seed)
    rates = draw.uniform(0.5, 3.0, (3, joints))
    sizes = draw.uniform(0.1, 0.3, (3, joints)) * draw.choice([-1.0, 1.0], (3, joints))

    def positions(t: Array) -> Array:
        s = np.clip(t / ramp, 0.0, 1.0)
        rise = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        waves = sizes * np.sin(rates * t[:, None, None])
        return np.asarray(rise[:, None] * waves.sum(axis=1))

    return positions


def recorded(
    true: Robot,
    motion: Motion,
    duration: float,
    noise: float = 0.002,
    seed: int = 0,
    frames: Sequence[str] = (),
) -> Recording:
    """Return what a robot shows on a motion of its joints, and a tracker of some frames.

    Noise is a part of each channel's deviation; positions have 1e-5 and rates 1e-3.
    """
    draw = np.random.default_rng(seed)
    fine = np.arange(0.0, duration + STEP, STEP / INSIDE)
    spline = CubicSpline(fine, motion(fine))
    stepper = Stepper(true.copy(), STEP / INSIDE)
    index = true.joint_indices
    q, qd = true.static_deflection(spline(0.0)), np.zeros(true.n)
    states = []
    for k, t in enumerate(fine):
        q[index], qd[index] = spline(t), spline(t, 1)
        if k % INSIDE == 0:
            states.append((t, q.copy(), qd.copy()))
        stepper.driven(q, qd, spline(t + 0.5 * STEP / INSIDE, 2))
    t, rows, rates = (np.array(part) for part in zip(*states, strict=True))
    torque, free = true.hybrid_dynamics(rows, rates, spline(t, 2))
    accelerations = np.zeros_like(rows)
    accelerations[:, index] = spline(t, 2)
    accelerations[:, np.setdiff1d(np.arange(true.n), index)] = free
    values = true.sensor_values(rows, rates, accelerations)
    raw = {
        sensor.name: (values[:, place] - sensor.offset) / sensor.gain
        for place, sensor in zip(true.tree.beam_sensor_places, true.tree.sensors, strict=True)
    }
    for inertial in true.tree.inertial_sensors:
        own = slice(inertial.first, inertial.first + len(inertial.parts))
        raw[inertial.name] = values[:, own]
    seen = {frame: _poses(true.frame_pose(frame, rows)) for frame in frames}
    return Recording(
        t,
        tuple(true.joint_names),
        spline(t) + 1e-5 * draw.standard_normal((len(t), len(index))),
        _noisy(torque, noise, draw),
        spline(t, 1) + 1e-3 * draw.standard_normal((len(t), len(index))),
        {name: (t, _noisy(values, noise, draw)) for name, values in raw.items()},
        'truth',
        poses={frame: (t, _noisy(poses, noise, draw)) for frame, poses in seen.items()},
    )


def _poses(matrices: Array) -> Array:
    """Return positions and quaternions (k, 7) of poses (k, 4, 4)."""
    turns = Rotation.from_matrix(matrices[:, :3, :3]).as_quat()
    return np.hstack([matrices[:, :3, 3], turns])


def _noisy(values: Array, noise: float, draw: np.random.Generator) -> Array:
    return np.asarray(values + noise * values.std(axis=0) * draw.standard_normal(values.shape))
