"""Derivatives by central differences of fourth order."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from denoc_ros.types import Array

STEP = 1e-3  # rounding and truncation meet near 1e-11


def central_differences(function: Callable[[Array], Array], x: Array) -> Array:
    """Return the derivative (m, len(x)) of a vector function."""
    columns = []
    for step in STEP * np.eye(len(x)):
        near = function(x + step) - function(x - step)
        far = function(x + 2.0 * step) - function(x - 2.0 * step)
        columns.append((8.0 * near - far) / (12.0 * STEP))
    return np.column_stack(columns)
