"""The processes of the load benches: a recorder, a loop, and what talks to them."""

from __future__ import annotations

import signal
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from bench.loops.rates_blocks import WatchedProcesses, domain

from denoc_ros.cli.session.node_parameters import write_parameters
from denoc_ros.cli.session.processes import Processes
from denoc_ros.errors import DenocError
from denoc_ros.nodes.session_client import SessionClient
from denoc_ros.parts import node_main
from denoc_ros.python_start import module_words

TOPICS, RATE, SIZE = 50, 50.0, 2000  # 5 MB/s
SETTLING = 1.0  # s after a change: when a participant joins, Fast DDS may stand still for 333 ms
ROOM = 2 << 30  # bytes that the disk must keep
NO_ROBOT = '<robot name="none"><link name="base"/></robot>'


def in_a_moment() -> int:
    """Return a stamp of 0.1 s from now [ns]."""
    return time.time_ns() + 100_000_000


class SignalledProcesses(WatchedProcesses):
    """Processes that are told by signals what to do."""

    def start_watched(self, name: str, arguments: Sequence[str]) -> None:
        """Start a module under the eyes of a journal."""
        self.start(name, module_words(*arguments))

    def start_plain(self, name: str, arguments: Sequence[str]) -> None:
        """Start a module with nothing beside it."""
        Processes.start(self, name, ['-m', *arguments])

    def signal(self, name: str, number: int) -> None:
        self._running[name].send_signal(number)


class Bench:
    """The processes of both benches."""

    def __init__(self, folder: Path, environment: Mapping[str, str], robot: str) -> None:
        (folder / 'logs').mkdir()
        self.folder = folder
        self.processes = SignalledProcesses(folder, environment)
        self.driver = SessionClient(robot, True, self.processes.check)

    def start_recorder(self, topics: Sequence[str]) -> None:
        """Start it; it records at once."""
        given = {'output': str(self.folder / 'bag'), 'topics': list(topics)}
        write_parameters(self.folder / 'recorder.yaml', given | {'min_free_space': ROOM})
        self.start_node('recorder')
        self.driver.wait_active('recorder', 60.0)

    def start_node(self, name: str) -> None:
        """Start a node with the parameters of its file."""
        file = str(self.folder / f'{name}.yaml')
        node = [node_main(name), '--ros-args', '--params-file', file]
        self.processes.start_watched(name, node)

    def start_publisher(self, name: str, *arguments: object) -> None:
        self.processes.start_watched(name, ['bench.loops.publisher', name, *map(str, arguments)])

    def start_load(self) -> None:
        self.start_publisher('load', TOPICS, RATE, SIZE)

    def tell(self, name: str, talks: bool) -> None:
        """Let a publisher begin or pause."""
        self.processes.signal(name, signal.SIGUSR1 if talks else signal.SIGUSR2)

    def recorded(self, key: str) -> int:
        return int(self.driver.diagnostics('recorder: recording').get(key, 0))

    def wait_for_topics(self) -> None:
        if not self.driver.until(lambda: self.recorded('topics') >= TOPICS, 60.0):
            raise DenocError(f'recorder: must record {TOPICS} topics')
        self.driver.wait(SETTLING)

    def processor(self, before: dict[str, float], elapsed: float) -> dict[str, float]:
        after = self.processes.cpu_seconds()
        return {name: (after[name] - before[name]) / elapsed for name in before if name in after}


@contextmanager
def benched(robot: str = NO_ROBOT) -> Iterator[Bench]:
    """Give a bench in a ROS domain and a folder of its own."""
    with tempfile.TemporaryDirectory(prefix='load-') as folder, domain() as environment:
        bench = Bench(Path(folder), environment, robot)
        with bench.driver:
            try:
                yield bench
            finally:
                bench.processes.stop_all(())
