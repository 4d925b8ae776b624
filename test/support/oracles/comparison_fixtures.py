"""Comparisons that the law tests share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from denoc_ros.dynamics import state_rows as batch
from denoc_ros.types import Array

Close = Callable[[Array, Array, float], None]


@pytest.fixture(scope='session')
def close() -> Close:
    """Equality relative to the largest number of the expected array."""

    def check(value: Array, expected: Array, relative: float) -> None:
        value, expected = np.asarray(value), np.asarray(expected)
        assert value.shape == expected.shape
        scale = max(float(np.abs(expected).max(initial=0.0)), 1e-9)
        np.testing.assert_allclose(value, expected, rtol=0, atol=relative * scale)

    return check


@pytest.fixture
def two_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Share rows out over two threads where it does not pay yet."""
    monkeypatch.setattr(batch, 'cores', lambda: 2)
    monkeypatch.setattr(batch, 'LEAST_PER_THREAD', 64)
