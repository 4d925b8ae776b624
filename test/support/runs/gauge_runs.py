"""Runs of arms that simulation knows better than the observer, their gauges, and the observer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from data_files import CLAMPED_FREE_CANADARM
from numpy.typing import NDArray

import denoc_ros as dn
from denoc_ros.dynamics.elastic.deflection import TipDeflections
from denoc_ros.estimation.fusion import FusionSettings
from denoc_ros.estimation.observer import Observer
from denoc_ros.estimation.observer_settings import ObserverSettings
from denoc_ros.simulation.simulate import Run
from denoc_ros.trajectories import CycloidalTrajectory
from denoc_ros.types import Array

ROBOTS = Path(__file__).resolve().parents[3] / 'config' / 'robots'
CLAMPED_FREE = 'clamped-free canadarm'
STEP = 1e-3
END = 4.0
PAYLOAD = 100.0  # kg at the tool, as the observer knows it
SEED = 11


@dataclass(frozen=True)
class Recording:
    """What happened, and what gauges with noise of 1 % of their peaks say of it."""

    run: Run
    strain: Array  # (k, sensors), without noise
    gauges: Array  # (k, sensors)
    noise: Array  # (sensors,)
    deflection: Array  # (k, 6 links), the truth


def load(name: str) -> dn.Robot:
    file = CLAMPED_FREE_CANADARM if name == CLAMPED_FREE else ROBOTS / f'{name}_gauges.urdf'
    return dn.load_robot(file, gravity=(0, 0, 0))


def motion(name: str, joints: int) -> CycloidalTrajectory:
    """The book's motions: eq. 3.56, section 4.2."""
    if name in ('canadarm', CLAMPED_FREE):
        rate, period = np.array([0.075, 0.05, 0.1]), np.array([10.0, 5.0, 5.0])
        return CycloidalTrajectory(np.zeros(3), rate, period, 'half', 10.0)
    return CycloidalTrajectory(np.zeros(joints), np.full(joints, 0.05), np.full(joints, 10.0))


def reference(name: str, joints: int) -> Callable[[float], tuple[Array, Array, Array]]:
    trajectory = motion(name, joints)

    def at(t: float) -> tuple[Array, Array, Array]:
        q, qd, qdd = np.zeros((3, joints))
        trajectory.sample(t, q, qd, qdd)
        return q, qd, qdd

    return at


def softer(robot: dn.Robot) -> dict[str, float]:
    """Overrides: every EI less by 10 %."""
    found = {}
    for body in robot.tree.bodies:
        beam = body.beam
        for direction, part in (('y', beam and beam.y), ('z', beam and beam.z)):
            if part:
                found[f'beam.{body.name}.{direction}.ei'] = 0.9 * part.stiffness
    return found


@cache
def record(name: str, known: bool) -> Recording:
    """The arm along its motion; not `known`: 20 % more payload, 10 % less EI."""
    robot = load(name)
    if not known:
        robot = robot.with_overrides(softer(robot))
    robot.set_payload('tool', PAYLOAD if known else 1.2 * PAYLOAD)
    return recorded(robot, reference(name, len(robot.joint_names)), END)


def recorded(
    robot: dn.Robot,
    wanted: Callable[[float], tuple[Array, Array, Array]],
    end: float,
    step: float = STEP,
    rtol: float = 1e-6,
    method: str = 'DOP853',
) -> Recording:
    """Record a robot whose joints follow a motion from rest, undeformed."""

    def of(index: int) -> Callable[[float], tuple[float, float, float]]:
        def law(t: float) -> tuple[float, float, float]:
            q, qd, qdd = wanted(t)
            return float(q[index]), float(qd[index]), float(qdd[index])

        return law

    laws = {joint: of(k) for k, joint in enumerate(robot.joint_names)}
    times = np.arange(0.0, end, step)
    start, rest = np.zeros((2, robot.n))
    start[robot.joint_indices] = wanted(0.0)[0]
    run = dn.simulate(
        robot, start, rest, times, prescribed=laws, rtol=rtol, atol=0.01 * rtol, method=method
    )
    accelerations = np.empty_like(run.q)
    accelerations[:, robot.joint_indices] = [wanted(t)[2] for t in times]
    given = accelerations[:, robot.joint_indices]
    accelerations[:, robot.flexible_indices] = robot.hybrid_dynamics(run.q, run.qd, given)[1]
    strain = robot.sensor_values(run.q, run.qd, accelerations)
    noise = 0.01 * np.abs(strain).max(axis=0)
    gauges = strain + noise * np.random.default_rng(SEED).standard_normal(strain.shape)
    tips = TipDeflections(robot)
    truth = [tips.evaluate(q, qd)[0].copy() for q, qd in zip(run.q, run.qd, strict=True)]
    return Recording(run, strain, gauges, noise, np.array(truth))


def observer(name: str, data: Recording, fuse: bool = True, **settings: object) -> Observer:
    robot = load(name)
    noise = {
        f'sensor.{sensor.name}.noise': value
        for sensor, value in zip(robot.tree.sensors, data.noise.tolist(), strict=True)
    }
    robot = robot.with_overrides(noise)
    robot.set_payload('tool', PAYLOAD)
    how = {'step': STEP, 'fusion': FusionSettings() if fuse else None, **settings}
    return Observer(robot, ObserverSettings(**how))  # type: ignore[arg-type]


def joints_of(found: Observer) -> NDArray[np.int64]:
    return np.asarray(found.robot.joint_indices)


Spoil = Callable[[int, int, float], float | None]


def replay(
    found: Observer,
    data: Recording,
    late: int = 0,
    every: int = 1,
    spoil: Spoil = lambda _row, _place, value: value,
    ticks: int = 10**9,
) -> Array:
    """Estimated deflections (k, 6 links); gauges come `late` ticks after the joints."""
    joints = joints_of(found)
    run, estimated = data.run, []
    for k, t in enumerate(run.t[:ticks]):
        found.measure(t, run.q[k, joints], run.qd[k, joints], run.torque[k, joints])
        m = k - late
        if m >= 0 and m % every == 0:
            for place, value in enumerate(data.gauges[m]):
                shown = spoil(m, place, float(value))
                if shown is not None:
                    found.sense(place, run.t[m], shown)
        found.tick(t)
        estimated.append(found.deflections.evaluate(found.q, found.qd)[0].copy())
    return np.array(estimated)


def errors(found: Observer, estimated: Array, true: Array) -> Array:
    """Rms errors of the tips' u_y and u_z that move, as shares of their peaks."""
    peak = np.abs(true).max(axis=0)
    moves = np.array([name.endswith(('uy', 'uz')) for name in found.deflections.names])
    moves &= peak > 1e-3
    rms = np.sqrt(np.mean((estimated - true[: len(estimated)]) ** 2, axis=0))
    return np.asarray(rms[moves] / peak[moves])
