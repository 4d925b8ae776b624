"""Laws of the fit of modes: what must not change it, what it must and must not find."""

from __future__ import annotations

import numpy as np
import pytest
from book.selftest import Decay, Defects, Truth, synthetic_decay
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import denoc_ros as dn
from denoc_ros.identification.decay.modes_fit import fit_modes
from denoc_ros.identification.decay.records import Record

Floats = NDArray[np.float64]
TRUTH = (Truth(3.0, 0.02, 1.0, 0.4), Truth(11.0, 0.05, 0.6, 1.0))
# six standard deviations of an efficient estimate: one in 5e8 records is outside
SIX = 6.0


def decay(defects: Defects, seed: int = 0) -> Decay:
    return synthetic_decay(TRUTH, 200.0, 8.0, defects, seed)


def drifting(damping: tuple[float, float], seconds: float = 20.0, noise: float = 0.01) -> Record:
    """Oscillator of 2 Hz whose damping ratio is damping[0] + damping[1] * amplitude."""
    rate = 2.0 * np.pi * 2.0
    t = np.arange(0.0, seconds, 0.005)

    def slope(_: float, state: Floats) -> list[float]:
        amplitude = np.hypot(state[0], state[1] / rate)
        zeta = damping[0] + damping[1] * amplitude
        return [state[1], -(rate**2) * state[0] - 2.0 * zeta * rate * state[1]]

    swing = solve_ivp(slope, (0.0, seconds), [1.0, 0.0], t_eval=t, rtol=1e-6, atol=1e-8).y[0]
    return Record(t, swing + noise * np.random.default_rng(5).standard_normal(t.size))


def test_modes_of_a_clean_decay_are_its_own() -> None:
    record = decay(Defects(snr_db=100.0)).record
    modes = dn.identify_modes(record.t, record.y)
    # noise of 1e-5 of the release over 1600 samples: errors of 1e-6 and less in zeta
    np.testing.assert_allclose(modes.damping_ratio, [0.02, 0.05], rtol=1e-4)
    np.testing.assert_allclose(modes.frequency, [3.0, 11.0], rtol=1e-6)
    np.testing.assert_allclose(modes.amplitude, [1.0, 0.6], rtol=1e-4)
    np.testing.assert_allclose(modes.phase, [0.4, 1.0], atol=1e-4)
    assert modes.verdict == ('good', 'good')
    assert modes.status == 'good'
    # the residual is the noise: 1e-5 of the largest value of the sum
    assert np.std(record.y - modes.prediction(record.t)) < 2e-5


def test_unit_offset_drift_and_clock_leave_damping_alone() -> None:
    record = decay(Defects(snr_db=40.0), 3).record
    plain = fit_modes(record)
    moved = fit_modes(Record(1e9 + 2.0 * record.t, 50.0 - 7.0 * record.y + 0.3 * record.t))
    # stamps of 1e9 s are exact to 1e-7 s: a phase of 1e-5 rad, far below the noise's 1e-2
    np.testing.assert_allclose(moved.damping_ratio, plain.damping_ratio, rtol=1e-4)
    np.testing.assert_allclose(moved.frequency, plain.frequency / 2.0, rtol=1e-6)
    np.testing.assert_allclose(moved.amplitude, 7.0 * plain.amplitude, rtol=1e-4)


def test_missing_samples_and_uneven_stamps_bias_nothing() -> None:
    made = decay(Defects(snr_db=40.0, jitter=0.3, lost=0.5), 4)
    modes = fit_modes(made.record)
    errors = np.abs(modes.damping_ratio / [0.02, 0.05] - 1.0)
    assert np.all(errors < SIX * made.bound)


def test_clipping_costs_only_the_samples_it_takes() -> None:
    made = decay(Defects(snr_db=50.0, clip=0.4, offset=0.2), 5)
    modes = fit_modes(made.record)
    errors = np.abs(modes.damping_ratio / [0.02, 0.05] - 1.0)
    assert np.all(errors < SIX * made.bound)
    assert any('clipped samples left out' in remark for remark in modes.remarks)


@pytest.mark.parametrize('seed', range(4))
def test_levels_coarser_than_the_noise_make_no_modes(seed: int) -> None:
    made = synthetic_decay(
        (Truth(7.62, 0.198), Truth(47.7, 0.0428, 0.5, seed)),
        1000.0,
        2.0,
        Defects(snr_db=60.0, offset=0.3137, drift=0.05, jitter=0.1, lost=0.05, lsb=0.01),
        seed,
    )
    modes = fit_modes(made.record)
    # rounding is no noise, but with its variance the error is of the bound's size
    assert modes.frequency == pytest.approx([7.62, 47.7], rel=0.02)
    assert modes.damping_ratio == pytest.approx([0.198, 0.0428], rel=0.03)


def test_bound_is_that_of_the_truth() -> None:
    made = decay(Defects(snr_db=50.0), 6)
    # the bound at the estimate against that at the truth: noise known to 2 % from 1600 samples
    np.testing.assert_allclose(fit_modes(made.record).bound, made.bound, rtol=0.15)


def test_rest_before_the_release_is_left_out() -> None:
    made = decay(Defects(snr_db=40.0), 10)
    draw = np.random.default_rng(11)
    before = made.record.y[0] + 0.01 * draw.standard_normal(200)
    t = np.concatenate((0.005 * np.arange(200), 1.0 + made.record.t))
    modes = fit_modes(Record(t, np.concatenate((before, made.record.y))))
    np.testing.assert_allclose(modes.frequency, [3.0, 11.0], rtol=5e-3)
    # the faster mode's first cycle may be lost with the search for the release
    np.testing.assert_allclose(modes.damping_ratio, [0.02, 0.05], rtol=0.05)
    assert modes.start >= 1.0 - 0.01
    assert modes.remarks[0].startswith('starts with a rest')


def test_noise_alone_has_no_modes() -> None:
    y = np.random.default_rng(7).standard_normal(2000)
    modes = dn.identify_modes(np.arange(2000) / 100.0, y)
    assert modes.frequency.size == 0
    assert modes.status == 'not identifiable'
    assert modes.remarks == ('no mode is above the noise',)


def test_damping_that_grows_with_amplitude_is_one_mode() -> None:
    modes = fit_modes(drifting((0.005, 0.05)))
    assert modes.frequency == pytest.approx([2.0], abs=0.01)
    assert modes.verdict == ('doubtful',)
    assert any('grows with amplitude' in reason for reason in modes.reasons[0])
    curve = modes.curves[0]
    assert curve is not None
    assert curve.dependent
    # zeta of a window against the law at the window's own amplitude; the window averages over a
    # range of amplitudes of e to one, hence a tenth
    law = 0.005 + 0.05 * curve.amplitude
    np.testing.assert_allclose(curve.damping_ratio[:4], law[:4], rtol=0.15)
    assert modes.interval[0, 0] < 0.012
    assert modes.interval[0, 1] > 0.025


def test_steady_damping_is_not_called_amplitude_dependent() -> None:
    modes = fit_modes(drifting((0.01, 0.0)))
    assert modes.verdict == ('good',)
    assert modes.curves[0] is not None
    assert not modes.curves[0].dependent


def test_close_pair_that_the_record_can_tell_apart_stays_two() -> None:
    pair = (Truth(11.50, 0.002), Truth(11.62, 0.0015, 0.7, 2.0))
    made = synthetic_decay(pair, 200.0, 20.0, Defects(snr_db=40.0), 8)
    modes = fit_modes(made.record)
    np.testing.assert_allclose(modes.frequency, [11.50, 11.62], rtol=1e-4)
    assert np.all(np.abs(modes.damping_ratio / [0.002, 0.0015] - 1.0) < SIX * made.bound)


def test_harmonics_and_sums_are_lines_and_no_modes() -> None:
    record = decay(Defects(snr_db=200.0)).record
    # a sensor that is not straight: products of the modes
    y = (
        record.y
        + 0.05 * record.y**2
        + 2e-3 * np.random.default_rng(9).standard_normal(record.t.size)
    )
    modes = fit_modes(Record(record.t, y))
    # what 5 % of a square leaves that is no cosine (a decaying offset) moves the weaker mode
    np.testing.assert_allclose(modes.frequency, [3.0, 11.0], rtol=3e-3)
    origins = sorted(line.origin for line in modes.lines)
    assert [origin.split()[:2] for origin in origins] == [['11', '+'], ['2', 'x']]


@pytest.mark.parametrize(
    ('t', 'y', 'match'),
    [
        (np.arange(20.0), np.append(np.zeros(19), np.nan), 'y must be finite, got 1 values'),
        (np.arange(20.0)[::-1], np.zeros(20), 'stamps must increase'),
        (np.arange(20.0), np.zeros(19), 'same length, got 20 and 19'),
        (np.zeros((5, 4)), np.zeros(20), r'one dimension, got shape \(5, 4\)'),
        (np.repeat(np.arange(5.0), 4), np.zeros(20), 'at least 8 samples .* got 5'),
    ],
)
def test_what_is_no_record_is_refused(t: Floats, y: Floats, match: str) -> None:
    with pytest.raises(dn.IdentificationError, match=match):
        dn.identify_modes(t, y)


def test_repeated_stamps_keep_their_first_sample() -> None:
    record = Record(np.repeat(np.arange(10.0), 2), np.arange(20.0))
    np.testing.assert_array_equal(record.t, np.arange(10.0))
    np.testing.assert_array_equal(record.y, np.arange(0.0, 20.0, 2.0))
