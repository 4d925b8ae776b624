"""Numba kernels of the recursion: arrays in, arrays out; they return a status and never raise.

The compiled code is cached in a folder named by the kernels' own source, so that an edit of one
file never meets stale code of another (numba looks at the file of the called function only).
`NUMBA_CACHE_DIR` moves the cache; a read-only home falls back to the temporary folder.

With `DENOC_CHECK_BOUNDS=1` every offset is compared with its array's length before an element is
read or written, and IndexError names the function that is out of bounds. That is slow, has a
separate cache, and is for tests.
"""

from __future__ import annotations

import os

import numba

CHECKED = os.environ.get('DENOC_CHECK_BOUNDS', '0') not in ('', '0')
if CHECKED:
    # optimizing all the checks takes minutes
    numba.config.OPT = type(numba.config.OPT)(0)
