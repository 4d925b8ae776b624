"""Gauges fused with the model, on robots that simulation knows better than the observer."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest
from gauge_runs import (
    ROBOTS,
    STEP,
    errors,
    joints_of,
    load,
    observer,
    record,
    reference,
    replay,
)
from lxml import etree
from planar_chains import PlanarLink, planar_chain

import denoc_ros as dn
from denoc_ros.dynamics.structure import sensor_rows
from denoc_ros.estimation.fusion import WAITING, FusionSettings
from denoc_ros.estimation.observer import Observer
from denoc_ros.estimation.observer_settings import ObserverSettings


@pytest.mark.long_cases('ssrms')
@pytest.mark.parametrize('name', ['canadarm', 'ssrms'])
def test_right_model_with_gauges_errs_by_less_than_a_hundredth(name: str) -> None:
    data = record(name, True)
    found = observer(name, data)
    assert errors(found, replay(found, data), data.deflection).max() < 0.01
    counts = sum(found.fusion.counts, Counter()) if found.fusion else Counter()
    # beyond five deviations comes one value in two million
    assert counts == {'accepted': data.gauges.size}


@pytest.mark.long_cases('ssrms')
@pytest.mark.parametrize('name', ['canadarm', 'ssrms'])
def test_gauges_mend_a_wrong_model(name: str) -> None:
    data = record(name, False)
    fused, ignoring = observer(name, data), observer(name, data, fuse=False)
    with_gauges = errors(fused, replay(fused, data), data.deflection)
    without = errors(ignoring, replay(ignoring, data), data.deflection)
    assert with_gauges.max() < 0.05
    assert (without / with_gauges).min() > 5.0
    # the residual tells of the load: what the model alone shows is off by the wrong share
    assert fused.fusion is not None
    left = fused.fusion.unexplained()
    shown = sensor_rows(load(name)) @ data.run.q[-1]
    large = np.abs(shown) > 0.3 * np.abs(data.gauges).max(axis=0)
    assert large.any()
    assert (left[large] / shown[large] > 0.02).all()


@pytest.mark.long_cases('ssrms-True')
@pytest.mark.parametrize('known', [True, False])
@pytest.mark.parametrize('name', ['canadarm', 'ssrms'])
def test_horizon_along_the_reference(name: str, known: bool) -> None:
    data, ahead = record(name, known), 50
    found = observer(name, data, horizon=ahead * STEP)
    joints = joints_of(found)
    wanted, predicted, rows = reference(name, len(joints)), [], []
    for k, t in enumerate(data.run.t[:-ahead]):
        found.measure(t, data.run.q[k, joints], data.run.qd[k, joints])
        for place, value in enumerate(data.gauges[k]):
            found.sense(place, t, float(value))
        found.tick(t)
        if k % 50 == 0 and k > 0:
            later = found.predict(wanted)
            predicted.append(found.deflections.evaluate(*later)[0].copy())
            rows.append(k + ahead)
    true = data.deflection
    peak = np.abs(true).max(axis=0)
    gap = np.sqrt(np.mean((np.array(predicted) - true[rows]) ** 2, axis=0))
    assert (gap[peak > 1e-3] / peak[peak > 1e-3]).max() < 0.05


@pytest.mark.parametrize('name', ['canadarm', 'ssrms'])
def test_robot_with_gauges_is_the_robot(name: str) -> None:
    gauges = etree.parse(ROBOTS / f'{name}_gauges.urdf').getroot()
    plain = etree.parse(ROBOTS / f'{name}.urdf').getroot()
    for sensor in gauges.findall('flexibility/sensor'):
        sensor.getparent().remove(sensor)
    for root in (gauges, plain):
        etree.strip_tags(root, etree.Comment)
    assert text_of(gauges) == text_of(plain)


def text_of(root: Any) -> str:
    """XML without what spaces stand between elements."""
    return ''.join(etree.tostring(root, encoding='unicode').split())


@pytest.mark.long_cases('15-1-joints-0.01', '0-1-torque-0.01')
@pytest.mark.parametrize(
    ('late', 'every', 'source', 'bound'),
    [(15, 1, 'joints', 0.01), (0, 1, 'torque', 0.01), (7, 20, 'joints', 0.03)],
)
def test_late_and_slow_gauges_still_mend_the_model(
    late: int, every: int, source: str, bound: float
) -> None:
    data = record('canadarm', False)
    found = observer('canadarm', data, source=source)
    estimated = replay(found, data, late=late, every=every)
    assert errors(found, estimated, data.deflection).max() < bound


def test_order_of_arrival_hardly_matters() -> None:
    data, ticks = record('canadarm', False), 1000
    prompt, mixed = observer('canadarm', data), observer('canadarm', data)
    once = replay(prompt, data, ticks=ticks)[-1]
    joints = joints_of(mixed)
    run = data.run
    for begin in range(0, ticks, 5):
        rows = range(begin, begin + 5)
        for k in rows:
            mixed.measure(run.t[k], run.q[k, joints], run.qd[k, joints])
        # sensor by sensor, the newest first
        for place in range(data.gauges.shape[1]):
            for k in reversed(rows):
                mixed.sense(place, run.t[k], float(data.gauges[k, place]))
        mixed.tick(run.t[begin + 4])
    assert mixed.fusion is not None
    again = mixed.deflections.evaluate(mixed.q, mixed.qd)[0]
    # corrections are carried over 4 ms linearly, which the model is not quite; what gauges read of
    # the beams' inertia is that of the newest state: 3e-5 of 14 mm
    np.testing.assert_allclose(again, once, atol=1e-6)


def test_gauges_that_are_behind_others_are_worth_little_less() -> None:
    data, ticks = record('canadarm', False), 1000
    prompt, behind = observer('canadarm', data), observer('canadarm', data)
    once, run, joints = replay(prompt, data, ticks=ticks)[-1], data.run, joints_of(behind)
    # one is 5 ms behind the other, which waits for it: fast modes turn by more than half in that
    for k in range(ticks):
        behind.measure(run.t[k], run.q[k, joints], run.qd[k, joints])
        for place, row in enumerate((k - 5, k, k - 5, k)):
            if row >= 0:
                behind.sense(place, run.t[row], float(data.gauges[row, place]))
        behind.tick(run.t[k])
    again = behind.deflections.evaluate(behind.q, behind.qd)[0]
    assert behind.fusion is not None
    assert sum(behind.fusion.counts, Counter())['outlier'] == 0
    # what is fused later is worth less than half the noise, 1 % of the peaks
    peak = np.abs(data.deflection).max(axis=0)
    assert (np.abs(again - once)[[1, 7]] / peak[[1, 7]]).max() < 0.005


def test_missing_and_wild_values_are_survived_and_counted() -> None:
    data, rng = record('canadarm', False), np.random.default_rng(3)

    def spoil(row: int, place: int, value: float) -> float | None:
        if rng.random() < 0.3:
            return None
        if rng.random() < 0.05:
            return value + 60.0 * float(data.noise[place])
        return float('nan') if row == 500 else value

    found = observer('canadarm', data)
    estimated = replay(found, data, spoil=spoil)
    assert errors(found, estimated, data.deflection).max() < 0.01
    assert found.fusion is not None
    counts = sum(found.fusion.counts, Counter())
    sent = 0.7 * data.gauges.size
    assert counts['outlier'] == pytest.approx(0.05 * sent, rel=0.15)
    assert counts['accepted'] == pytest.approx(0.95 * sent, rel=0.02)
    assert 0 < counts['not_finite'] <= 4
    assert counts['excluded'] == 0


def test_jump_of_all_gauges_leaves_the_estimate_to_the_joints_until_they_agree() -> None:
    data = record('canadarm', True)

    def spoil(row: int, place: int, value: float) -> float | None:
        return value + 100.0 * float(data.noise[place]) if 500 <= row < 1000 else value

    found = observer('canadarm', data)
    estimated = replay(found, data, spoil=spoil)
    assert found.fusion is not None
    # the joints alone are exact here; what the jump moved the tip by until it was found is bounded
    assert errors(found, estimated[:1000], data.deflection).max() < 0.05
    assert sum(found.fusion.counts, Counter())['excluded'] > 4 * 400
    assert found.fusion.faults.uses_all
    assert errors(found, estimated[3000:], data.deflection[3000:]).max() < 0.01


def test_values_dated_by_their_arrival_are_no_outliers() -> None:
    """A Float64 has no stamp, and within a millisecond it changes by more than its noise."""
    dial = (
        '<sensor name="tip" type="deflection" link="link_1" station="1" direction="y"'
        ' noise="6e-5"/>'
    )
    arm = planar_chain(
        (PlanarLink(1.0, 2.0, 60.0), PlanarLink(0.8, 1.0)), 1, damping_ratio=0.02, sensors=dial
    )
    robot = dn.load_robot(arm, gravity=(0.0, -9.81, 0.0))
    start, still = robot.static_deflection([0.0, 0.0]), np.zeros(robot.n)
    swing = dict.fromkeys(
        robot.joint_names,
        lambda t: (0.2 * (1 - np.cos(4 * t)), 0.8 * np.sin(4 * t), 3.2 * np.cos(4 * t)),
    )
    run = dn.simulate(robot, start, still, np.linspace(0.0, 1.5, 301), prescribed=swing, rtol=1e-7)
    seen, joints = robot.sensor_values(run.q)[:, 0], robot.joint_indices
    late = np.random.default_rng(5).uniform(0.005, 0.010, len(seen))
    bent = run.q[:, robot.flexible_indices[0]]
    share, error = {}, {}
    for timing_error in (0.0, FusionSettings().timing_error):
        settings = FusionSettings(timing_error=timing_error)
        found = Observer(
            robot.with_overrides({'beam.link_1.y.ei': 45.0}),  # the model is too soft
            ObserverSettings(step=0.005, fusion=settings),
        )
        off = []
        for k, t in enumerate(run.t):
            found.measure(t, run.q[k, joints], run.qd[k, joints])
            found.sense(0, t + late[k], float(seen[k]))
            found.tick(t)
            off.append(abs(found.q[robot.flexible_indices[0]] - bent[k]))
        assert found.fusion is not None
        counts = found.fusion.counts[0]
        share[timing_error] = counts['outlier'] / counts.total()
        error[timing_error] = float(np.median(off[40:]) / np.abs(bent).max())
    assert share.pop(0.0) > 0.5
    # outliers for long start the estimate again from that of the fault detection: it errs less
    assert 0.01 < error.pop(0.0) < 0.02
    assert max(share.values()) < 0.02
    assert max(error.values()) < 0.02


def test_late_repeated_and_early_values_are_counted() -> None:
    data = record('canadarm', True)
    found = observer('canadarm', data, max_age=0.02)
    assert not found.sense(0, 0.0, 0.0)
    replay(found, data, spoil=lambda *_: None, ticks=100)
    assert found.fusion is not None
    counts = found.fusion.counts[0]
    assert found.sense(0, 0.099, float(data.gauges[99, 0]))
    assert not found.sense(0, 0.099, float(data.gauges[99, 0]))
    assert found.sense(0, 0.05, float(data.gauges[50, 0]))
    found.tick(0.099)
    assert counts == {'accepted': 1, 'repeated': 1, 'late': 1}
    # one that is ahead of the joints waits for them
    assert found.sense(0, 0.1, float(data.gauges[100, 0]))
    found.tick(0.1)
    assert counts['accepted'] == 1
    joints = joints_of(found)
    found.measure(0.1, data.run.q[100, joints], data.run.qd[100, joints])
    assert counts['accepted'] == 2


def test_waiting_values_are_bounded() -> None:
    data = record('canadarm', True)
    found = observer('canadarm', data)
    replay(found, data, spoil=lambda *_: None, ticks=2)
    for k in range(WAITING + 10):
        found.sense(1, 1.0 + k * STEP, 0.0)
    assert found.fusion is not None
    assert found.fusion.counts[1]['overflow'] == 10


def test_an_observer_goes_on_where_another_was() -> None:
    data = record('canadarm', False)
    first, second = observer('canadarm', data), observer('canadarm', data)
    replay(first, data, ticks=300)
    second.adopt(first)
    joints = joints_of(first)
    for found in (first, second):
        if found is second:
            second.adopt(first)
        found.measure(0.3, data.run.q[300, joints], data.run.qd[300, joints])
    np.testing.assert_array_equal(first._q, second._q)


def test_an_observer_goes_on_without_sensors_that_contradicted_each_other() -> None:
    data = record('canadarm', True)
    first, second = observer('canadarm', data), observer('canadarm', data)
    spoilt = data.gauges[:, :2].copy()
    spoilt[500:] *= -4.0

    def spoil(row: int, place: int, value: float) -> float:
        return float(spoilt[row, place]) if place < 2 else value

    replay(first, data, spoil=spoil, ticks=900)
    assert first.fusion is not None
    assert second.fusion is not None
    before, after = first.fusion.faults, second.fusion.faults
    assert before.uses_joints_only
    second.adopt(first)
    assert after.uses_joints_only
    joints = joints_of(second)
    for row in range(900, 1200):
        t = float(data.run.t[row])
        second.measure(t, data.run.q[row, joints], data.run.qd[row, joints])
        for place in range(data.gauges.shape[1]):
            second.sense(place, t, float(data.gauges[row, place]))
        second.tick(t)
        assert after.uses_joints_only


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('', 'fused sensors must be at least one, got none'),
        ('noise="0"', r'must have noise > 0 .* got 0 for link_1_y_root'),
    ],
)
def test_robot_that_cannot_be_fused_is_refused(text: str, message: str) -> None:
    robot = load('canadarm').with_overrides({'sensor.link_1_y_root.noise': 0.0})
    if not text:
        robot = dn.load_robot(ROBOTS / 'canadarm.urdf')
    with pytest.raises(dn.StateError, match=message):
        Observer(robot, ObserverSettings(step=STEP, fusion=FusionSettings()))


@pytest.mark.parametrize(
    ('name', 'bound'),
    [
        ('model_error', '> 0'),
        ('initial_deflection', '> 0'),
        ('gate', '> 0'),
        ('patience', '> 0 s'),
        ('timing_error', '>= 0 s'),
    ],
)
def test_bad_fusion_settings_are_refused(name: str, bound: str) -> None:
    with pytest.raises(dn.StateError, match=f'fusion: {name} must be {bound}, got -1'):
        FusionSettings(**{name: -1.0})
