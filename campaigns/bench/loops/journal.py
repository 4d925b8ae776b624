"""What a node's process did, for the rates campaign: messages that left, ticks of its loop.

`python -m bench.loops.journal FILE MODULE …` runs a node module as `python -m MODULE …` would and,
when it has ended, writes FILE. Every message is known by when it left and by the checksum of its
bytes.
"""

from __future__ import annotations

import runpy
import sys
import time
from array import array
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn
from zlib import crc32

import numpy as np
from numpy.typing import NDArray
from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message

from denoc_ros.errors import DenocError
from denoc_ros.nodes.base import messages, process
from denoc_ros.runtime.loop import realtime_loop as timing
from denoc_ros.runtime.loop.realtime_loop import RealtimeLoop

TICKS_KEPT = 1 << 20  # a quarter of an hour at 1000 Hz

# the stamp; before it stands, on the wire, how much padding is at the end, behind it comes padding
HEAD = slice(4, 16)


@dataclass
class Sent:
    """The messages of one publisher."""

    topic: str
    depth: int  # of the publisher's history
    whole: bool  # whether keys sum all bytes, else HEAD of them
    # arrays: a garbage collection would go through lists
    times: array[float] = field(default_factory=lambda: array('d'))  # s, steady clock
    keys: array[int] = field(default_factory=lambda: array('q'))


class Journal:
    """Keeps the messages and the loop of this process."""

    def __init__(self) -> None:
        self.sent: dict[int, Sent] = {}
        self.loops: list[RealtimeLoop] = []
        self._kept: list[Any] = []

    def watch(self) -> None:
        """Look over the shoulder of every publisher and loop from here on."""
        publish, start, now = Publisher.publish, RealtimeLoop.start, time.perf_counter
        raw_publish = messages.raw_publish
        timing.WINDOW = TICKS_KEPT

        def watched_publish(publisher: Any, message: Any) -> None:
            prebuilt = isinstance(message, bytes)
            sent = self.sent.get(id(publisher)) or self._new(publisher, prebuilt)
            sent.times.append(now())
            # the end of what rclpy serializes is padding, with anything in it
            sent.keys.append(crc32(message if prebuilt else serialize_message(message)[HEAD]))
            publish(publisher, message)

        def watched_raw_publish(publisher: Any) -> Callable[[bytes], None]:
            publish_raw = raw_publish(publisher)
            sent = self._new(publisher, True)

            def watched(message: bytes) -> None:
                sent.times.append(now())
                sent.keys.append(crc32(message))
                publish_raw(message)

            return watched

        def watched_start(loop: RealtimeLoop) -> None:
            self.loops.append(loop)
            start(loop)

        Publisher.publish = watched_publish
        messages.raw_publish = watched_raw_publish  # before a node's module imports it
        RealtimeLoop.start = watched_start  # type: ignore[method-assign, assignment]

    def _new(self, publisher: Any, whole: bool) -> Sent:
        sent = Sent(publisher.topic_name, publisher.qos_profile.depth, whole)
        self.sent[id(publisher)] = sent
        self._kept.append(publisher)  # or its id may come again
        return sent

    def write(self, file: Path) -> None:
        """Write everything as arrays."""
        rows = list(self.sent.values())
        arrays: dict[str, Any] = {
            'topics': np.array([row.topic for row in rows]),
            'depths': np.array([row.depth for row in rows]),
            'whole': np.array([row.whole for row in rows]),
        }
        for index, row in enumerate(rows):
            arrays[f'times_{index}'] = np.array(row.times)
            arrays[f'keys_{index}'] = np.array(row.keys, dtype=np.int64)
        if self.loops:
            records = [loop.record() for loop in self.loops]
            arrays['start'], arrays['late'] = map(np.concatenate, zip(*records, strict=True))
            arrays['period'] = self.loops[-1].period
        partial = file.with_suffix('.part.npz')
        np.savez(partial, **arrays)
        partial.rename(file)


@dataclass(frozen=True)
class Entries:
    """A journal that was read."""

    topics: dict[str, tuple[NDArray[np.float64], NDArray[np.int64]]]  # times [s], keys
    depths: dict[str, int]
    whole: dict[str, bool]
    start: NDArray[np.float64]  # s, when each tick began
    late: NDArray[np.float64]  # s, against its deadline
    period: float

    def late_in(self, name: str, begin: float, end: float) -> NDArray[np.float64]:
        """Return the lateness of the ticks between two moments [s]; DenocError without any."""
        late = self.late[(self.start > begin) & (self.start < end)]
        if not len(late):
            raise DenocError(f'{name}: a loop must tick in its block, got no tick')
        return late


def read(file: Path) -> Entries:
    """Return a journal; one topic's publishers in the order of their messages."""
    with np.load(file) as arrays:
        topics: dict[str, Any] = {}
        for index, name in enumerate(arrays['topics'].tolist()):
            topics.setdefault(name, []).append((arrays[f'times_{index}'], arrays[f'keys_{index}']))
        merged = {}
        for name, parts in topics.items():
            times, keys = (np.concatenate(columns) for columns in zip(*parts, strict=True))
            order = np.argsort(times, kind='stable')
            merged[name] = times[order], keys[order]
        loop = 'late' in arrays
        return Entries(
            topics=merged,
            depths=dict(zip(arrays['topics'].tolist(), arrays['depths'].tolist(), strict=True)),
            whole=dict(zip(arrays['topics'].tolist(), arrays['whole'].tolist(), strict=True)),
            start=arrays['start'] if loop else np.zeros(0),
            late=arrays['late'] if loop else np.zeros(0),
            period=float(arrays['period']) if loop else 0.0,
        )


def main() -> None:
    file, module = Path(sys.argv[1]), sys.argv[2]
    journal = Journal()
    journal.watch()
    sys.argv = sys.argv[2:]
    leave = process.leave

    def write_and_leave(status: int) -> NoReturn:
        journal.write(file)
        leave(status)

    process.leave = write_and_leave  # a node ends at once, without what stands below
    try:
        runpy.run_module(module, run_name='__main__', alter_sys=True)
    finally:
        journal.write(file)


if __name__ == '__main__':
    main()
