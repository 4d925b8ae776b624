"""Deviations of the frequency: honest over repeats, and wide where the frequency drifts."""

from __future__ import annotations

import numpy as np
import pytest
from book.selftest import Defects, Truth, synthetic_decay
from scipy.integrate import solve_ivp
from scipy.stats import binom

from denoc_ros.identification.decay.modes_fit import fit_modes
from denoc_ros.identification.decay.records import Record

CHANCE = 1e-5  # that estimators which are as honest as promised fail


@pytest.mark.long
def test_deviation_covers_the_truth_over_repeats() -> None:
    seed = int(np.random.SeedSequence().generate_state(1)[0])
    away = []
    for k in range(40):
        defects = Defects(snr_db=40.0, jitter=0.1, lost=0.05)
        truth = Truth(3.0, 0.02, 1.0, 0.1 * k)
        record = synthetic_decay([truth], 60.0, 5.0, defects, np.random.default_rng((seed, k)))
        modes = fit_modes(record.record)
        away.append((modes.frequency[0] - 3.0) / modes.frequency_deviation[0])
    outside = int(np.sum(np.abs(away) > 1.96))
    assert outside <= binom.isf(CHANCE, 40, 0.08), f'seed {seed}: {outside} of 40'
    # and it is no wider than it must be
    assert np.std(away) > 0.6, f'seed {seed}'


def test_frequency_that_drifts_has_a_deviation_of_what_it_ranges_over() -> None:
    rate = 2.0 * np.pi * 2.0
    t = np.arange(0.0, 20.0, 0.01)

    def slope(_: float, state: list[float]) -> list[float]:
        stiffening = 1.0 + 0.1 * state[0] ** 2
        return [state[1], -(rate**2) * stiffening * state[0] - 0.02 * rate * state[1]]

    y = solve_ivp(slope, (0.0, 20.0), [1.0, 0.0], t_eval=t, rtol=1e-7, atol=1e-9).y[0]
    record = Record(t, y + 0.003 * np.random.default_rng(2).standard_normal(t.size))
    whole = fit_modes(record)
    parts = [fit_modes(record.part(a, a + 4.0)) for a in (0.0, 4.0, 8.0)]
    main = [one.frequency[int(np.argmax(one.energy))] for one in (whole, *parts)]
    spread = float(np.std(main[1:], ddof=1))
    assert main[0] == pytest.approx(2.0, rel=0.05)
    deviation = float(whole.frequency_deviation[int(np.argmax(whole.energy))])
    # repeats with other windows differ by the spread: the deviation is of its size
    assert spread / 3.0 < deviation < 3.0 * spread
