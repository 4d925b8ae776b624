"""A window that is looked for holds one decay: it ends before the next excitation."""

from __future__ import annotations

import numpy as np
import pytest
from interrupted_decays import interrupted_decay
from strange_records import (
    clipped,
    coarse,
    free_decay,
    hardening,
    lossy,
    quadratic,
    two_modes,
    with_drift,
)

from denoc_ros.identification.decay.record_segments import decay_window
from denoc_ros.identification.decay.records import Record

WITHOUT = (free_decay, with_drift, coarse, clipped, two_modes, lossy, quadratic, hardening)
DRAWS = 240
ENDS_LATE, BEGINS_EARLY = 0.1, 0.5  # cycles: on this side of the excitation that is left out


@pytest.mark.long
def test_a_window_ends_before_the_next_excitation() -> None:
    """Steps up and down and blows, a fifth to five times what is left, until the last cycle.

    Before, 21 of the first 60 windows contained the second excitation.
    """
    held = []
    for seed in range(DRAWS):
        drawn = interrupted_decay(seed)
        cycle = 1.0 / drawn.frequency
        window, _ = decay_window(drawn.record)
        begins, ends = window.t[[0, -1]]
        is_before = ends < drawn.second + ENDS_LATE * cycle
        is_after = begins > drawn.second - BEGINS_EARLY * cycle
        if not (is_before or is_after):
            held.append((seed, begins, ends, drawn.second))
    assert not held


def test_a_window_before_an_excitation_is_hardly_shortened() -> None:
    for seed in range(DRAWS):
        drawn = interrupted_decay(seed)
        window, _ = decay_window(drawn.record)
        if window.t[0] < drawn.second - 4.0 / drawn.frequency:
            assert window.t[-1] > drawn.second - 2.0 / drawn.frequency, seed


@pytest.mark.long_cases('quadratic', 'hardening')
@pytest.mark.parametrize('kind', WITHOUT)
def test_a_decay_without_another_excitation_is_taken_whole(kind: object) -> None:
    assert callable(kind)
    for seed in range(12):
        made = kind(np.random.default_rng([seed, 77]))
        window, _ = decay_window(Record(made.t, made.y, made.shape))
        assert window.t[-1] == made.t[-1], seed
