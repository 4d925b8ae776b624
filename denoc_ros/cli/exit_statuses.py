"""Exit statuses of `denoc`."""

from __future__ import annotations

BAD_INPUT = 1
DOUBTFUL = 2
NOT_IDENTIFIABLE = 3
INTERRUPTED = 130  # 128 + SIGINT, as shells report it

VERDICTS = {'good': 0, 'doubtful': DOUBTFUL, 'not identifiable': NOT_IDENTIFIABLE}


def exit_status(verdict: str) -> int:
    """Return the exit status of a verdict: good, doubtful or not identifiable."""
    return VERDICTS[verdict]
