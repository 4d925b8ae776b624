"""Columns of MATLAB's files, for a process of its own: a header may declare any size.

Read by `denoc_ros.child_reader`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.io import loadmat


def read(file: str) -> dict[str, Any]:
    """Return the columns of numbers by name."""
    columns: dict[str, Any] = {}
    for name, value in loadmat(file, simplify_cells=True).items():
        if not name.startswith('__'):
            columns |= _columns(name, value)
    return columns


def _columns(name: str, value: Any) -> dict[str, Any]:
    """Return a variable's columns: a vector's, a matrix's, or those of a struct's fields."""
    if isinstance(value, dict):
        found: dict[str, Any] = {}
        for field, inner in value.items():
            found |= _columns(f'{name}.{field}', inner)
        return found
    if isinstance(value, list) and value and all(isinstance(entry, dict) for entry in value):
        return {
            f'{name}.{field}': np.array([entry[field] for entry in value], dtype=np.float64)
            for field in value[0]
            if all(isinstance(entry.get(field), (int, float)) for entry in value)
        }
    array = np.atleast_1d(np.asarray(value))
    if array.dtype.kind not in 'fiub' or array.ndim > 2 or array.size == 0:
        return {}
    if array.ndim == 1 or 1 in array.shape:
        return {name: array.ravel().astype(np.float64)}
    # signals are longer than there are of them
    longer = array.T if array.shape[0] < array.shape[1] else array
    return {f'{name}[{k}]': column.astype(np.float64) for k, column in enumerate(longer.T)}
