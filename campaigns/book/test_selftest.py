"""The accuracy that is promised, on seeds drawn at run time."""

from __future__ import annotations

import numpy as np
import pytest
from book.selftest import CONDITIONS, jobs, measure, selftest, table

import denoc_ros as dn

# of failing where each estimate is exactly as good as promised: the limits are quantiles of the
# binomial distribution, five or six laws per row
CHANCE = 1e-6


@pytest.mark.long
def test_estimators_are_as_good_as_promised() -> None:
    seed = int(np.random.SeedSequence().generate_state(1)[0])
    # one record of each case under each condition
    chosen = [job for job in jobs(False, seed) if job[2][3] == 0]
    rows = table([measure(job) for job in chosen], CHANCE)
    assert len(rows) == len(CONDITIONS)
    for row in rows:
        assert row.passed, f'seed {seed}: {row}'


def test_seed_draws_the_same_records_again() -> None:
    job = jobs(False, 11)[5]
    assert measure(job).errors == measure(job).errors
    assert measure(job).errors != measure(jobs(False, 12)[5]).errors


def test_negative_seed_is_refused() -> None:
    with pytest.raises(dn.IdentificationError, match='seed must be >= 0, got -1'):
        selftest(seed=-1)
