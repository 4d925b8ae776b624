"""Joint friction from a free swing: against an integrator of another kind, and a real servo."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from data_files import SERVO_SWING
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.special import ellipk

import denoc_ros as dn
from denoc_ros.identification.decay.channel import Channel
from denoc_ros.identification.decay.records import Record
from denoc_ros.identification.joint.joint_swing import JointOptions, fit_joint, identify_joint
from denoc_ros.identification.joint.swing import JointSwing, swing_angles

Floats = NDArray[np.float64]
INERTIA, GRAVITY = 0.02, 1.0


def measured_swing(
    viscous: float, coulomb: float, seconds: float = 4.0, quadratic: float = 0.0
) -> Record:
    """Pendulum released at 1.2 rad, integrated with a smooth Coulomb law."""
    t = np.arange(0.0, seconds, 0.02)

    def slope(_: float, state: Floats) -> list[float]:
        torque = GRAVITY * np.sin(state[0]) + viscous * state[1]
        torque += quadratic * abs(state[1]) * state[1]
        return [state[1], -(torque + coulomb * np.tanh(state[1] / 1e-3)) / INERTIA]

    angle = solve_ivp(slope, (0.0, seconds), [1.2, 0.0], 'LSODA', t, rtol=1e-9, atol=1e-11).y[0]
    return Record(t, 0.1 + angle + 1e-3 * np.random.default_rng(2).standard_normal(t.size))


def test_swing_without_friction_has_the_period_of_a_pendulum() -> None:
    amplitude, stiffness = 2.0, 40.0
    period = 4.0 * ellipk(np.sin(amplitude / 2.0) ** 2) / np.sqrt(stiffness)
    t = period * np.arange(4.0)
    angles = swing_angles(JointSwing(amplitude, 0.0, 0.0, stiffness), t)
    # fourth order, 60 steps per cycle of a small swing: it loses 1e-6 of the amplitude per cycle
    np.testing.assert_allclose(angles, amplitude, rtol=5e-6)


def test_swing_stays_where_friction_holds_it() -> None:
    t = np.linspace(0.0, 20.0, 2000)
    angles = swing_angles(JointSwing(1.0, 0.0, 0.0, 40.0, coulomb=2.0), t)
    assert np.ptp(angles[-500:]) < 1e-15  # rounding of the interpolation
    assert abs(np.sin(angles[-1])) <= 2.0 / 40.0


def test_coulomb_friction_takes_the_same_off_each_half_swing() -> None:
    stiffness, coulomb = 40.0, 1.0
    half = np.pi / np.sqrt(stiffness)
    swing = JointSwing(1.0, 0.0, 0.0, stiffness, coulomb=coulomb)
    crests = np.abs(swing_angles(swing, half * np.arange(6.0), large=False))
    np.testing.assert_allclose(np.diff(crests), -2.0 * coulomb / stiffness, rtol=1e-5)


@pytest.mark.long
def test_viscous_and_coulomb_terms_are_told_apart() -> None:
    fit = fit_joint(measured_swing(0.01, 0.02), gravity_torque=GRAVITY)
    assert fit.terms == ('viscous', 'coulomb')
    assert fit.verdict == 'good'
    # 200 samples of 1e-3 rad on a swing of 1 rad: some 0.3 % each
    assert fit.viscous == pytest.approx(0.01, rel=0.02)
    assert fit.coulomb == pytest.approx(0.02, rel=0.02)
    assert fit.inertia == pytest.approx(INERTIA, rel=1e-3)
    assert fit.residual == pytest.approx(1e-3, rel=0.2)
    rejected = {model.terms: model.rejected for model in fit.models}
    assert 'times the residual' in rejected['viscous',]
    assert rejected['viscous', 'coulomb'] == ''


def test_viscous_joint_gets_no_coulomb_term() -> None:
    fit = fit_joint(measured_swing(0.02, 0.0, 2.0), inertia=INERTIA)
    assert fit.terms == ('viscous',)
    assert fit.viscous == pytest.approx(0.02, rel=0.01)
    assert fit.damping_ratio == pytest.approx(0.02 / (2.0 * np.sqrt(INERTIA * GRAVITY)), rel=0.01)
    assert fit.interval['viscous'][0] < 0.02 < fit.interval['viscous'][1]


def test_without_inertia_coefficients_are_per_inertia() -> None:
    fit = fit_joint(measured_swing(0.02, 0.0, 2.0))
    assert fit.inertia == 1.0
    assert fit.viscous == pytest.approx(0.02 / INERTIA, rel=0.01)
    assert any('per inertia' in reason for reason in fit.reasons)


def test_record_that_does_not_swing_is_refused() -> None:
    t = np.linspace(0.0, 1.0, 100)
    with pytest.raises(dn.IdentificationError, match='pass its rest position at least 2 times'):
        fit_joint(Record(t, np.exp(-5.0 * t)))


@pytest.mark.long
def test_coulomb_and_quadratic_terms_are_found_without_a_viscous_one() -> None:
    fit = fit_joint(measured_swing(0.0, 0.02, quadratic=0.004), gravity_torque=GRAVITY)
    assert fit.terms == ('coulomb', 'quadratic')
    assert fit.verdict == 'good'
    # 200 samples of 1e-3 rad on a swing of 1 rad: some 0.3 % each
    assert fit.coulomb == pytest.approx(0.02, rel=0.02)
    assert fit.quadratic == pytest.approx(0.004, rel=0.02)


def servo_swing(begin: float) -> tuple[Record, float]:
    """Free swing of the real servo pendulum from a time on [s], and gravity's torque [N m]."""
    raw = json.loads(SERVO_SWING.read_text())
    free = [entry for entry in raw['entries'] if entry['timestamp'] >= begin]
    t, y = (np.array([entry[name] for entry in free]) for name in ('timestamp', 'position'))
    return Record(t, y), raw['mass'] * 9.81 * raw['length']


@pytest.mark.long_cases('2.3', '2.8')
@pytest.mark.parametrize('begin', [2.3, 2.8, 3.0])
def test_terms_are_told_from_zero_or_left_out(begin: float) -> None:
    record, torque = servo_swing(begin)
    fit = fit_joint(record, gravity_torque=torque)
    for name in fit.terms:
        low, high = fit.interval[name]
        assert 0.0 < low < getattr(fit, name) < high < np.inf
    # a set of terms never leaves more than one that it contains
    for model in fit.models:
        for smaller in fit.models:
            if set(smaller.terms) < set(model.terms):
                assert model.residual <= smaller.residual * (1.0 + 1e-12)


def test_sets_of_terms_that_explain_as_much_are_doubted() -> None:
    record, torque = servo_swing(3.0)
    fit = fit_joint(record, gravity_torque=torque)
    # half a swing before it stops: viscous and quadratic friction take about the same off it
    assert fit.verdict == 'doubtful'
    assert any('explains the swing about as well' in reason for reason in fit.reasons)


def test_servo_pendulum_has_viscous_and_coulomb_friction() -> None:
    raw = json.loads(SERVO_SWING.read_text())
    free = [entry for entry in raw['entries'] if not entry['torque_enable']]
    record = Record(
        np.array([entry['timestamp'] for entry in free]),
        np.array([entry['position'] for entry in free]),
    )
    fit = fit_joint(record, gravity_torque=raw['mass'] * 9.81 * raw['length'])
    assert fit.terms == ('viscous', 'coulomb')
    assert fit.frequency == pytest.approx(1.14, abs=0.01)
    # known from other fits of this record; theirs and ours differ in where the swing begins
    assert fit.viscous == pytest.approx(0.0698, rel=0.05)
    assert fit.coulomb == pytest.approx(0.031, rel=0.1)
    viscous = next(model for model in fit.models if model.terms == ('viscous',))
    assert viscous.residual > 1.9 * fit.residual
    assert 'times the residual' in viscous.rejected


def test_a_swing_about_half_a_turn_is_that_about_zero(tmp_path: Path) -> None:
    record = measured_swing(0.004, 0.02)
    angles = {'plain': record.y, 'wrapped': (record.y + 2.0 * np.pi) % (2.0 * np.pi) - np.pi}
    found = []
    for name, y in angles.items():
        path = tmp_path / f'{name}.csv'
        rows = np.column_stack([record.t, y])
        np.savetxt(path, rows, delimiter=',', header='time,swing', comments='')
        _, read, fit = identify_joint(path, Channel(field='swing'), JointOptions(inertia=INERTIA))
        found.append((np.diff(read.y), fit))
    assert np.abs(np.diff(angles['wrapped'])).max() > 6.0
    np.testing.assert_allclose(found[1][0], found[0][0], atol=1e-9)
    assert found[1][1].viscous == pytest.approx(found[0][1].viscous, rel=1e-4)
