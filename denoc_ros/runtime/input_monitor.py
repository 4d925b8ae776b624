"""Messages of one input topic: how many were taken or refused, and how old the last one is.

Times are seconds of the robot's clock; stamps are nanoseconds of the messages' own clock and only
ever compared with each other.
"""

from __future__ import annotations

import math
from collections import Counter

from denoc_ros.runtime.input_error import InputError


class InputMonitor:
    """Counter of one input topic's messages, with the age of its last good one.

    Attributes
    ----------
    accepted : int
        Messages taken.
    rejected : Counter
        Messages refused, by cause.
    rejected_reported : int
        How many of them /diagnostics has warned of.
    last_message : str
        Why the last one was refused.
    max_publishers : int
        Publishers that may send at once.
    """

    def __init__(self, topic: str, max_publishers: int = 1) -> None:
        self.topic = topic
        self.accepted = 0
        self.rejected_reported = 0
        self.rejected: Counter[str] = Counter()
        self.last_message = ''
        self.max_publishers = max_publishers
        self._last_stamp: int | None = None
        self._last_time = -math.inf

    def check_publishers(self, count: int) -> None:
        """Refuse all messages while too many publishers are active: the right one is unknown."""
        if count > self.max_publishers:
            raise InputError(
                'second_publisher',
                f'{self.topic} must have at most {self.max_publishers} publishers, got {count}',
            )

    def accept(self, stamp_ns: int | None, now: float) -> None:
        """Take a message; a stamp of None means now and is not compared.

        Raises
        ------
        InputError
            Cause `backwards_stamp`: it is older than the one before; `duplicate`: it says again
            what was true then (stamp 0 is none).
        """
        last = self._last_stamp
        if last is not None and stamp_ns is not None and stamp_ns < last:
            raise InputError(
                'backwards_stamp',
                f'{self.topic} stamp must not go back, got {stamp_ns} ns after {last} ns; '
                'a reset forgets the last one',
            )
        if stamp_ns and stamp_ns == last:
            raise InputError('duplicate', f'{self.topic} stamp must be new, got {last} ns again')
        self._last_stamp = last if stamp_ns is None else stamp_ns
        self._last_time = now
        self.accepted += 1

    def reject(self, error: InputError) -> bool:
        """Count a refused message; say whether it is the first of its cause."""
        self.rejected[error.cause] += 1
        self.last_message = str(error)
        return self.rejected[error.cause] == 1

    def age(self, now: float) -> float:
        """Return the time since the last good message [s]; infinite before the first."""
        return now - self._last_time

    @property
    def received(self) -> bool:
        """Whether a good message has come since the start or the last reset."""
        return self._last_time > -math.inf

    def forget_stamp(self) -> None:
        """Take the next stamp as it is: the clock that stamps has been set back."""
        self._last_stamp = None

    def reset(self) -> None:
        """Forget the last stamp and its time (not the counts)."""
        self._last_stamp = None
        self._last_time = -math.inf
