"""Ansys' files by ansys-mapdl-reader, as a process of its own: a torn file ends it by a signal.

`python ansys_reader.py FILE ARRAYS.npz`: nodes of an `.rst`, or rows and entries of a `.full`.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sparse
from ansys.mapdl import reader


def main() -> None:
    """Write the numbers of the first file into the second."""
    warnings.simplefilter('ignore')
    opened = reader.read_binary(sys.argv[1])
    if Path(sys.argv[1]).suffix.lower() == '.rst':
        numbers = np.asarray(opened.mesh.nnum, dtype=np.int64)
        places = np.asarray(opened.mesh.nodes, dtype=np.float64)[:, :3]
        np.savez(sys.argv[2], numbers=numbers, places=places)
        return
    rows, *matrices = opened.load_km()
    found: dict[str, Any] = {'rows': np.asarray(rows, dtype=np.int64)}
    found['constrained'] = len(opened.const)
    for name, matrix in zip(('stiffness', 'mass'), matrices, strict=True):
        if matrix is not None:
            upper = sparse.triu(matrix).tocoo()
            entries = {'row': upper.row, 'column': upper.col, 'value': upper.data}
            found |= {f'{name}/{key}': values for key, values in entries.items()}
    np.savez(sys.argv[2], **found)


if __name__ == '__main__':
    main()
