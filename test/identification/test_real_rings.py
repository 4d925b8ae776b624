"""Rings of a real arm with two flexible links: known frequency, damping grows with amplitude."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

from denoc_ros.identification.fit import fit_modes
from denoc_ros.identification.modes import Modes
from denoc_ros.identification.records import Record


def ring(shared: Path, run: str) -> Modes:
    raw = loadmat(shared / f'data/two_flexible_links/lqg_step_{run}_run01.mat')
    tip = raw['X1_meas'][:, 1].astype(float)
    return fit_modes(Record(raw['time'].ravel(), tip).part(2.2, 4.0))


@pytest.mark.parametrize('run', ['10deg', '30deg', 'neg_20deg', 'neg_30deg'])
def test_ring_is_one_mode_of_known_frequency(shared: Path, run: str) -> None:
    modes = ring(shared, run)
    main = int(np.argmax(modes.amplitude))
    assert 1.785 < modes.frequency[main] < 1.855
    assert 0.002 < modes.damping_ratio[main] < 0.05
    # nothing else is as much as a tenth of it, and nothing else is called good
    others = np.delete(modes.amplitude, main)
    assert np.all(others < 0.1 * modes.amplitude[main])
    assert all(word != 'good' for k, word in enumerate(modes.verdict) if k != main)


def test_damping_grows_with_amplitude_within_and_across_rings(shared: Path) -> None:
    small, large = ring(shared, '30deg'), ring(shared, 'neg_30deg')
    a, b = int(np.argmax(small.amplitude)), int(np.argmax(large.amplitude))
    assert large.amplitude[b] > 4.0 * small.amplitude[a]
    assert large.damping_ratio[b] > 4.0 * small.damping_ratio[a]
    assert large.verdict[b] == 'doubtful'
    assert any('grows with amplitude' in reason for reason in large.reasons[b])
