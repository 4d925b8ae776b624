"""An input topic: why a message is refused, how many were, and who publishes."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

MOST_JOINTS = 256  # in one message: names are read one by one
LONGEST_TEXT = 500  # characters of a refusal: what came may be megabytes
SILENCE = 2.0  # s without a message after which a publisher counts as silent
MOST_MISSED = 1_000_000  # messages at most between two that came: else it is another publisher
LOST = 100  # messages at most that one publisher may have sent and that did not come


class InputError(Exception):
    """An input message is refused; `cause` is the word it is counted under."""

    def __init__(self, cause: str, message: str) -> None:
        self.cause = cause
        short = len(message) <= LONGEST_TEXT
        super().__init__(message if short else message[: LONGEST_TEXT - 1] + '…')


class ActivePublishers:
    """Tells from the numbers of messages how many publishers send them.

    A publisher stays in the graph when its process is killed, until its lease ends; another may
    be there and say nothing. Messages do not say whose they are, but each publisher numbers its
    own from 1 on: a number that does not go on from the last one is another's.

    Parameters
    ----------
    allowed : int
        Publishers that may send at once; the numbers matter while there are more.

    Notes
    -----
    Publishers whose messages name other joints, as those of an arm and of its gripper, do not
    count against each other.
    """

    def __init__(self, allowed: int) -> None:
        self._allowed = allowed
        # number, time and joints of each publisher's last message; None: its joints are not known
        self._last: list[tuple[int, float, frozenset[str] | None]] = []

    def begin(self, now: float) -> None:
        """Assume that as many publishers as allowed sent up to steady `now` [s]."""
        self._last = [(-LOST - 1, now, None)] * self._allowed

    def saw(self, number: int | None, now: float) -> None:
        """Take the number of a message that came while all publishers were allowed to send."""
        if number is not None:
            self._last = [(number, now, None)]

    def count(
        self,
        publishers: int,
        numbers: Sequence[int | None],
        now: float,
        joints: Sequence[frozenset[str]] = (),
    ) -> list[int]:
        """Take the numbers of new messages; return for each how many publishers send its joints.

        Parameters
        ----------
        numbers : sequence of int or None
            Of the messages, in their order; None where the middleware does not number them: then
            all publishers count as sending.
        now : float
            s on the steady clock.
        joints : sequence of set of str, optional
            That each message names; default: all messages are of the same.
        """
        named = joints or [frozenset({''})] * len(numbers)
        known = [number for number in numbers if number is not None]
        if publishers <= self._allowed:
            self._last = [(known[-1], now, None)] if known else self._last
            return [publishers] * len(numbers)
        if len(known) < len(numbers):
            return [publishers] * len(numbers)
        self._last = [each for each in self._last if now - each[1] < SILENCE]
        for number, own in zip(known, named, strict=True):
            self._attribute(number, now, own)
        return [
            sum(other is None or not own.isdisjoint(other) for _, _, other in self._last)
            for own in named
        ]

    def _attribute(self, number: int, now: float, joints: frozenset[str]) -> None:
        """Attribute a message to the publisher whose numbers it continues, else to a new one."""
        before = [
            each
            for each in self._last
            if 0 < number - each[0] <= LOST and each[2] in (None, joints)
        ]
        if before:
            self._last.remove(max(before, key=lambda each: each[0]))
        self._last.append((number, now, joints))


class Gaps:
    """Counts the messages of a topic's only publisher that were sent and did not come.

    Messages do not say whose they are: of several publishers a number that jumps may be another's,
    so nothing is counted then.

    Parameters
    ----------
    last : int, optional
        Number of the last message that is not missed: 0 where all of a publisher's are meant for
        here. Default: the first that comes.
    """

    def __init__(self, last: int | None = None) -> None:
        self._last = last

    def missed(self, number: int | None, publishers: int) -> int:
        """Take a message's number and how many publishers there are; return how many are missing.

        A publisher's first number misses nothing: what was sent before was not meant for here.
        """
        if number is None:
            return 0
        before, self._last = self._last, number if publishers == 1 else None
        if before is None or self._last is None or not 0 < number - before <= MOST_MISSED:
            return 0
        return number - before - 1


class InputMonitor:
    """Counter of one input topic's messages, with the age of its last good one.

    Attributes
    ----------
    rejected_reported : int
        How many of them /diagnostics has warned of.
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
        self._last_time = self._time_before = -math.inf
        self._offset = math.inf  # s from the stamp of the fastest message to its arrival
        self._before_jump = 0  # stamp before one that is ahead of all others; 0: none [ns]
        self._lead = 0.0  # s by which that one is ahead

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
            what was true then (stamp 0 is none). A single stamp from the future does not count:
            the next message may be older than that.
        """
        last = self._last_stamp
        if stamp_ns is None:
            stamp_ns = last
        else:
            offset = now - 1e-9 * stamp_ns
            if last is not None and stamp_ns <= last:
                self._require_new(stamp_ns, last, offset)
            if stamp_ns:
                self._compare(offset)
        self._last_stamp = stamp_ns
        self._time_before, self._last_time = self._last_time, now
        self.accepted += 1

    def revise(self, passed: int) -> None:
        """Count the messages that a gate lets pass with the last one: none, it or more."""
        self.accepted += passed - 1
        if not passed:
            self._last_time = self._time_before

    def _require_new(self, stamp_ns: int, last: int, offset: float) -> None:
        """Refuse a stamp that is not later than the last one; 0 may come again."""
        if stamp_ns < last:
            # Of two stamps that contradict each other, the one that continues those before is
            # right. A message that another one overtook is late by more than that one was ahead.
            if stamp_ns > self._before_jump > 0 and offset - self._offset < self._lead:
                return
            raise InputError(
                'backwards_stamp',
                f'{self.topic} stamp must not go back, got {stamp_ns} ns after {last} ns; '
                'a reset forgets the last one',
            )
        if stamp_ns:
            raise InputError('duplicate', f'{self.topic} stamp must be new, got {last} ns again')

    def _compare(self, offset: float) -> None:
        """Note whether a stamp is ahead of all others; of two in a row the clock was set.

        `offset` is by how much the moment of arrival is ahead of the stamp [s].
        """
        lead = self._offset - offset
        jumps = 0.0 < lead < math.inf and not self._before_jump
        self._before_jump, self._lead = (self._last_stamp or 0, lead) if jumps else (0, 0.0)
        if not jumps:
            self._offset = min(offset, self._offset)

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

    def reset(self) -> None:
        """Forget the last stamp and its time (not the counts)."""
        self._last_stamp = None
        self._last_time = self._time_before = -math.inf
        self._offset = math.inf
        self._before_jump, self._lead = 0, 0.0
