"""Rings of a real arm with two flexible links: known frequency, damping grows with amplitude."""

from __future__ import annotations

import numpy as np
import pytest
from data_files import rig_run
from scipy.io import loadmat

from denoc_ros.identification.decay.modes import Modes
from denoc_ros.identification.decay.modes_fit import fit_modes
from denoc_ros.identification.decay.records import Record

RUNS = (
    '0deg_run01',
    '0deg_run02',
    '5deg_run01',
    '10deg_run01',
    '20deg_run01',
    '30deg_run01',
    'neg_5deg_run01',
    'neg_10deg_run01',
    'neg_20deg_run01',
    'neg_30deg_run01',
)


def ring(run: str) -> Modes:
    raw = loadmat(rig_run(run))
    tip = raw['X1_meas'][:, 1].astype(float)
    return fit_modes(Record(raw['time'].ravel(), tip).part(2.2, 4.0))


@pytest.mark.parametrize('run', RUNS)
def test_ring_is_one_mode_of_known_frequency(run: str) -> None:
    modes = ring(run)
    main = int(np.argmax(modes.amplitude))
    assert 1.785 < modes.frequency[main] < 1.855
    assert 0.002 < modes.damping_ratio[main] < 0.05
    # nothing else is as much as a tenth of it, and nothing else is called good
    others = np.delete(modes.amplitude, main)
    assert np.all(others < 0.1 * modes.amplitude[main])
    assert all(word != 'good' for k, word in enumerate(modes.verdict) if k != main)
    # amplitude dependence is told of all but one
    told = any('amplitude' in reason for reason in modes.reasons[main])
    assert told == (run != '20deg_run01')


def test_damping_grows_with_amplitude_within_and_across_rings() -> None:
    small, large = ring('30deg_run01'), ring('neg_30deg_run01')
    a, b = int(np.argmax(small.amplitude)), int(np.argmax(large.amplitude))
    assert large.amplitude[b] > 4.0 * small.amplitude[a]
    assert large.damping_ratio[b] > 4.0 * small.damping_ratio[a]
    assert large.verdict[b] == 'doubtful'
    assert any('grows with amplitude' in reason for reason in large.reasons[b])
