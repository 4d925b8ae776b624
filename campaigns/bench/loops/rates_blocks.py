"""Blocks of the rates campaign: our nodes or bare ones for a while, and what that showed."""

from __future__ import annotations

import dataclasses
import json
import os
import time
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from bench.loops.journal import HEAD, Entries, read
from campaign_table import import_paths
from mcap.reader import make_reader
from numpy.typing import NDArray
from ros_domains import claimed_domain

from denoc_ros.cli.progress import Progress
from denoc_ros.cli.session.phase_plans import Task
from denoc_ros.cli.session.processes import Processes
from denoc_ros.cli.session.session import STOP_ORDER, Session
from denoc_ros.cli.session.session_config import REAL, SessionConfig
from denoc_ros.cli.session.session_file import SessionFile
from denoc_ros.cli.up_verb import new_folder
from denoc_ros.dynamics.robot import load_robot
from denoc_ros.errors import DenocError
from denoc_ros.nodes.session_client import SessionClient
from denoc_ros.simulation.reference_motion import trajectory_from_config

LOOPS = ('plant', 'predictor', 'feedforward')
NODES = ('recorder', *LOOPS)  # in the order they start
INPUTS = {
    'plant': ('/feedforward/commands',),
    'predictor': ('/joint_states',),
    'feedforward': ('/joint_states',),
}
STAMPLESS = ('std_msgs/msg/Float64', 'std_msgs/msg/Float64MultiArray')
# s from the last process's start to the block's begin: when a process joins, publishing to it
# over shared memory may stand still for 333 ms, ours and bare alike
SETTLING = 1.0
PATIENCE = 60.0  # s for processes to connect
EACH_TICK = 0.5  # messages per tick from which on a topic counts as one per tick


@dataclass(frozen=True)
class LoopShare:
    """How one loop kept its deadlines in a block; `late_*` in s against the deadline."""

    deadlines: int
    missed: int
    late_p50: float
    late_p99: float
    late_max: float

    @property
    def share(self) -> float:
        return self.missed / self.deadlines if self.deadlines else 1.0


@dataclass(frozen=True)
class Block:
    """What one block showed."""

    loops: dict[str, LoopShare]
    processor: dict[str, float]  # share of a core by node
    others: dict[str, float]  # share of a core by other process, this one included
    published: int
    recorded: int
    missing: dict[str, int]  # by topic, none where all are there


class WatchedProcesses(Processes):
    """Processes that leave journals."""

    def __init__(self, folder: Path, environment: Mapping[str, str]) -> None:
        super().__init__(folder / 'logs', environment)
        self._folder = folder
        self.pids: set[int] = set()

    def start(self, name: str, arguments: Sequence[str], ends: bool = False) -> None:
        """Start a module by a session's words `-c code module …`, with a journal."""
        watched = ['-m', 'bench.loops.journal', str(self._folder / f'{name}.npz'), *arguments[2:]]
        super().start(name, watched, ends)
        self.pids.add(self._running[name].pid)

    def start_bare(self, name: str, spec: Path) -> None:
        journal = str(self._folder / f'{name}.npz')
        super().start(name, ['-m', 'bench.loops.bare_node', journal, str(spec)])
        self.pids.add(self._running[name].pid)


class WatchedDriver(SessionClient):
    """A driver that knows when the phase was."""

    window: Window
    pids: Collection[int]
    others: Mapping[str, float]

    def begin_phase(self, name: str) -> None:
        """Begin, when every process has found the last one."""
        self.wait(SETTLING)
        self.window = Window()
        super().begin_phase(name)

    def end_phase(self) -> None:
        """End."""
        self.window.end()
        self.others = self.window.others(self.pids)
        super().end_phase()


class Window:
    """A stretch of time and what the machine's processes took in it."""

    def __init__(self) -> None:
        self.begin = time.perf_counter()
        self._used = used_seconds()
        self.finish = self.begin
        self.shares: dict[int, float] = {}  # of a core, by process

    def end(self) -> None:
        self.finish = time.perf_counter()
        elapsed = self.finish - self.begin
        self.shares = {
            pid: (used - self._used.get(pid, 0.0)) / elapsed
            for pid, used in used_seconds().items()
        }

    def others(self, nodes: Collection[int]) -> dict[str, float]:
        """Return the shares of processes that are not the nodes, by what they run."""
        found: dict[str, float] = {}
        for pid, share in self.shares.items():
            if share > 0.0 and pid not in nodes:
                name = process_name(pid)
                found[name] = found.get(name, 0.0) + share
        return found


def used_seconds() -> dict[int, float]:
    """Return the processor time of each process [s].

    That of /proc/stat is sampled, 250 times a second, beside loops that begin to work at the same
    instants, and may count too much or too little.
    """
    found = {}
    for stat in Path('/proc').glob('[0-9]*/stat'):
        with suppress(OSError):  # it has just ended
            fields = stat.read_text().rpartition(')')[2].split()
            ticks = int(fields[11]) + int(fields[12])
            found[int(stat.parent.name)] = ticks / os.sysconf('SC_CLK_TCK')
    return found


def process_name(pid: int) -> str:
    """Return what a process runs: the module of an interpreter, else its command."""
    if pid == os.getpid():
        return 'session'
    try:
        words = Path(f'/proc/{pid}/cmdline').read_text().split('\0')
        command = Path(f'/proc/{pid}/comm').read_text().strip()
    except OSError:
        return 'ended'
    for flag, after in (('-m', 1), ('-c', 2)):
        if flag in words:
            return words[words.index(flag) + after]
    return command


@dataclass(frozen=True)
class Recording:
    """A bag's messages by topic: checksums, whole and of heads; types; the first message."""

    keys: dict[str, NDArray[np.int64]]
    heads: dict[str, NDArray[np.int64]]
    types: dict[str, str]
    first: dict[str, bytes]


def read_recording(file: Path) -> Recording:
    """Read a bag in the order it was written."""
    keys: dict[str, list[int]] = {}
    heads: dict[str, list[int]] = {}
    types: dict[str, str] = {}
    first: dict[str, bytes] = {}
    with file.open('rb') as stream:
        for schema, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            assert schema is not None
            types[channel.topic] = schema.name
            first.setdefault(channel.topic, message.data)
            keys.setdefault(channel.topic, []).append(crc32(message.data))
            heads.setdefault(channel.topic, []).append(crc32(message.data[HEAD]))
    whole, head = ({t: np.array(k, dtype=np.int64) for t, k in c.items()} for c in (keys, heads))
    return Recording(whole, head, types, first)


def missing_messages(
    published: NDArray[np.int64], recorded: NDArray[np.int64], begin: int = 0
) -> int:
    """Return how many of the published, from an index on, the recorded do not hold.

    Both are in order. Commands at rest are the same each time: so the recorded are found among the
    published, the last one first, and not the other way round, in which one that is gone would be
    taken for an equal one long before, and all between them for gone.
    """
    places: dict[int, list[int]] = {}
    for index, key in enumerate(published.tolist()):
        places.setdefault(key, []).append(index)
    held, place = np.zeros(len(published), dtype=bool), len(published)
    for key in reversed(recorded.tolist()):
        same = places.get(key, [])
        while same and same[-1] >= place:
            same.pop()
        if same:
            place = same.pop()
            held[place] = True
    return int(np.count_nonzero(~held[begin:]))


def loop_share(entries: Entries, window: Window) -> LoopShare:
    """Return how a loop kept its deadlines in a window."""
    inside = (entries.start >= window.begin) & (entries.start <= window.finish)
    late, period = entries.late[inside], entries.period
    if not len(late):
        raise DenocError('a loop must tick in its block, got no tick')
    over = np.where(late > period, np.floor(late / period), 0.0).astype(int)
    return LoopShare(
        deadlines=len(late) + int(over.sum()),
        missed=int(np.count_nonzero(late > 0.5 * period)) + int(over.sum()),
        late_p50=float(np.percentile(late, 50)),
        late_p99=float(np.percentile(late, 99)),
        late_max=float(late.max()),
    )


def judge(
    journals: Mapping[str, Entries],
    recording: Recording,
    window: Window,
    processor: Mapping[str, float],
    others: Mapping[str, float],
) -> Block:
    """Return what a block showed."""
    published = 0
    missing: Counter[str] = Counter()
    for topic in sorted({topic for entries in journals.values() for topic in entries.topics}):
        writers = [entries for entries in journals.values() if topic in entries.topics]
        sent = [entries.topics[topic] for entries in writers]
        in_block = [keys[times >= window.begin] for times, keys in sent]
        found = recording.keys if writers[0].whole[topic] else recording.heads
        held = found.get(topic, np.zeros(0, dtype=np.int64))
        count = sum(map(len, in_block))
        if len(in_block) == 1:
            whole = sent[0][1]
            lost = missing_messages(whole, held, len(whole) - len(in_block[0]))
        else:  # /diagnostics: what several nodes say comes in any order
            left = Counter(np.concatenate(in_block).tolist()) - Counter(held.tolist())
            lost = sum(left.values())
        published += count
        if lost:
            missing[topic] = lost
    return Block(
        loops={name: loop_share(journals[name], window) for name in LOOPS},
        processor=dict(processor),
        others=dict(others),
        published=published,
        recorded=published - sum(missing.values()),
        missing=dict(missing),
    )


class Bench:
    """Runs blocks of both kinds at one rate.

    Parameters
    ----------
    config : SessionConfig
        Whose nodes run.
    rate, seconds : float
        Hz; s of a block.
    priority : int or None
        SCHED_FIFO priority of every loop; None: as the configuration says.
    folder : Path
        For what the blocks leave.
    """

    def __init__(
        self,
        config: SessionConfig,
        rate: float,
        seconds: float,
        priority: int | None,
        folder: Path,
    ) -> None:
        given = {} if priority is None else {'thread_priority': priority}
        nodes = {name: dict(config.nodes.get(name, {})) for name in NODES}
        for name in LOOPS:
            nodes[name] |= {'update_rate': rate, **given}
        reference = {**config.reference, 'duration': seconds}
        robot = load_robot(config.robot, gravity=config.gravity)
        joints = list(robot.joint_names)
        trajectory = trajectory_from_config(reference, joints)
        nodes['plant'].setdefault('start', trajectory.table(seconds)[1][0].tolist())
        self.priority = int(nodes['plant'].get('thread_priority', 0))
        # a deadline is one of the steady clock, at this rate, on whatever machine
        self._config = dataclasses.replace(
            config, reference=reference, nodes=nodes, phases=config.phases[-1:], time=REAL
        )
        self._task = Task(trajectory, joints, seconds)
        self._rate, self._seconds = rate, seconds
        self._folder = folder
        self._specs: dict[str, dict[str, Any]] = {}

    def ours(self, index: int) -> Block:
        """Run a session of `denoc up`."""
        folder = new_folder(self._folder / f'ours-{index}')
        with domain() as environment:
            processes = WatchedProcesses(folder, environment)
            text = self._config.robot.read_text()
            driver = WatchedDriver(text, True, processes.check)
            driver.pids = processes.pids
            with driver:
                file = SessionFile(folder, {})
                session = Session(self._config, self._task, file, processes, driver, Progress())
                try:
                    session.run()
                finally:
                    shares = session.end()
            window = driver.window
        journals = {name: read(folder / f'{name}.npz') for name in NODES}
        recording = read_recording(next((folder / 'bag').glob('*.mcap')))
        if not self._specs:
            self._specs = self._bare_specs(journals, recording, window)
        return judge(journals, recording, window, shares, driver.others)

    def _bare_specs(
        self, journals: Mapping[str, Entries], recording: Recording, window: Window
    ) -> dict[str, dict[str, Any]]:
        """Return what bare nodes have to do: the topics that ours send about once a tick."""
        least = EACH_TICK * self._seconds * self._rate * 0.5
        publish: dict[str, list[dict[str, Any]]] = {}
        for name, entries in journals.items():
            publish[name] = [
                {
                    'topic': topic,
                    'type': recording.types[topic],
                    'depth': entries.depths[topic],
                    'stamped': recording.types[topic] not in STAMPLESS,
                    'raw': recording.first[topic].hex(),
                }
                for topic, (times, _) in entries.topics.items()
                if np.count_nonzero(times >= window.begin) > least and topic in recording.types
            ]
        every = {row['topic']: row for rows in publish.values() for row in rows}
        return {
            name: {
                'name': name,
                'rate': self._rate,
                'priority': self.priority,
                'publish': rows,
                'listen': [
                    {'topic': topic, 'type': row['type']}
                    for topic, row in every.items()
                    if topic in INPUTS.get(name, tuple(every))
                ],
            }
            for name, rows in publish.items()
        }

    def bare(self, index: int) -> Block:
        """Run bare nodes for as long."""
        folder = new_folder(self._folder / f'bare-{index}')
        bag = folder / 'bag.mcap'
        with domain() as environment:
            processes = WatchedProcesses(folder, environment)
            try:
                for name in NODES:
                    more = {'bag': str(bag)} if name == 'recorder' else {}
                    spec = folder / f'{name}.json'
                    spec.write_text(json.dumps({**self._specs[name], **more}))
                    processes.start_bare(name, spec)
                wait_for([folder / f'{name}.ready' for name in NODES], processes)
                window, before = Window(), processes.cpu_seconds()
                time.sleep(self._seconds)
                after = processes.cpu_seconds()
                window.end()
                others = window.others(processes.pids)
            finally:
                processes.stop_all(STOP_ORDER)
        elapsed = window.finish - window.begin
        shares = {name: (after[name] - before[name]) / elapsed for name in after}
        journals = {name: read(folder / f'{name}.npz') for name in NODES}
        return judge(journals, read_recording(bag), window, shares, others)


@contextmanager
def domain() -> Iterator[dict[str, str]]:
    """Claim a ROS domain for this process and, as environment, for its children."""
    paths = [*import_paths(), os.environ.get('PYTHONPATH', '')]
    with claimed_domain() as claimed:
        given = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'ROS_DOMAIN_ID': str(claimed)}
        before = {key: os.environ.get(key) for key in given}
        os.environ.update(given)
        try:
            yield {**given, 'PYTHONPATH': os.pathsep.join(filter(None, paths))}
        finally:
            for key, value in before.items():
                if value is None:
                    del os.environ[key]
                else:
                    os.environ[key] = value


def wait_for(files: Sequence[Path], processes: Processes) -> None:
    """Wait until every node has said that it runs, then a little longer."""
    end = time.perf_counter() + PATIENCE
    while not all(file.exists() for file in files):
        processes.check()
        if time.perf_counter() > end:
            missing = [file.stem for file in files if not file.exists()]
            raise DenocError(f'bare nodes must connect within {PATIENCE:g} s, got none: {missing}')
        time.sleep(0.05)
    time.sleep(SETTLING)
