"""Large pieces of memory go back to the system as soon as they are freed.

glibc maps large pieces of memory one by one, but raises the size from which it does so with each
such piece that is freed, up to 32 MB. Later pieces come from the heap, among small ones that live
long: a process keeps the memory of large messages, and more of it with each burst.
"""

from __future__ import annotations

import ctypes
import os

LARGE = 262_144  # bytes: far more than a tick allocates
MMAP_THRESHOLD = -3  # as <malloc.h> has it
CHOSEN = 'MALLOC_MMAP_THRESHOLD_'  # glibc's environment variable for the same


def return_large_pieces() -> bool:
    """Have the C library map pieces of 256 KiB and more on their own; say whether it will.

    It does not where the user has set a size, and where it is not glibc.
    """
    adjust = getattr(ctypes.CDLL(None), 'mallopt', None)
    if adjust is None or CHOSEN in os.environ:
        return False
    return bool(adjust(MMAP_THRESHOLD, LARGE))
