"""Ansys' files by ansys-mapdl-reader, for a process of its own: a torn file ends it by a signal.

Read by `denoc_ros.child_reader`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sparse
from ansys.mapdl import reader


def read(file: str) -> dict[str, Any]:
    """Return nodes of an `.rst`, or rows and entries of a `.full`."""
    opened = reader.read_binary(file)
    if Path(file).suffix.lower() == '.rst':
        numbers = np.asarray(opened.mesh.nnum, dtype=np.int64)
        return {
            'numbers': numbers,
            'places': np.asarray(opened.mesh.nodes, dtype=np.float64)[:, :3],
        }
    rows, *matrices = opened.load_km()
    found: dict[str, Any] = {'rows': np.asarray(rows, dtype=np.int64)}
    found['constrained'] = len(opened.const)
    for name, matrix in zip(('stiffness', 'mass'), matrices, strict=True):
        if matrix is not None:
            upper = sparse.triu(matrix).tocoo()
            entries = {'row': upper.row, 'column': upper.col, 'value': upper.data}
            found |= {f'{name}/{key}': values for key, values in entries.items()}
    return found
