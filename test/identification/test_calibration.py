"""Calibration of sensors: known lines are found, and what is no line is told."""

from __future__ import annotations

import numpy as np
import pytest
from planar_chains import PlanarLink, planar_chain

import denoc_ros as dn
from denoc_ros.errors import IdentificationError, StateError
from denoc_ros.identification.calibration import (
    calibrate,
    calibration_paths,
    find_plateaus,
    match_levels,
    sensor_values,
)

GAIN, OFFSET = 2.5e-6, -3.0e-4
LOADING = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 3.0, 2.0, 1.0, 0.0]) * 1e-3
LENGTH, EI, SURFACE, STATION = 0.8, 60.0, 0.002, 0.1
GAUGE = (
    f'<sensor name="gauge" type="strain_gauge" link="link_1" station="{STATION}" direction="y"'
    f' surface="{SURFACE}" topic="/strain"/>'
    '<sensor name="dial" type="deflection" link="link_1" station="0.8" direction="y"/>'
)


def readings(reference: np.ndarray) -> np.ndarray:
    return np.asarray((reference - OFFSET) / GAIN)


def arm(modes: int) -> dn.Robot:
    return dn.load_robot(planar_chain([PlanarLink(LENGTH, 1.0, EI)], modes, sensors=GAUGE))


def test_exact_readings_give_the_line_back() -> None:
    found = calibrate(readings(LOADING), LOADING)
    np.testing.assert_allclose([found.gain, found.offset], [GAIN, OFFSET], rtol=1e-12)
    assert found.residual < 1e-15
    assert found.hysteresis < 1e-12
    assert found.curvature < 1e-12
    assert found.doubts == ()


def test_standard_errors_are_the_spread() -> None:
    rng = np.random.default_rng(1)
    fits = [
        calibrate(readings(LOADING) + 4.0 * rng.standard_normal(len(LOADING)), LOADING)
        for _ in range(600)
    ]
    gains, offsets = (np.array([getattr(f, name) for f in fits]) for name in ('gain', 'offset'))
    # 600 draws know a standard deviation to 2.9 %
    assert np.std(gains) == pytest.approx(np.mean([f.gain_error for f in fits]), rel=0.12)
    assert np.std(offsets) == pytest.approx(np.mean([f.offset_error for f in fits]), rel=0.12)
    assert np.mean(gains) == pytest.approx(GAIN, rel=1e-3)
    # of a single reading
    assert np.mean([f.residual**2 for f in fits]) == pytest.approx((4.0 * GAIN) ** 2, rel=0.1)


def test_hysteresis_is_the_gap_between_the_ways() -> None:
    away = np.zeros(len(LOADING))
    away[5:8] = 0.03 * 4e-3
    found = calibrate(readings(LOADING + away), LOADING)
    assert found.hysteresis == pytest.approx(0.03, rel=0.03)
    assert any('hysteresis' in doubt for doubt in found.doubts)
    assert np.isnan(calibrate(readings(LOADING[:5]), LOADING[:5]).hysteresis)


def test_curvature_is_told() -> None:
    bent = LOADING + 40.0 * LOADING * (4e-3 - LOADING)
    found = calibrate(readings(bent), LOADING)
    assert found.curvature > 0.02
    assert any('curvature' in doubt for doubt in found.doubts)


@pytest.mark.parametrize(
    ('raw', 'reference', 'message'),
    [
        ([1.0, 2.0], [1.0, 2.0], 'points must be at least 3, got 2'),
        ([1.0, 2.0, 3.0], [1.0, 1.0, 1.0], 'references must not be all the same, got 1 only'),
        ([5.0, 5.0, 5.0], [1.0, 2.0, 3.0], 'readings must not be all the same, got 5 only'),
        ([1.0, 2.0, 1.0, 2.0], [1.0, 1.0, 2.0, 2.0], 'readings must follow the references'),
    ],
)
def test_no_line_is_no_calibration(raw: list[float], reference: list[float], message: str) -> None:
    with pytest.raises(IdentificationError, match=message):
        calibrate(raw, reference)


def test_bad_arrays_are_refused() -> None:
    with pytest.raises(StateError, match='raw must have shape'):
        calibrate([1.0], [1.0, 2.0, 3.0])
    with pytest.raises(StateError, match='raw must be finite'):
        calibrate([1.0, 2.0, np.nan], [1.0, 2.0, 3.0])


def test_plateaus_are_found_whatever_their_length() -> None:
    rng = np.random.default_rng(2)
    levels, seconds, rate = [3.0, -1.0, 4.0, 4.2, 0.0], [2.0, 1.3, 5.0, 2.0, 1.5], 200.0
    parts, previous = [], levels[0]
    for level, length in zip(levels, seconds, strict=True):
        parts.append(np.linspace(previous, level, 60))
        parts.append(np.full(round(length * rate), level))
        previous = level
    clean = np.concatenate(parts)
    signal = clean + 0.02 * rng.standard_normal(len(clean))
    found = find_plateaus(np.arange(len(signal)) / rate, signal)
    np.testing.assert_allclose(found.means, levels, atol=0.01)
    assert found.deviation == pytest.approx(0.02, rel=0.15)
    with pytest.raises(IdentificationError, match=r'as many as levels \(4\), got 5 at'):
        match_levels(found, levels[:4])


def test_signal_that_never_stands_has_no_plateaus() -> None:
    t = np.arange(0.0, 5.0, 0.01)
    with pytest.raises(IdentificationError, match='must stand still for 1 s'):
        find_plateaus(t, np.sin(6.0 * t))
    with pytest.raises(IdentificationError, match='must last 1 s'):
        find_plateaus(t[:50], t[:50])
    with pytest.raises(StateError, match='t must rise'):
        find_plateaus(t[::-1], t)


def test_strain_of_a_tip_load_is_the_cantilevers() -> None:
    # what the modes leave out is less than a hundredth of the curvature there
    robot = arm(4)
    got = sensor_values(robot, 'gauge', [0.0, 2.0], 'load')
    np.testing.assert_allclose(got, [0.0, -SURFACE * 2.0 * (LENGTH - STATION) / EI], rtol=0.01)
    bent = sensor_values(robot, 'gauge', [1e-3], 'deflection')
    wanted = -SURFACE * 3.0 * (LENGTH - STATION) / LENGTH**3 * 1e-3
    np.testing.assert_allclose(bent, wanted, rtol=0.01)
    np.testing.assert_allclose(sensor_values(arm(2), 'dial', [1e-3], 'deflection'), 1e-3)
    np.testing.assert_array_equal(sensor_values(arm(2), 'dial', [5.0]), [5.0])


def test_calibrated_gauge_gives_the_deflection_back() -> None:
    robot, known = arm(2), LOADING
    volts = 40.0 * known + 0.2
    strain = sensor_values(robot, 'gauge', known, 'deflection')
    found = calibrate(volts, strain, deviation=1e-3)
    paths = calibration_paths('gauge', found)
    sensor = robot.with_overrides(paths).tree.sensors[0]
    assert sensor.noise == pytest.approx(abs(found.gain) * 1e-3)
    per_deflection = sensor_values(robot, 'gauge', [1.0], 'deflection')[0]
    np.testing.assert_allclose(
        (sensor.gain * volts + sensor.offset) / per_deflection, known, atol=1e-12
    )


def test_unknown_sensor_and_kind_are_refused() -> None:
    with pytest.raises(StateError, match="sensor must be one of gauge, dial, got 'strain'"):
        sensor_values(arm(1), 'strain', [1.0])
    with pytest.raises(StateError, match=r"reference must be one of value, .* got 'volt'"):
        sensor_values(arm(1), 'dial', [1.0], 'volt')
