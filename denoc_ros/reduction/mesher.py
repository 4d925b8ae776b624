"""fTetWild as a process of its own: it writes files where it runs, and ends it on bad surfaces.

`python mesher.py SURFACE.npz TETRAHEDRA.npz`: vertices, faces, edge [m] and envelope (of the
diagonal) in, corners and tetrahedra out.
"""

from __future__ import annotations

import sys

import numpy as np
import pytetwild


def main() -> None:
    """Fill the surface of the first file with tetrahedra, into the second."""
    with np.load(sys.argv[1], allow_pickle=False) as surface:
        corners, tetrahedra = pytetwild.tetrahedralize(
            surface['vertices'],
            surface['faces'],
            edge_length_abs=float(surface['edge']),
            epsilon=float(surface['envelope']),
            num_threads=1,  # the same mesh each time
            quiet=True,
        )
    np.savez(sys.argv[2], corners=corners, tetrahedra=tetrahedra)


if __name__ == '__main__':
    main()
