"""SI prefixes and units, for numbers that people read."""

from __future__ import annotations

import math

NONE = (1.0, '')
PREFIXES = ((1e6, 'M'), (1e3, 'k'), NONE, (1e-3, 'm'), (1e-6, 'µ'), (1e-9, 'n'))


def si_prefix(size: float, smallest: float = 1e-9) -> tuple[float, str]:
    """Return the prefix, factor and letter, that brings a size close above 1; none for 0.

    Parameters
    ----------
    size : float
        >= 0.
    smallest : float
        Factor of the smallest prefix, which smaller sizes have too.
    """
    if size == 0.0:
        return NONE
    allowed = [entry for entry in PREFIXES if entry[0] >= smallest]
    return next((entry for entry in allowed if size >= entry[0]), allowed[-1])


def deflection_unit(name: str) -> str:
    """Return the unit of a tip's component, `link/ux` … `link/rz`: m, or rad of a turn."""
    return 'rad' if name.rpartition('/')[2].startswith('r') else 'm'


def round_up(size: float) -> float:
    """Return the next of 1, 2, 5, 10, … times a power of ten."""
    power = 10.0 ** math.floor(math.log10(size))
    return next(
        step * power for step in (1.0, 2.0, 5.0, 10.0) if size <= step * power * (1 + 1e-9)
    )
