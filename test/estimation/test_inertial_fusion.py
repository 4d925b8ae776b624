"""IMUs mend a wrong model, and their biases are found."""

from __future__ import annotations

import numpy as np
import pytest
from segmented_robots import strip_text

import denoc_ros as dn
from denoc_ros.errors import StateError
from denoc_ros.estimation.fusion import FusionSettings, InertialRows
from denoc_ros.estimation.observer import Observer
from denoc_ros.estimation.observer_settings import ObserverSettings
from denoc_ros.simulation.simulate import Run
from denoc_ros.types import Array

STEP = 2e-3
STILL, END = 2.0, 4.0  # s: the boom stands still, then swings
GRAVITY = (0.0, 0.0, -9.81)  # along the joint: the boom does not sag
NOISE = np.repeat([1e-4, 1e-3], 3)  # rad/s, m/s^2
BIAS = np.array([3e-3, -2e-3, 4e-3, 0.03, -0.05, 0.02])
IMU = """<sensor name="imu" type="imu" link="strip" station="1" rpy="0.4 0 0.3"
gyro_noise="1e-4" accel_noise="1e-3" gyro_bias="5e-3" accel_bias="0.05"/>"""


def boom(imu: str = IMU, ei: float = 4.0) -> dn.Robot:
    """The strip on a joint about Z, of 2 Hz when the joint is held."""
    text = strip_text(1, mass=0.3, more=imu).replace(
        '"clamp" type="fixed">', '"clamp" type="continuous"><axis xyz="0 0 1"/>'
    )
    text = text.replace('ei="1" modes="2"', f'ei="{ei}" modes="2" damping_ratio="0.01"')
    return dn.load_robot(text, gravity=GRAVITY)


def swing(t: float) -> tuple[float, float, float]:
    """Angle, rate and acceleration of the joint."""
    w, a, t = np.pi, 0.5, max(t - STILL, 0.0)
    if not t:
        return 0.0, 0.0, 0.0
    return a * (t - np.sin(w * t) / w), a * (1.0 - np.cos(w * t)), a * w * np.sin(w * t)


@pytest.fixture(scope='module')
def run() -> Run:
    """What the true boom does: it is softer by a fifth than the observer's."""
    true = boom(ei=3.2)
    zero, times = np.zeros(true.n), np.arange(0.0, END, STEP)
    return dn.simulate(true, zero, zero, times, prescribed={'clamp': swing}, rtol=1e-8)


def readings(run: Run, robot: dn.Robot) -> Array:
    """What the IMU says (k, 6), with noise and biases."""
    qdd = np.gradient(run.qd, STEP, axis=0)
    values = robot.sensor_values(run.q, run.qd, qdd)
    noisy: Array = values + BIAS + NOISE * np.random.default_rng(3).standard_normal(values.shape)
    return noisy


def observe(
    run: Run, fuse: bool, late: int = 0, source: str = 'joints', robot: dn.Robot | None = None
) -> tuple[Observer, Array]:
    """Return an observer after the run and its tip deflections (k,); the IMU's come late."""
    fusion, robot = FusionSettings() if fuse else None, robot or boom()
    found = Observer(robot, ObserverSettings(step=STEP, source=source, fusion=fusion))
    values, tips = readings(run, robot), []
    for k, t in enumerate(run.t):
        found.measure(t, run.q[k, :1], run.qd[k, :1], run.torque[k, :1])
        for place in range(6 if fuse and k >= late else 0):
            found.sense(place, run.t[k - late], float(values[k - late, place]))
        found.tick(t)
        tips.append(found.robot.tip_deflection('strip', found.q)[1])
    return found, np.array(tips)


def error(run: Run, tips: Array) -> float:
    """Return the rms error of the swing as a share of its peak."""
    place = run.coordinate_names.index('strip/y1')
    bent = np.zeros((len(run.t), 3))
    bent[:, 1:] = run.q[:, place : place + 2]
    true, moves = boom().tip_deflection('strip', bent)[:, 1], run.t > STILL
    return float(np.sqrt(np.mean((tips - true)[moves] ** 2)) / np.abs(true).max())


def test_an_imu_mends_a_soft_boom_and_its_biases_are_found(run: Run) -> None:
    found, tips = observe(run, True)
    alone = error(run, observe(run, False)[1])
    fused = error(run, tips)
    assert fused < 0.03
    assert fused < 0.2 * alone
    fusion = found.fusion
    assert fusion is not None
    assert fusion.names == found.robot.sensor_names
    # reached: a thousandth of what is not known of them at the start
    assert np.all(np.abs(fusion.biases - BIAS) < 0.02 * fusion.inertial.bias)
    assert sum(counts['outlier'] for counts in fusion.counts) < 0.01 * 6 * len(run.t)


@pytest.mark.long
def test_values_that_come_late_count_less(run: Run) -> None:
    alone, soon = error(run, observe(run, False)[1]), error(run, observe(run, True)[1])
    assert soon < error(run, observe(run, True, late=2)[1]) < 0.7 * alone
    late, _ = observe(run, True, late=4)
    assert late.fusion is not None
    assert late.fusion.counts[0].keys() == {'late'}


def test_imus_mend_a_model_that_measured_torque_drives(run: Run) -> None:
    alone, fused = (error(run, observe(run, fuse, source='torque')[1]) for fuse in (False, True))
    # found: 3.2 % and 11.9 %; torque between samples is the recorded one's
    assert fused < 0.06
    assert fused < 0.4 * alone


def with_follower(ei: float = 4.0) -> dn.Robot:
    """The boom with a bar at its tip that follows its joint."""
    extra = (
        '<link name="bar"><inertial><origin xyz="0.1 0 0"/><mass value="0.1"/>'
        '<inertia ixx="1e-5" iyy="4e-4" izz="4e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="follower" type="continuous"><parent link="strip"/><child link="bar"/>'
        '<origin xyz="1 0 0"/><axis xyz="0 0 1"/><mimic joint="clamp" multiplier="-0.8"/></joint>'
    )
    text = boom(ei=ei).tree.source.replace('<flexibility>', f'{extra}<flexibility>')
    return dn.load_robot(text, gravity=GRAVITY)


def test_imus_mend_a_model_with_a_mimic_joint() -> None:
    true = with_follower(ei=3.2)
    zero, times = np.zeros(true.n), np.arange(0.0, END, STEP)
    moved = dn.simulate(true, zero, zero, times, prescribed={'clamp': swing}, rtol=1e-8)
    alone, fused = (
        error(moved, observe(moved, fuse, robot=with_follower())[1]) for fuse in (False, True)
    )
    # found: 0.06 %, and 21 % without
    assert fused < 0.01
    assert fused < 0.2 * alone


def test_loops_are_refused() -> None:
    loop = (
        '<loop name="pin" type="spherical"><parent link="base" xyz="1 0 0"/>'
        '<child link="strip" xyz="1 0 0"/></loop>'
    )
    with pytest.raises(StateError, match='fused must have no loops, got pin'):
        InertialRows(boom(IMU + loop))


@pytest.mark.parametrize('kind', ['gyro', 'accel'])
def test_a_sensor_without_noise_is_refused(kind: str) -> None:
    silent = IMU.replace(f'{kind}_noise', f'{kind}_bias').replace(
        f'{kind}_bias="5e-3"' if kind == 'gyro' else f'{kind}_bias="0.05"', ''
    )
    with pytest.raises(
        StateError, match=f'gyro_noise and accel_noise > 0, got 0 for imu/{kind}_x'
    ):
        Observer(boom(silent), ObserverSettings(step=STEP, fusion=FusionSettings()))
