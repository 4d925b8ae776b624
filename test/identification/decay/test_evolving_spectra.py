"""Evolving spectra: right inside their validity, refused outside it."""

from __future__ import annotations

import numpy as np
import pytest
from book.selftest import Defects, Truth, synthetic_decay

import denoc_ros as dn
from denoc_ros.identification.decay.records import Record
from denoc_ros.identification.decay.spectra import evolving_spectra, waterfall

BOOK_LINK = (Truth(7.62, 0.198), Truth(47.7, 0.0428, 0.5, 0.5))
DEFECTS = Defects(snr_db=60.0, offset=0.3, drift=0.05, jitter=0.1, lost=0.05)


def damped(modes: tuple[Truth, ...]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.array([mode.pole[1] for mode in modes]) / (2.0 * np.pi)


def test_slopes_inside_the_validity_are_right_to_one_percent() -> None:
    modes = (Truth(4.0, 0.01), Truth(13.0, 0.008, 0.8, 1.0))
    record = synthetic_decay(modes, 400.0, 8.0, DEFECTS, 1).record
    for one, truth in zip(evolving_spectra(record), modes, strict=True):
        assert one.reasons == ()
        assert one.damping_ratio == pytest.approx(truth.damping_ratio, rel=0.01)
        assert one.frequency == pytest.approx(truth.frequency, rel=2e-3)
        assert one.interval[0] < truth.damping_ratio < one.interval[1]


def test_window_of_the_book_is_refused_and_its_reading_wrong() -> None:
    errors = []
    for phase in np.arange(0.0, np.pi, np.pi / 4.0):
        modes = (Truth(7.62, 0.198, 1.0, phase), BOOK_LINK[1])
        record = synthetic_decay(modes, 1000.0, 1.0, Defects(snr_db=80.0), 1).record
        given = np.array([7.62, 47.7])
        for one in evolving_spectra(record, given, window=0.05, method='book'):
            assert np.isnan(one.damping_ratio)
            assert any('window must be at least 3/df' in reason for reason in one.reasons)
        first = evolving_spectra(record, given, window=0.05, method='book')[0]
        assert any('0.38 cycles' in reason for reason in first.reasons)
        errors.append(abs(first.reading / 0.198 - 1.0))
    # less than half a cycle in the window: what it reads hangs on the phase
    assert max(errors) > 0.05


def test_window_longer_than_the_decay_is_refused() -> None:
    record = synthetic_decay([Truth(10.0, 0.05)], 500.0, 3.0, DEFECTS, 2).record
    only = evolving_spectra(record, np.array([10.0]), window=1.5)[0]
    assert np.isnan(only.damping_ratio)
    assert any('at most 2 tau' in reason for reason in only.reasons)


def test_buried_mode_is_refused() -> None:
    modes = (Truth(5.0, 0.01), Truth(9.0, 0.01, 1e-3))
    record = synthetic_decay(modes, 400.0, 8.0, Defects(snr_db=40.0), 3).record
    weak = evolving_spectra(record, damped(modes))[1]
    assert np.isnan(weak.damping_ratio)
    assert any('times leakage and noise' in reason for reason in weak.reasons)


def test_waterfall_of_a_steady_cosine_reads_its_amplitude() -> None:
    t = np.arange(0.0, 10.0, 0.005)
    spectra = waterfall(Record(t, 1.0 + 3.0 * np.cos(2.0 * np.pi * 8.0 * t)), 1.0)
    peak = np.argmax(spectra.magnitude, axis=1)
    # zero padding puts a line on 8 Hz to a quarter of a bin: 1 % of a Hann window's height
    np.testing.assert_allclose(spectra.magnitude.max(axis=1), 3.0, rtol=0.02)
    np.testing.assert_allclose(spectra.frequency[peak], 8.0, atol=0.13)


def test_frequencies_that_are_none_are_refused() -> None:
    record = synthetic_decay([Truth(10.0, 0.05)], 500.0, 3.0).record
    with pytest.raises(dn.IdentificationError, match='need frequencies > 0 Hz'):
        evolving_spectra(record, np.array([-1.0]))
