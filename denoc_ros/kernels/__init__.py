"""Numba kernels of the recursion: arrays in, arrays out; they return a status and never raise.

The compiled code is cached in a folder named by the kernels' own source, so that an edit of one
file never meets stale code of another (numba looks at the file of the called function only).
`NUMBA_CACHE_DIR` moves the cache; a read-only home falls back to the temporary folder.

With `DENOC_CHECK_BOUNDS=1` every offset is compared with its array's length before an element is
read or written, and IndexError names the function that is out of bounds. That is slow, has a
separate cache, and is for tests.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from pathlib import Path

import numba
from llvmlite.binding import get_host_cpu_name

# what these say changes no compiled code
WITHOUT_KERNELS = ('__init__.py', 'cache.py', 'compiling.py')

CHECKED = os.environ.get('DENOC_CHECK_BOUNDS', '0') not in ('', '0')
if CHECKED:
    # optimizing all the checks takes minutes; by the environment it would reset CACHE_DIR as well
    numba.config.OPT = type(numba.config.OPT)(0)


def _digest() -> str:
    """Return a digest of the kernels' source, of compiler, interpreter and processor."""
    key = numba.__version__, sys.implementation.cache_tag, get_host_cpu_name()
    digest = hashlib.sha256(repr(key).encode())
    for path in sorted(Path(__file__).parent.glob('*.py')):
        if path.name not in WITHOUT_KERNELS:
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _writable(folder: Path) -> bool:
    """Say whether files can be made in a folder, making it if need be."""
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _is_ours(folder: Path) -> bool:
    """Say whether nobody else can have put compiled code into a folder."""
    return not hasattr(os, 'getuid') or folder.stat().st_uid == os.getuid()


def cache_folder() -> Path:
    """Return the folder that holds the compiled kernels of this very source.

    A folder that `NUMBA_CACHE_DIR` names is trusted. Any other must belong to the user, since the
    code in it is run.
    """
    named = os.environ.get('NUMBA_CACHE_DIR')
    home = os.environ.get('XDG_CACHE_HOME') or str(Path.home() / '.cache')
    user = f'denoc_ros-{os.getuid()}' if hasattr(os, 'getuid') else 'denoc_ros'
    candidates = [Path(named)] if named else []
    candidates += [Path(home) / 'denoc_ros', Path(tempfile.gettempdir()) / user]
    for candidate in candidates:
        folder = candidate / f'{"checked" if CHECKED else "kernels"}-{_digest()}'
        if _writable(folder) and (str(candidate) == named or _is_ours(candidate)):
            return folder
    return candidates[-1]


numba.config.CACHE_DIR = str(cache_folder())
