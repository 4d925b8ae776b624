"""A bag written by a separate thread: the producer never waits for the disk."""

from __future__ import annotations

import shutil
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from denoc_ros.bags.definitions import message_definition
from denoc_ros.bags.metadata import Qos, topic_counts
from denoc_ros.bags.storage import Loss
from denoc_ros.bags.writer import BagWriter
from denoc_ros.errors import BagError

_ROUNDS_PER_FLUSH = 10
CHECK_PERIOD = 0.25  # s between looks whether what was written is still there
QUEUE_BYTES = 256 << 20
MESSAGE_OVERHEAD = 200  # bytes that a message in the queue takes beyond its own
# topic, stamp [ns], bytes, publish time [ns]
Waiting = tuple[str, int, bytes, int | None]
# why a message is lost
BY_NUMBER = 'queue_size'
BY_BYTES = 'queue_bytes'
BY_DISK = 'disk'
BY_FILE = 'file'


@dataclass(frozen=True)
class WriterStatus:
    """Status of a background writer."""

    written: int  # messages handed to the bag
    queued: int  # messages that wait
    lost: dict[str, int]  # messages that never reach the bag, by topic
    # time since the writing thread last came round [s]; far over the flush period when the disk
    # stalls
    stalled: float
    failure: str  # why recording ended by itself; empty while it goes on
    queued_bytes: int = 0  # memory that the waiting messages take
    # the lost messages by cause: `queue_size`, `queue_bytes` (the queue was full), `disk` (it
    # refused), `file` (what was written is no longer there)
    causes: dict[str, int] = field(default_factory=dict)
    losses: tuple[Loss, ...] = ()  # the files that are no longer there


def free_space(path: Path) -> int:
    """Return the bytes that the file system of a path still takes."""
    return shutil.disk_usage(path).free


class BackgroundWriter:
    """Takes messages from one producer thread and writes them in another.

    Parameters
    ----------
    bag : BagWriter
        An open bag; from here on it belongs to this object.
    queue_size : int
        Most messages that may wait; more are lost, and counted by topic.
    flush_period : float
        Everything taken is flushed at most this much later [s], unless the disk stalls.
    min_free_space : int
        The bag is closed, whole, before the disk has less than this left [bytes].
    queue_bytes : int
        Most memory that the waiting messages may take; more are lost, and counted by topic.
    """

    def __init__(
        self,
        bag: BagWriter,
        queue_size: int = 20_000,
        flush_period: float = 0.2,
        min_free_space: int = 64 << 20,
        free_space: Callable[[Path], int] = free_space,
        queue_bytes: int = QUEUE_BYTES,
    ) -> None:
        if not (
            min(queue_size, queue_bytes) > 0
            and 0 < flush_period < float('inf')
            and min_free_space >= 0
        ):
            bag.close()
            raise BagError(
                f'{bag.path}: queue_size, queue_bytes and flush_period must be > 0, '
                f'min_free_space >= 0, '
                f'got {queue_size}, {queue_bytes}, {flush_period}, {min_free_space}'
            )
        self._bag = bag
        self._queue_size = queue_size
        self._queue_bytes = queue_bytes
        self._round = min(flush_period / _ROUNDS_PER_FLUSH, CHECK_PERIOD)
        self._flush_period = flush_period
        self._min_free_space = min_free_space
        self._free_space = free_space
        # append and popleft of a deque are atomic: no lock that the producer could wait for
        self._queue: deque[Waiting | Callable[[], None]] = deque()
        self._offered: Counter[str] = Counter()
        self._lost = {cause: Counter[str]() for cause in (BY_NUMBER, BY_BYTES, BY_DISK)}
        # each is changed by one thread only; the difference is what waits
        self._bytes_put = self._bytes_taken = 0
        self._failure = ''
        self._alive_at = self._checked_at = time.monotonic()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._work, name='bag-writer', daemon=True)
        self._thread.start()

    @property
    def path(self) -> Path:
        """Where the bag is."""
        return self._bag.path

    def put(self, topic: str, stamp_ns: int, raw: bytes, publish_ns: int | None = None) -> bool:
        """Take a message without waiting; return False when it is lost.

        Arguments as `BagWriter.write`. Call from one thread.
        """
        self._offered[topic] += 1
        size = len(raw) + MESSAGE_OVERHEAD
        if cause := self._refusal(size):
            self._lost[cause][topic] += 1
            return False
        self._bytes_put += size
        self._queue.append((topic, stamp_ns, raw, publish_ns))
        return True

    def put_all(self, messages: Sequence[Waiting]) -> None:
        """Take messages as :meth:`put` does one, all at once where there is room for all.

        Parameters
        ----------
        messages : sequence of (topic, stamp [ns], bytes, publish time [ns])
        """
        size = sum([len(raw) for _, _, raw, _ in messages]) + MESSAGE_OVERHEAD * len(messages)
        waiting = self._bytes_put - self._bytes_taken + size
        fits = len(self._queue) + len(messages) <= self._queue_size
        if not fits or waiting > self._queue_bytes or self._failure or self._stopping.is_set():
            for message in messages:
                self.put(*message)
            return
        self._offered.update([topic for topic, *_ in messages])
        self._bytes_put += size
        self._queue.extend(messages)

    @property
    def share_queued(self) -> float:
        """Share of the queue that waits for the disk."""
        waiting = (self._bytes_put - self._bytes_taken) / self._queue_bytes
        return max(len(self._queue) / self._queue_size, waiting)

    def _refusal(self, size: int) -> str:
        """Return why the queue does not take a message of so many bytes, '' where it does."""
        if self._failure or self._stopping.is_set():
            return BY_DISK
        if len(self._queue) >= self._queue_size:
            return BY_NUMBER
        waiting = self._bytes_put - self._bytes_taken
        # a message of any size goes through an empty queue
        return BY_BYTES if waiting and waiting + size > self._queue_bytes else ''

    def add_topic(self, name: str, type_name: str, qos: tuple[Qos, ...] = (Qos(),)) -> None:
        """Add a topic before its first message is put; BagError when its type is unknown.

        Messages that are put later are of this type: a topic with another is added once more.
        """
        definition = message_definition(type_name)
        self._queue.append(lambda: self._bag.add_topic(name, type_name, qos, definition))

    def attach(self, name: str, content: str | bytes, stamp_ns: int = 0) -> None:
        """Attach an XML file, in the order of the messages."""
        self._queue.append(lambda: self._bag.attach(name, content, stamp_ns=stamp_ns))

    def split(self) -> None:
        """Go on in a new file after the messages that wait."""
        self._queue.append(self._bag.split)

    def status(self) -> WriterStatus:
        """Return the status; from any thread."""
        losses = self._bag.losses
        lost = {**self._lost, BY_FILE: topic_counts(loss.contents for loss in losses)}
        return WriterStatus(
            written=self._bag.messages,
            queued=len(self._queue),
            lost=dict(sum(lost.values(), Counter[str]())),
            stalled=time.monotonic() - self._alive_at if self._thread.is_alive() else 0.0,
            failure=self._failure,
            queued_bytes=self._bytes_put - self._bytes_taken,
            causes={cause: total for cause in lost if (total := lost[cause].total())},
            losses=losses,
        )

    def close(self, timeout: float = 10.0) -> WriterStatus:
        """Write the waiting messages, finish the bag and return the last status.

        Raises
        ------
        BagError
            When the disk does not take it within the timeout [s]; the flushed part can be
            recovered.
        """
        self._stopping.set()
        self._thread.join(timeout)
        if self._thread.is_alive():
            raise BagError(
                f'{self.path}: disk must accept the waiting messages within {timeout} s, got '
                'none of the last '
                f'{len(self._queue)} messages through; run denoc recover on it'
            )
        return self.status()

    def _work(self) -> None:
        flushed_at = time.monotonic()
        try:
            while not self._stopping.wait(self._round):
                self._write_waiting()
                self._alive_at = time.monotonic()
                self._check_file()
                # due before the next round would come too late
                if self._alive_at - flushed_at >= self._flush_period - 1.5 * self._round:
                    flushed_at = self._alive_at
                    self._check_space()
                    self._bag.flush()
            self._write_waiting()
            self._bag.close()
        except BagError as error:
            self._end(str(error))
        except Exception as error:
            self._end(f'{self.path}: writer must go on, got {type(error).__name__}: {error}')

    def _write_waiting(self) -> None:
        for _ in range(len(self._queue)):
            item = self._queue.popleft()
            if callable(item):
                item()
            else:
                self._bag.write(*item)
                self._bytes_taken += len(item[2]) + MESSAGE_OVERHEAD

    def _check_file(self) -> None:
        if self._alive_at - self._checked_at >= CHECK_PERIOD:
            self._checked_at = self._alive_at
            self._bag.check()

    def _check_space(self) -> None:
        try:
            free = self._free_space(self.path.parent)
        except FileNotFoundError:
            return  # moved away a moment ago: the next check of the file tells
        if free < self._min_free_space:
            self._bag.close()
            raise BagError(
                f'{self.path}: disk must keep {self._min_free_space >> 20} MiB free, '
                f'got {free >> 20} MiB; recording ended, the bag is whole'
            )

    def _end(self, reason: str) -> None:
        self._failure = reason
        try:
            self._bag.close()
        except BagError as error:
            self._failure = f'{reason}; {error}'
        gone = topic_counts(loss.contents for loss in self._bag.losses)
        elsewhere = (
            topic_counts(self._bag.files) + gone + self._lost[BY_NUMBER] + self._lost[BY_BYTES]
        )
        self._lost[BY_DISK] = self._offered - elsewhere
        self._queue.clear()
        self._bytes_taken = self._bytes_put
