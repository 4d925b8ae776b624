"""SI prefixes bring numbers close above 1."""

from __future__ import annotations

import pytest

from denoc_ros.units import si_prefix


@pytest.mark.parametrize(
    ('size', 'smallest', 'prefix'),
    [
        (0.0, 1e-9, (1.0, '')),
        (999.0, 1e-9, (1.0, '')),
        (1000.0, 1e-9, (1e3, 'k')),
        (2e-7, 1e-9, (1e-9, 'n')),
        (2e-7, 1e-6, (1e-6, 'µ')),
        (1e-12, 1e-9, (1e-9, 'n')),
        (5e9, 1e-9, (1e6, 'M')),
    ],
)
def test_the_largest_prefix_not_above_a_size_is_taken(
    size: float, smallest: float, prefix: tuple[float, str]
) -> None:
    assert si_prefix(size, smallest) == prefix
