"""A bare node: passes messages as one of ours does, at the same rate, and does nothing else.

`python -m bench.loops.bare_node JOURNAL SPEC.json`: SPEC gives `publish` (topic, type, depth,
stamped, raw: hexadecimal bytes), `listen` (topic, type), `rate` [Hz], `priority`, numbers that may
be set (`parameters`), and for a recorder `bag`. Raw subscriptions, EventsExecutor, prebuilt bytes,
a loop thread on absolute deadlines, no garbage collection; the recorder's MCAP writer in a thread.
JOURNAL.ready appears when all are connected.
"""

from __future__ import annotations

import gc
import json
import signal
import struct
import sys
import threading
import time
from collections import deque
from importlib import import_module
from pathlib import Path
from typing import Any

import rclpy
from bench.loops.journal import Journal
from mcap.writer import CompressionType, Writer
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from denoc_ros.nodes.base.middleware import use_sockets
from denoc_ros.nodes.base.process import SWITCH_INTERVAL
from denoc_ros.runtime.loop.realtime_loop import RealtimeLoop

NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
DEEP = QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE)
ROUND, FLUSH = 0.02, 0.2  # s
LINGER = 0.2  # s that publisher and subscriptions outlive the last message
STAMP = struct.Struct('<iI')


def message_class(name: str) -> Any:
    package, _, kind = name.partition('/msg/')
    return getattr(import_module(f'{package}.msg'), kind)


class TickPublisher:
    """Publishes one message of each topic per tick, stamped anew where it has a stamp."""

    def __init__(self, node: Node, rows: list[dict[str, Any]]) -> None:
        self.publishers = [
            node.create_publisher(message_class(row['type']), row['topic'], row['depth'])
            for row in rows
        ]
        self._messages = [
            (publisher, bytearray.fromhex(row['raw']), row['stamped'])
            for publisher, row in zip(self.publishers, rows, strict=True)
        ]

    @property
    def connected(self) -> bool:
        return all(each.get_subscription_count() > 0 for each in self.publishers)

    def tick(self, _steps: int) -> None:
        seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
        for publisher, raw, stamped in self._messages:
            if stamped:
                STAMP.pack_into(raw, 4, seconds, nanoseconds)
            publisher.publish(bytes(raw))


class Keeper:
    """Writes what it hears into an MCAP, in a thread."""

    def __init__(self, node: Node, rows: list[dict[str, Any]], file: Path) -> None:
        self._queue: deque[tuple[int, int, bytes]] = deque()
        self._stop = threading.Event()
        self._stream = file.open('wb')
        self._writer = Writer(self._stream, compression=CompressionType.NONE)
        self._writer.start(profile='ros2')
        for row in rows:
            schema = self._writer.register_schema(row['type'], 'ros2msg', b'')
            channel = self._writer.register_channel(row['topic'], 'cdr', schema)
            node.create_subscription(
                message_class(row['type']), row['topic'], self._taker(channel), DEEP, raw=True
            )
        self._thread = threading.Thread(target=self._work)
        self._thread.start()

    def _taker(self, channel: int) -> Any:
        put, now = self._queue.append, time.time_ns

        def take(raw: bytes) -> None:
            put((channel, now(), raw))

        return take

    def _work(self) -> None:
        flushed = time.monotonic()
        while not self._stop.wait(ROUND):
            self._drain()
            if time.monotonic() - flushed >= FLUSH:
                flushed = time.monotonic()
                self._writer.flush()
        self._drain()
        self._writer.finish()
        self._stream.close()

    def _drain(self) -> None:
        for _ in range(len(self._queue)):
            channel, stamp, raw = self._queue.popleft()
            self._writer.add_message(channel, stamp, raw, stamp)

    def close(self) -> None:
        self._stop.set()
        self._thread.join()


def main() -> None:
    file, spec = Path(sys.argv[1]), json.loads(Path(sys.argv[2]).read_text())
    journal = Journal()
    journal.watch()
    signals: list[int] = []
    sys.setswitchinterval(SWITCH_INTERVAL)
    signal.signal(signal.SIGINT, lambda number, _: signals.append(number))
    use_sockets()
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = Node(spec['name'])
    keeper = Keeper(node, spec['listen'], Path(spec['bag'])) if 'bag' in spec else None
    heard: dict[str, bytes] = {}
    if keeper is None:
        for row in spec['listen']:
            node.create_subscription(
                message_class(row['type']),
                row['topic'],
                lambda raw, topic=row['topic']: heard.__setitem__(topic, raw),
                NEWEST,
                raw=True,
            )
    for name in spec.get('parameters', ()):
        node.declare_parameter(name, 0.0)
    publisher = TickPublisher(node, spec['publish'])
    executor = EventsExecutor()
    executor.add_node(node)
    while not (publisher.connected or signals):
        executor.spin_once(0.1)
    gc.collect()
    gc.freeze()
    gc.disable()
    loop = RealtimeLoop(spec['rate'], publisher.tick, spec['priority'])
    if publisher.publishers:
        loop.start()
    file.with_suffix('.ready').touch()
    while not signals:
        executor.spin_once(0.1)
    loop.stop()
    end = time.perf_counter() + LINGER
    while time.perf_counter() < end:
        executor.spin_once(0.05)
    if keeper is not None:
        keeper.close()
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown()
    journal.write(file)


if __name__ == '__main__':
    main()
