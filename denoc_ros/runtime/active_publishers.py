"""The number of active publishers of a topic."""

from __future__ import annotations

from collections.abc import Sequence

SILENCE = 2.0  # s without a message after which a publisher counts as silent
MOST_MISSED = 1_000_000  # messages at most between two that came: else it is another publisher
LOST = 100  # messages at most that one publisher may have sent and that did not come


class ActivePublishers:
    """Tells from the numbers of messages how many publishers send them.

    A publisher stays in the graph when its process is killed, until its lease ends; another may
    be there and say nothing. Messages do not say whose they are, but each publisher numbers its
    own from 1 on: a number that does not go on from the last one is another's.

    Parameters
    ----------
    allowed : int
        Publishers that may send at once; the numbers matter while there are more.
    """

    def __init__(self, allowed: int) -> None:
        self._allowed = allowed
        self._last: list[
            tuple[int, float]
        ] = []  # number and time of each publisher's last message

    def begin(self, now: float) -> None:
        """Assume that as many publishers as allowed sent up to steady `now` [s]."""
        self._last = [(-LOST - 1, now)] * self._allowed

    def saw(self, number: int | None, now: float) -> None:
        """Take the number of a message that came while all publishers were allowed to send."""
        if number is not None:
            self._last = [(number, now)]

    def count(self, publishers: int, numbers: Sequence[int | None], now: float) -> int:
        """Take the numbers of new messages; return how many publishers send.

        Parameters
        ----------
        publishers : int
            How many there are.
        numbers : sequence of int or None
            Of the messages, in their order; None where the middleware does not number them: then
            all publishers count as sending.
        now : float
            s on the steady clock.
        """
        known = [number for number in numbers if number is not None]
        if publishers <= self._allowed:
            self._last = [(known[-1], now)] if known else self._last
            return publishers
        if len(known) < len(numbers):
            return publishers
        self._last = [each for each in self._last if now - each[1] < SILENCE]
        for number in known:
            self._attribute(number, now)
        return len(self._last)

    def _attribute(self, number: int, now: float) -> None:
        """Attribute a message to the publisher whose numbers it continues, else to a new one."""
        before = [each for each in self._last if 0 < number - each[0] <= LOST]
        if before:
            self._last.remove(max(before))
        self._last.append((number, now))


class Gaps:
    """Counts the messages of a topic's only publisher that were sent and did not come.

    Messages do not say whose they are: of several publishers a number that jumps may be another's,
    so nothing is counted then.
    """

    def __init__(self) -> None:
        self._last: int | None = None

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
