"""What a robot of `truth_robots` shows in one run: its own clock, noise and rate per topic."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from truth_robots import TruthCase

from denoc_ros.dynamics.robot import Robot
from denoc_ros.identification.model.free_parameters import SearchPoint
from denoc_ros.identification.model.sources import Recording
from denoc_ros.simulation.simulate import Run, simulate
from denoc_ros.types import Array

PERIOD = 0.005  # s between samples of a topic
JITTER = 0.1  # of the period, of the time at which a sample is taken
MISSTAMPED = 3e-5  # s, of its stamp
AHEAD = 0.02  # s simulated beyond the record: delays reach out of it
POSITION, RATE = 2e-5, 1e-3  # rad, rad/s: noise of encoders
RELATIVE = 0.005  # of its own deviation: noise of effort and gauges
INERTIAL = {'gyro': 2e-3, 'accel': 0.02}  # rad/s, m/s^2
BAND = 2.0  # Hz of a joint controller

Law = Callable[[float], tuple[float, float, float]]


@dataclass(frozen=True)
class TruthRun:
    """A recording, and how noisy each of its signals is.

    `noise` has the standard deviation by the channel's name: efforts, gauges, values of IMUs.
    """

    recording: Recording
    noise: dict[str, float]


def excitation(case: TruthCase, joints: int, seed: int) -> list[Law]:
    """Return each joint's motion: three sines, from rest; slow ones where that is the trap."""
    draw = np.random.default_rng([case.seed, seed, 29])
    slow = case.trap == 'slow'
    laws = []
    for k in range(joints):
        still = f'joint_{k + 1}' in case.still
        rates = (
            draw.uniform(0.1, 0.3, 3) if slow else draw.uniform([1.0, 3.0, 8.0], [3.0, 7.0, 14.0])
        )
        sizes = np.array([0.5, 0.25, 0.06]) * draw.choice([-1.0, 1.0], 3)
        laws.append(_law(np.zeros(3) if still else sizes, rates))
    return laws


def _law(sizes: Array, rates: Array, ramp: float = 0.8) -> Law:
    """Return position, rate and acceleration over time of sines that begin smoothly."""

    def at(t: float) -> tuple[float, float, float]:
        s = min(t / ramp, 1.0)
        rise = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
        slope = 30.0 * s * s * (1.0 - s) ** 2 / ramp
        bend = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / ramp**2
        sine, cosine = np.sin(rates * t), np.cos(rates * t)
        w, wd = float(sizes @ sine), float((sizes * rates) @ cosine)
        wdd = float(-(sizes * rates**2) @ sine)
        return rise * w, slope * w + rise * wd, bend * w + 2.0 * slope * wd + rise * wdd

    return at


def truth_run(case: TruthCase, duration: float = 4.0, seed: int = 0) -> TruthRun:
    """Return what the true robot shows.

    Parameters
    ----------
    case : TruthCase
    duration : float
        [s]
    seed : int
        Of motion and noise.
    """
    parameters = case.parameters
    settings = parameters.settings(case.theta)
    true = parameters.robot_at(settings)
    draw = np.random.default_rng([case.seed, seed, 31])
    laws = excitation(case, len(true.joint_names), seed)
    stamps, taken = _clocks(true, settings, duration, draw)
    times = np.unique(np.concatenate([[0.0], *taken.values()]))
    run = _simulated(case, true, laws, times)
    accelerations = _accelerations(true, run, laws, case.held)
    return _recorded(true, settings, run, accelerations, stamps, taken, draw)


def _clocks(
    true: Robot, settings: SearchPoint, duration: float, draw: np.random.Generator
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the stamps of each topic, and the times at which its samples are taken."""
    stamps, taken = {}, {}
    names = [sensor.name for sensor in true.tree.sensors]
    names += [sensor.name for sensor in true.tree.inertial_sensors]
    for name in ('joints', *names):
        count = int(duration / PERIOD)
        phase = 0.0 if name == 'joints' else draw.uniform(0.0, PERIOD)
        times = phase + PERIOD * np.arange(count) + JITTER * PERIOD * draw.uniform(0.0, 1.0, count)
        late = settings.delays.get(name, 0.0)
        stamps[name] = times + late + MISSTAMPED * draw.standard_normal(count)
        taken[name] = times
    taken['effort'] = np.maximum(taken['joints'] - settings.delays.get('effort', 0.0), 0.0)
    return stamps, taken


def _simulated(case: TruthCase, true: Robot, laws: list[Law], times: Array) -> Run:
    names = true.joint_names
    start = true.static_deflection(np.zeros(len(names)))
    rest = np.zeros(true.n)
    if not case.held:
        motion = dict(zip(names, laws, strict=True))
        return simulate(true, start, rest, times, prescribed=motion)
    return simulate(true, start, rest, times, torque=_controller(case, true, laws, start))


def _controller(
    case: TruthCase, true: Robot, laws: list[Law], start: Array
) -> Callable[[float, Array, Array], Array]:
    """Return a controller of the joints, tuned on the model: proportional and derivative."""
    index, rate = case.robot.joint_indices, 2.0 * np.pi * BAND
    inertia = np.diag(case.robot.inertia_matrix(np.zeros(case.robot.n)))[index]
    holding = true.inverse_dynamics(start, np.zeros(true.n), np.zeros(true.n))

    def torque(t: float, q: Array, qd: Array) -> Array:
        tau = np.zeros(true.n)
        wanted = np.array([law(t)[:2] for law in laws])
        missed, slower = wanted[:, 0] - q[index], wanted[:, 1] - qd[index]
        tau[index] = holding[index] + inertia * (rate**2 * missed + 1.4 * rate * slower)
        return tau

    return torque


def _accelerations(true: Robot, run: Run, laws: list[Law], held: bool) -> Array:
    if held:
        return true.forward_dynamics(run.q, run.qd, run.torque)
    joints = np.array([[law(t)[2] for law in laws] for t in run.t])
    free = true.hybrid_dynamics(run.q, run.qd, joints)[1]
    found = np.zeros_like(run.q)
    found[:, true.joint_indices] = joints
    found[:, np.setdiff1d(np.arange(true.n), true.joint_indices)] = free
    return found


def _recorded(
    true: Robot,
    settings: SearchPoint,
    run: Run,
    accelerations: Array,
    stamps: dict[str, Array],
    taken: dict[str, Array],
    draw: np.random.Generator,
) -> TruthRun:
    """Return the samples of a simulated run with the noise of each topic."""
    rows = {name: np.searchsorted(run.t, times) for name, times in taken.items()}
    index, noise = true.joint_indices, {}
    joints, sensors = rows['joints'], {}
    gains = np.array([settings.gains.get(name, 1.0) for name in true.joint_names])
    effort = run.torque[rows['effort']][:, index] * gains
    for name, column in zip(true.joint_names, effort.T, strict=True):
        noise[f'effort {name}'] = RELATIVE * max(float(column.std()), 1e-3)
    effort = effort + draw.standard_normal(effort.shape) * [
        noise[f'effort {name}'] for name in true.joint_names
    ]
    values = true.sensor_values(run.q, run.qd, accelerations)
    for place, sensor in zip(true.tree.beam_sensor_places, true.tree.sensors, strict=True):
        raw = (values[rows[sensor.name], place] - sensor.offset) / sensor.gain
        noise[sensor.name] = RELATIVE * float(raw.std())
        noisy = raw + noise[sensor.name] * draw.standard_normal(len(raw))
        sensors[sensor.name] = (stamps[sensor.name], noisy)
    for inertial in true.tree.inertial_sensors:
        columns = []
        for k, part in enumerate(inertial.parts):
            path = f'sensor.{inertial.name}'
            value = values[rows[inertial.name], inertial.first + k]
            offset = settings.channels.get(f'{path}.offset.{part}', 0.0)
            value = (value - offset) / settings.channels.get(f'{path}.gain.{part}', 1.0)
            size = INERTIAL[part.partition('_')[0]]
            noise[f'{inertial.name}/{part}'] = size
            columns.append(value + size * draw.standard_normal(len(value)))
        sensors[inertial.name] = (stamps[inertial.name], np.array(columns).T)
    q, qd = run.q[joints][:, index], run.qd[joints][:, index]
    recording = Recording(
        stamps['joints'],
        tuple(true.joint_names),
        q + POSITION * draw.standard_normal(q.shape),
        effort,
        qd + RATE * draw.standard_normal(qd.shape),
        sensors,
        'truth',
    )
    return TruthRun(recording, noise)
