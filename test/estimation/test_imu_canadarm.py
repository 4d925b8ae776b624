"""The Canadarm with IMUs at its links' ends in place of gauges, or beside one gauge per link."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from imu_arms import ENDS, imu_text

import denoc_ros as dn
from denoc_ros.estimation.fusion import FusionSettings
from denoc_ros.estimation.observer import Observer
from denoc_ros.estimation.observer_settings import ObserverSettings
from denoc_ros.simulation.simulate import Run
from denoc_ros.trajectories import CycloidalTrajectory
from denoc_ros.types import Array

STEP, STILL, END = 1e-3, 2.0, 2.5  # s: a tick, at rest first, of the motion
PAYLOAD = 100.0  # kg, as the observer knows it; it is a fifth more
STIFFNESS = {'beam.link_1.y.ei': 9e4, 'beam.link_2.y.ei': 1.8e5}  # the true ones, 10 % less
SEED = 1
AHEAD = 50  # ticks
PATH = CycloidalTrajectory(
    np.zeros(3), np.array([0.075, 0.05, 0.1]), np.array([10.0, 5.0, 5.0]), 'half', 10.0
)


def arm(gauges: str) -> dn.Robot:
    """Return the arm with IMUs and those of its gauges whose names have a text in them."""
    return dn.load_robot(imu_text(gauges), gravity=(0.0, 0.0, 0.0))


def motion(t: float) -> tuple[Array, Array, Array]:
    """Return positions, rates and accelerations of the joints along eq. 3.56."""
    state = np.zeros((3, 3))
    PATH.sample(t, *state)
    return state[0], state[1], state[2]


@cache
def truth(end: float = END, step: float = STEP) -> Run:
    """The arm as it is along the book's motion (eq. 3.56)."""
    robot = arm('').with_overrides(STIFFNESS)
    robot.set_payload('tool', 1.2 * PAYLOAD)

    def joint(t: float, k: int) -> tuple[float, float, float]:
        q, qd, qdd = motion(t)
        return float(q[k]), float(qd[k]), float(qdd[k])

    laws = {name: lambda t, k=k: joint(t, k) for k, name in enumerate(robot.joint_names)}
    zero, times = np.zeros(robot.n), np.arange(0.0, end, step)
    return dn.simulate(robot, zero, zero, times, prescribed=laws, rtol=1e-6, atol=1e-8)


def measured(
    robot: dn.Robot, run: Run, observer: Observer, still: float = STILL, seed: int = SEED
) -> Array:
    """Return what the sensors say from the start of the rest on, in the observer's order."""
    step = float(run.t[1] - run.t[0])
    qdd = np.gradient(run.qd, step, axis=0)
    values = robot.sensor_values(run.q, run.qd, qdd)
    fusion = observer.fusion
    assert fusion is not None
    places = [robot.sensor_names.index(name) for name in fusion.names]
    rest = np.zeros((round(still / step), len(places)))
    values = np.concatenate([rest, values[:, places]])
    rng = np.random.default_rng(seed)
    count = len(robot.tree.sensors)
    noise = [*(sensor.noise for sensor in robot.tree.sensors), *fusion.inertial.noise]
    values[:, count:] += fusion.inertial.bias * rng.standard_normal(len(fusion.inertial.bias))
    noisy: Array = values + noise * rng.standard_normal(values.shape)
    return noisy


@pytest.mark.long_cases('root')
@pytest.mark.parametrize('gauges', ['', 'root'])
def test_imus_mend_a_wrong_model(gauges: str) -> None:
    run, robot = truth(), arm(gauges)
    robot.set_payload('tool', PAYLOAD)
    settings = ObserverSettings(step=STEP, fusion=FusionSettings(), horizon=AHEAD * STEP)
    found = Observer(robot, settings)
    joints, rest = robot.joint_indices, round(STILL / STEP)
    readings, tips, ahead = measured(robot, run, found), [], []
    zero = np.zeros(len(joints))
    for k, values in enumerate(readings.tolist()):
        t, moving = k * STEP, max(k - rest, 0)
        q, qd = (run.q[moving, joints], run.qd[moving, joints]) if k >= rest else (zero, zero)
        found.measure(t, q, qd)
        for place, value in enumerate(values):
            found.sense(place, t, value)
        found.tick(t)
        if k >= rest:
            tips.append([robot.tip_deflection(link, found.q)[1] for link in ENDS])
        if k >= rest and k % AHEAD == 0:
            later, _ = found.predict(lambda at: motion(at - STILL))
            ahead.append([robot.tip_deflection(link, later)[1] for link in ENDS])
    true = np.column_stack([robot.tip_deflection(link, run.q)[:, 1] for link in ENDS])
    peak = np.abs(true).max(axis=0)
    rms = np.sqrt(np.mean((np.array(tips) - true) ** 2, axis=0)) / peak
    gaps = np.array(ahead[:-1]) - true[AHEAD::AHEAD]
    # the model alone errs by a sixth
    assert rms.max() < 0.01
    assert np.sqrt(np.mean(gaps**2, axis=0) / peak**2).max() < 0.02


def errors(gauges: str, begin: int, seed: int = SEED) -> Array:
    """Return the tips' errors (k, 2) over their peaks, from a place of the whole motion on."""
    step = 4 * STEP
    whole, robot = truth(10.0, step), arm(gauges)
    robot.set_payload('tool', PAYLOAD)
    run = replace(whole, t=whole.t[begin:], q=whole.q[begin:], qd=whole.qd[begin:])
    found = Observer(robot, ObserverSettings(step=step, fusion=FusionSettings()))
    joints, tips = robot.joint_indices, []
    readings = measured(robot, run, found, still=0.0, seed=seed)
    for k, values in enumerate(readings.tolist()):
        found.measure(k * step, run.q[k, joints], run.qd[k, joints])
        for place, value in enumerate(values):
            found.sense(place, k * step, value)
        found.tick(k * step)
        tips.append([robot.tip_deflection(link, found.q)[1] for link in ENDS])
    true = np.column_stack([robot.tip_deflection(link, run.q)[:, 1] for link in ENDS])
    off: Array = (np.array(tips) - true) / np.abs(true).max(axis=0)
    return off


@pytest.mark.long_cases('-2-0.01', '-4-0.01', 'root-3-0.005')
@pytest.mark.parametrize(
    ('gauges', 'seed', 'reach'),
    [('', 2, 0.01), ('', 4, 0.01), ('', 8, 0.01), ('root', 3, 0.005)],
)
def test_a_wrong_model_is_told_from_biases_while_the_arm_moves(
    gauges: str, seed: int, reach: float
) -> None:
    # no rest before. Found: 0.72, 0.66, 0.63 and 0.28 %, the worst of twenty seeds 0.73 %. With
    # all of the model's error taken for a share of the elastic forces: 1.13, 1.39, 1.27 and 0.2 %;
    # for a force that changes as quickly as the links vibrate: 7 and 1.2 %
    assert np.sqrt(np.mean(errors(gauges, 0, seed) ** 2, axis=0)).max() < reach


def test_the_row_of_a_load_is_what_a_robot_with_more_of_it_would_say() -> None:
    robot = arm('')
    robot.set_payload('tool', PAYLOAD)
    fusion = Observer(robot, ObserverSettings(step=STEP, fusion=FusionSettings())).fusion
    assert fusion is not None
    assert fusion.inertial.loads == 1
    rng = np.random.default_rng(5)
    q, qd = 0.05 * rng.standard_normal((2, robot.n))
    given, more = np.array([0.3, -0.2, 0.4]), 1e-4

    def said(of: dn.Robot) -> tuple[Array, Array]:
        _, others = of.hybrid_dynamics(q, qd, given)
        qdd = np.zeros(of.n)
        qdd[of.joint_indices], qdd[of.flexible_indices] = given, others
        return of.sensor_values(q, qd, qdd), qdd

    values, qdd = said(robot)
    fusion.filter.linearize(q)
    still = np.zeros(robot.n)
    fusion.inertial.move(0.0, q, qd, lambda *_: (robot, qdd), lambda: still, fusion.filter)
    heavier, _ = said(robot.with_scaled_load('tool', 1.0 + more))
    change = (heavier - values) / more
    assert np.abs(change).max() > 0.01
    # the second order of `more`, and what rounding leaves of the difference
    np.testing.assert_allclose(
        fusion.inertial.rows[:, -1], change, rtol=1e-3, atol=1e-3 * np.abs(change).max()
    )


def test_a_start_far_from_the_truth_is_recovered_from() -> None:
    # the motion is 4 s old, a tip 0.5 m from its equilibrium: at first all sensors contradict.
    # Found in the last second: 2.7 %; with the doubt as at the start each time: 640 %
    assert np.abs(errors('root', 1000)[-250:]).max() < 0.1
