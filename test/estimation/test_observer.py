"""The observer against simulated plants whose deflections are known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from planar_chains import PlanarLink, planar_chain

import denoc_ros as dn
from denoc_ros.dynamics.elastic.deflection import TipDeflections
from denoc_ros.estimation.observer import Observer
from denoc_ros.estimation.observer_settings import ObserverSettings
from denoc_ros.simulation.simulate import Run
from denoc_ros.types import Array

DOWN = (0.0, -9.81, 0.0)
STEP = 1e-3
# The first mode stands near 4 Hz with the joints held.
ARM = (PlanarLink(1.0, 2.0, 150.0), PlanarLink(0.8, 1.0, 60.0))
POSITION_NOISE, RATE_NOISE = 1e-5, 2e-3  # rad, rad/s: a 19 bit encoder, differentiated


@dataclass(frozen=True)
class Recording:
    """A run of the plant and what its sensors say."""

    run: Run
    q: Array  # (k, joints)
    qd: Array  # (k, joints)
    effort: Array  # (k, joints)
    deflection: Array  # (k, 6 links), the truth


def arm(damping_ratio: float = 0.02) -> dn.Robot:
    return dn.load_robot(planar_chain(ARM, 2, damping_ratio=damping_ratio), gravity=DOWN)


def reference(t: float) -> tuple[Array, Array, Array]:
    """A slow swing of both joints, starting at rest."""
    gain, w = np.array([0.5, -0.7]), np.array([3.0, 4.0])
    start = np.array([-0.4, 0.3])
    return (
        start + gain * (1.0 - np.cos(w * t)),
        gain * w * np.sin(w * t),
        gain * w * w * np.cos(w * t),
    )


def of_joint(index: int) -> Callable[[float], tuple[float, float, float]]:
    """The reference of one joint."""

    def law(t: float) -> tuple[float, float, float]:
        q, qd, qdd = reference(t)
        return float(q[index]), float(qd[index]), float(qdd[index])

    return law


def record(robot: dn.Robot, end: float = 2.0) -> Recording:
    """Drive a plant's joints along the reference from rest; sensors with noise."""
    joints = np.asarray(robot.joint_indices)
    q0 = robot.static_deflection(reference(0.0)[0])
    times = np.arange(0.0, end, STEP)
    # The reference's acceleration starts at once: a jump that makes the beams ring.
    laws = {name: of_joint(k) for k, name in enumerate(robot.joint_names)}
    run = dn.simulate(robot, q0, np.zeros(robot.n), times, prescribed=laws, rtol=1e-7)
    rng = np.random.default_rng(7)
    shape = (len(times), len(joints))
    tips = TipDeflections(robot)
    return Recording(
        run,
        run.q[:, joints] + POSITION_NOISE * rng.standard_normal(shape),
        run.qd[:, joints] + RATE_NOISE * rng.standard_normal(shape),
        run.torque[:, joints],
        np.array([tips.evaluate(q, qd)[0] for q, qd in zip(run.q, run.qd, strict=True)]),
    )


@pytest.fixture(scope='module')
def recording() -> Recording:
    return record(arm())


def replay(
    observer: Observer,
    data: Recording,
    rates: bool = True,
    delay: int = 0,
    every: int = 1,
    along: bool = False,
) -> tuple[Array, Array]:
    """Feed a recording, `delay` ticks late; deflections estimated and predicted, (k, 6 links)."""
    estimated, predicted = [], []
    for k, t in enumerate(data.run.t):
        m = k - delay
        if m >= 0 and m % every == 0:
            assert observer.measure(
                data.run.t[m], data.q[m], data.qd[m] if rates else None, data.effort[m]
            )
        observer.tick(t)
        estimated.append(observer.deflections.evaluate(observer.q, observer.qd)[0].copy())
        ahead = observer.predict(reference if along else None)
        predicted.append(observer.deflections.evaluate(*ahead)[0].copy())
    return np.array(estimated), np.array(predicted)


def error(got: Array, true: Array) -> float:
    """Largest error of u_y of both tips over the largest u_y, after the first tenth."""
    skip = len(true) // 10
    columns = [1, 7]
    gap = np.max(np.abs(got[skip:, columns] - true[skip:, columns]), axis=0)
    return float(np.max(gap / np.max(np.abs(true[:, columns]), axis=0)))


@pytest.mark.parametrize(
    ('source', 'rates', 'delay', 'every', 'bound'),
    [
        ('joints', True, 0, 1, 0.01),
        ('joints', False, 0, 1, 0.015),
        ('joints', True, 10, 1, 0.01),
        ('joints', True, 30, 1, 0.03),
        ('joints', True, 0, 8, 0.01),
        ('torque', True, 0, 1, 0.006),
        ('torque', True, 10, 1, 0.01),
    ],
)
def test_observer_tracks_the_true_deflection(
    recording: Recording, source: str, rates: bool, delay: int, every: int, bound: float
) -> None:
    observer = Observer(arm(), ObserverSettings(step=STEP, source=source))
    estimated, _ = replay(observer, recording, rates, delay, every)
    assert error(estimated, recording.deflection) < bound


@pytest.mark.parametrize('source', ['joints', 'torque'])
def test_observer_with_twice_the_damping_stays_near(recording: Recording, source: str) -> None:
    observer = Observer(arm(damping_ratio=0.04), ObserverSettings(step=STEP, source=source))
    estimated, _ = replay(observer, recording)
    assert error(estimated, recording.deflection) < 0.06


@pytest.mark.parametrize('along', [False, True])
@pytest.mark.parametrize('source', ['joints', 'torque'])
def test_prediction_beats_holding_the_estimate(
    recording: Recording, source: str, along: bool
) -> None:
    ahead = 40
    observer = Observer(arm(), ObserverSettings(step=STEP, source=source, horizon=ahead * STEP))
    estimated, predicted = replay(observer, recording, along=along)
    true = recording.deflection[ahead:]
    held = error(estimated[:-ahead], true)
    assert error(predicted[:-ahead], true) < 0.2 * held


def test_observer_starts_in_static_equilibrium(recording: Recording) -> None:
    robot = arm()
    observer = Observer(robot, ObserverSettings(step=STEP))
    assert not observer.started
    observer.measure(5.0, np.array([-0.4, 0.3]))
    np.testing.assert_allclose(
        observer.q, robot.static_deflection(np.array([-0.4, 0.3])), atol=1e-12
    )
    for k in range(1, 200):
        observer.measure(5.0 + k * STEP, np.array([-0.4, 0.3]), np.zeros(2))
        observer.tick(5.0 + k * STEP)
    assert np.max(np.abs(observer.qd)) < 1e-6


def test_late_and_repeated_measurements_are_refused_and_counted() -> None:
    observer = Observer(arm(), ObserverSettings(step=STEP, max_age=0.02))
    q, still = np.array([-0.4, 0.3]), np.zeros(2)
    for k in range(50):
        observer.measure(k * STEP, q, still)
        observer.tick(k * STEP)
    state = observer.q.copy()
    assert not observer.measure(49 * STEP, q + 1.0, still)
    assert not observer.measure(40 * STEP, q + 1.0, still)
    observer.tick(100 * STEP)
    assert observer.stale
    assert not observer.measure(60 * STEP, q + 1.0, still)
    assert (observer.repeated, observer.late) == (2, 1)
    np.testing.assert_allclose(observer.q, state, atol=1e-3)


def test_estimate_goes_no_further_than_the_age_allowed(recording: Recording) -> None:
    observer = Observer(arm(), ObserverSettings(step=STEP, max_age=0.02))
    for k in range(500):
        observer.measure(recording.run.t[k], recording.q[k], recording.qd[k])
    last = recording.run.t[499]
    observer.tick(last + 0.0199)
    assert not observer.stale
    limit = observer.q.copy()
    observer.tick(last + 3.0)
    assert observer.stale
    np.testing.assert_allclose(observer.q, limit, atol=1e-3)


def test_gap_is_bridged_by_the_mean_motion(recording: Recording) -> None:
    observer = Observer(arm(), ObserverSettings(step=STEP))
    for k in [*range(300), *range(330, 600)]:
        assert observer.measure(recording.run.t[k], recording.q[k], recording.qd[k])
        observer.tick(recording.run.t[k])
    got = observer.deflections.evaluate(observer.q, observer.qd)[0]
    true = recording.deflection
    gap = np.abs(got[[1, 7]] - true[599, [1, 7]])
    # 30 ms of joints going on as they did, a fortieth of their period: that is all that is lost
    assert np.max(gap / np.max(np.abs(true[:, [1, 7]]), axis=0)) < 0.03
    assert observer.restarts == 0


def test_long_gap_is_jumped_over_and_counted(recording: Recording) -> None:
    observer = Observer(arm(), ObserverSettings(step=STEP))
    for k in (0, 1, 500):
        observer.measure(recording.run.t[k], recording.q[k], recording.qd[k])
    observer.tick(recording.run.t[500])
    joints = np.asarray(arm().joint_indices)
    assert observer.restarts == 1
    assert observer.time == pytest.approx(0.5)
    np.testing.assert_allclose(observer.q[joints], recording.q[500], atol=1e-6)


def test_reset_forgets_everything(recording: Recording) -> None:
    observer = Observer(arm(), ObserverSettings(step=STEP))
    once = replay(observer, recording)[0][200]
    observer.reset()
    assert not observer.started
    again = replay(observer, recording)[0][200]
    np.testing.assert_array_equal(once, again)


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'source': 'gyro'}, "source must be one of joints, torque, got 'gyro'"),
        ({'cutoff': 0.0}, 'cutoff must be > 0 Hz, got 0.0'),
        ({'horizon': -1.0}, 'horizon must be >= 0 s, got -1.0'),
        ({'horizon_steps': 0}, 'horizon_steps must be >= 1, got 0'),
        ({'max_age': float('nan')}, 'max_age must be a number > 0 s, got nan'),
    ],
)
def test_bad_settings_are_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(dn.StateError, match=message):
        replace(ObserverSettings(step=STEP), **change)  # type: ignore[arg-type]
