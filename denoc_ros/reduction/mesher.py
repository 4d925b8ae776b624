"""fTetWild, for a process of its own: it writes files where it runs, and ends it on bad surfaces.

Read by `denoc_ros.child_reader`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytetwild


def read(file: str) -> dict[str, Any]:
    """Fill a surface with tetrahedra.

    Parameters
    ----------
    file : str
        `.npz` of vertices, faces, edge [m] and envelope (of the diagonal).
    """
    with np.load(file, allow_pickle=False) as surface:
        corners, tetrahedra = pytetwild.tetrahedralize(
            surface['vertices'],
            surface['faces'],
            edge_length_abs=float(surface['edge']),
            epsilon=float(surface['envelope']),
            num_threads=1,  # the same mesh each time
            quiet=True,
        )
    return {'corners': corners, 'tetrahedra': tetrahedra}
