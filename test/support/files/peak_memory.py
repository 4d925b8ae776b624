"""Memory of this process and of its children."""

from __future__ import annotations

import resource


def peak_memory() -> int:
    """Return the largest memory of this process and of those that it has started [KiB]."""
    return max(
        resource.getrusage(who).ru_maxrss
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
