"""Modes from torque and response: an exact discretization, and a real arm."""

from __future__ import annotations

import numpy as np
import pytest
from data_files import FLEXIBLE_ARM
from scipy.io import loadmat
from scipy.signal import cont2discrete, lfilter

import denoc_ros as dn
from denoc_ros.identification.decay.forced import fit_forced
from denoc_ros.identification.decay.records import Record

STEP = 0.005
MODES = ((3.0, 0.02, 1.0), (11.0, 0.01, 2.0))


def driven(noise: float, samples: int = 1024) -> tuple[Record, Record]:
    draw = np.random.default_rng(3)
    torque = draw.standard_normal(samples)
    response = np.zeros(torque.size)
    for frequency, zeta, gain in MODES:
        rate = 2.0 * np.pi * frequency
        plant = ([gain * rate**2], [1.0, 2.0 * zeta * rate, rate**2])
        above, below, _ = cont2discrete(plant, STEP)
        response += lfilter(above.ravel(), below, torque)
    response += noise * response.std() * draw.standard_normal(torque.size)
    t = np.asarray(STEP * np.arange(torque.size), float)
    return Record(t, np.asarray(torque, float), 'torque'), Record(t, response, 'response')


def test_modes_are_those_of_the_plant() -> None:
    found = fit_forced(*driven(0.01))
    assert found.status == 'good'
    # 1 % of noise on 1024 samples; the intervals below say how much that is
    np.testing.assert_allclose(found.frequency, [3.0, 11.0], rtol=1e-3)
    np.testing.assert_allclose(found.damping_ratio, [0.02, 0.01], rtol=0.03)
    assert np.all(found.interval[:, 0] < [0.0203, 0.0101])
    assert np.all(found.interval[:, 1] > [0.0197, 0.0099])
    assert found.explained > 0.99


def test_noise_that_does_not_follow_the_torque_is_no_mode() -> None:
    torque, _ = driven(0.0)
    y = np.random.default_rng(4).standard_normal(torque.t.size)
    found = fit_forced(torque, Record(torque.t, y))
    assert found.status == 'not identifiable'
    assert found.frequency.size == 0
    said = ('follows from the input', 'are no modes', 'no mode explains')
    assert any(text in found.remarks[0] for text in said)


def test_two_coupled_inputs_are_told_apart() -> None:
    first, response = driven(0.0, 512)
    draw = np.random.default_rng(6)
    # a second torque that follows the first by half and drives the second mode otherwise
    second = 0.5 * first.y + draw.standard_normal(first.t.size)
    rate = 2.0 * np.pi * MODES[1][0]
    plant = ([3.0 * rate**2], [1.0, 2.0 * MODES[1][1] * rate, rate**2])
    above, below, _ = cont2discrete(plant, STEP)
    y = response.y + lfilter(above.ravel(), below, second)
    y = y + 0.01 * y.std() * draw.standard_normal(y.size)
    inputs = [first, Record(first.t, second, 'second')]
    found = fit_forced(inputs, Record(first.t, y, 'response'))
    np.testing.assert_allclose(found.frequency, [3.0, 11.0], rtol=1e-3)
    # 2.6 s hold eight cycles of the slower one: 10 % is within its interval
    np.testing.assert_allclose(found.damping_ratio, [0.02, 0.01], rtol=0.2)
    assert np.all(found.interval[:, 0] < [0.02, 0.01])
    assert np.all(found.interval[:, 1] > [0.02, 0.01])
    assert found.measured.shape == (found.line.size, 2)
    assert found.explained > 0.99
    with pytest.raises(dn.IdentificationError, match='inputs must differ'):
        fit_forced([first, first], response)


def test_every_verdict_has_reasons() -> None:
    found = fit_forced(*driven(0.05, 512))
    assert found.verdict
    assert all(found.reasons)
    assert 'standard deviation of the damping ratio is' in found.reasons[0][0]


def test_other_stamps_and_a_resting_input_are_refused() -> None:
    torque, response = driven(0.0)
    with pytest.raises(dn.IdentificationError, match='same stamps, got 1024 and 1023'):
        fit_forced(torque, Record(response.t[1:], response.y[1:]))
    with pytest.raises(dn.IdentificationError, match='the input must move'):
        fit_forced(Record(torque.t, np.zeros(torque.t.size)), response)


@pytest.mark.long
def test_flexible_arm_has_two_strong_modes() -> None:
    table = loadmat(FLEXIBLE_ARM)['robot_arm_dat']
    # the rate is not stated: the stamps count samples
    t = np.arange(len(table), dtype=float)
    found = fit_forced(Record(t, table[:, 0]), Record(t, table[:, 1]))
    strong = found.strength > 0.1 * found.strength.max()
    # two fits to halves of the record agree to three digits on these
    np.testing.assert_allclose(found.frequency[strong], [0.0582, 0.1267], rtol=0.01)
    assert np.all((found.damping_ratio[strong] > 0.002) & (found.damping_ratio[strong] < 0.007))
    assert found.explained > 0.999
