"""The time that the system itself is away, by two processes that have nothing else to do.

`python -m trust.absence publisher RATE PRIORITY FILE`: a bare node that publishes torque
messages as the feedforward does, on `/bare/effort`; each pause of over one and a half periods is a
line `begin end` [ns] of FILE, and each second one without length.

`python -m trust.absence meter FILE`: reads lines `name pid` on stdin; FILE has for each process
a line `w begin end name seconds` whenever its threads waited for a processor between two looks,
and each second `h at name pid bytes descriptors`.
"""

from __future__ import annotations

import gc
import os
import select
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import IO

PAGE = os.sysconf('SC_PAGE_SIZE')
LOOK = 0.01  # s between two looks at the threads
SECOND = 1_000_000_000  # ns
LEAST = 2e-4  # s of waiting that are worth a line


def publisher(rate: float, priority: int, file: Path) -> None:
    """Publish as the feedforward does until SIGINT."""
    import rclpy
    from rclpy.node import Node
    from rclpy.signals import SignalHandlerOptions
    from sensor_msgs.msg import JointState

    from denoc_ros.bags.joint_state import JointStateMessage
    from denoc_ros.nodes.base.messages import STATE
    from denoc_ros.nodes.base.middleware import use_sockets
    from denoc_ros.nodes.base.process import SWITCH_INTERVAL
    from denoc_ros.runtime.loop.realtime_loop import RealtimeLoop

    told: list[int] = []
    signal.signal(signal.SIGINT, lambda number, _: told.append(number))
    sys.setswitchinterval(SWITCH_INTERVAL)
    use_sockets()
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = Node('bare', use_global_arguments=False)
    publisher = node.create_publisher(JointState, '/bare/effort', STATE)
    message = JointStateMessage(['j1', 'j2'], ('position', 'velocity', 'effort'))
    last, longest = [time.time_ns()], 1.5e9 / rate
    pauses: list[tuple[int, int]] = []

    def tick(_steps: int) -> None:
        now = time.time_ns()
        publisher.publish(message.bytes(now))
        if now - last[0] > longest:
            pauses.append((last[0], now))
        last[0] = now

    gc.collect()
    gc.freeze()
    gc.disable()
    loop = RealtimeLoop(rate, tick, priority)
    loop.start()
    spoken = 0
    with file.open('w', buffering=1) as out:
        while not told:
            time.sleep(0.05)
            newest = last[0]  # pauses until then are in the list
            while pauses:
                begin, end = pauses.pop(0)
                out.write(f'{begin} {end}\n')
            if newest > spoken + SECOND:
                spoken = newest
                out.write(f'{spoken} {spoken}\n')
    loop.stop()
    node.destroy_node()
    rclpy.try_shutdown()


class Watched:
    """One process, and how long its threads have waited for a processor."""

    def __init__(self, name: str, pid: int) -> None:
        self.name, self.pid = name, pid
        self.folder = Path(f'/proc/{pid}')
        self._threads: dict[str, int] = {}  # task to descriptor
        self._before: dict[str, int] = {}
        self._looked = time.time_ns()

    def find_threads(self) -> None:
        """Find the threads that there are now."""
        tasks = {task.name for task in (self.folder / 'task').iterdir()}
        for gone in self._threads.keys() - tasks:
            os.close(self._threads.pop(gone))
        for task in tasks - self._threads.keys():
            with suppress(OSError):
                path = self.folder / 'task' / task / 'schedstat'
                self._threads[task] = os.open(path, os.O_RDONLY)

    def waited(self) -> tuple[int, int, float]:
        """Return begin and end [ns] since the last look, and how long threads waited [s]."""
        now, waited = time.time_ns(), 0
        for task, descriptor in self._threads.items():
            with suppress(OSError, IndexError):
                total = int(os.pread(descriptor, 100, 0).split()[1])
                waited += total - self._before.get(task, total)
                self._before[task] = total
        begin, self._looked = self._looked, now
        return begin, now, 1e-9 * waited

    def close(self) -> None:
        for descriptor in self._threads.values():
            os.close(descriptor)

    def holds(self) -> tuple[int, int]:
        """Return bytes of resident memory and the number of descriptors."""
        pages = int((self.folder / 'statm').read_text().split()[1])
        return pages * PAGE, len(list((self.folder / 'fd').iterdir()))


def meter(out: IO[str]) -> None:
    """Watch the processes named on stdin until it is closed."""
    watched: dict[str, Watched] = {}
    due, second, waiting = time.monotonic(), 0.0, b''
    while True:
        due = max(due + LOOK, time.monotonic())
        ready, _, _ = select.select([0], [], [], max(0.0, due - time.monotonic()))
        if ready:
            waiting += (more := os.read(0, 4096))
            if not more:
                return
            *lines, waiting = waiting.split(b'\n')
            for line in lines:
                name, pid = line.decode().split()
                if name in watched:
                    watched[name].close()
                watched[name] = Watched(name, int(pid))
        whole = time.monotonic() - second >= 1.0
        if whole:
            second = time.monotonic()
        for each in list(watched.values()):
            with suppress(OSError):
                if whole:
                    each.find_threads()
                    memory, files = each.holds()
                    if not memory:
                        continue  # it has ended
                    out.write(f'h {time.time():.3f} {each.name} {each.pid} {memory} {files}\n')
                begin, end, seconds = each.waited()
                if seconds > LEAST:
                    out.write(f'w {begin} {end} {each.name} {seconds:.6f}\n')


def main() -> None:
    if sys.argv[1] == 'publisher':
        publisher(float(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4]))
    else:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        with Path(sys.argv[2]).open('w', buffering=1) as out:
            meter(out)


if __name__ == '__main__':
    main()
