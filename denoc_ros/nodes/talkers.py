"""Who talks on a topic, of those who could; nothing here needs ROS."""

from __future__ import annotations

from collections.abc import Sequence

SILENCE = 2.0  # s without a message after which a publisher counts as silent
MOST_PUBLISHERS = 16  # of a topic that gaps are told apart for
MOST_MISSED = 1_000_000  # messages at most between two that came: else it is another publisher
LOST = 100  # messages at most that one publisher may have sent and that did not come


class Talkers:
    """Tells from the numbers of messages how many publishers send them.

    A publisher stays in the graph when its process is killed, until its lease ends; another may
    be there and say nothing. Messages do not say whose they are, but each publisher numbers its
    own from 1 on: a number that does not go on from the last one is another's.

    Parameters
    ----------
    allowed : int
        Publishers that may talk at once; the numbers matter while there are more.
    """

    def __init__(self, allowed: int) -> None:
        self._allowed = allowed
        self._last: list[tuple[int, float]] = []  # number and time of each talker's last message

    def begin(self, now: float) -> None:
        """Take it that as many talked as may, up to steady `now` [s], nobody knows who."""
        self._last = [(-LOST - 1, now)] * self._allowed

    def count(self, publishers: int, numbers: Sequence[int | None], now: float) -> int:
        """Take the numbers of new messages; return how many talk.

        Parameters
        ----------
        publishers : int
            How many there are.
        numbers : sequence of int or None
            Of the messages, in their order; None where the middleware does not number them: then
            all publishers count as talking.
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
        """Take a message for that of the talker whose number it goes on from, else a new one."""
        before = [each for each in self._last if 0 < number - each[0] <= LOST]
        if before:
            self._last.remove(max(before))
        self._last.append((number, now))


class Gaps:
    """Counts the messages of a topic that were sent and did not come, by their numbers.

    A number goes on from the nearest one below it. One that goes on from none is that of a
    publisher not heard before: what that had sent till then was not meant for here.
    """

    def __init__(self) -> None:
        self._last: list[int] = []

    def missed(self, number: int | None) -> int:
        """Take a message's number; return how many of its publisher are missing before it."""
        if number is None:
            return 0
        before = max((last for last in self._last if last < number), default=None)
        if before is None or number - before > MOST_MISSED:
            self._last = [*self._last[1 - MOST_PUBLISHERS :], number]
            return 0
        self._last.remove(before)
        self._last.append(number)
        return number - before - 1
