"""What a recorder under load, and bad input, cost a control loop beside them.

`python -m campaigns lateness`: the feedforward of the SSRMS at 1000 Hz, in blocks that take
turns: alone; beside publishers of 50 topics with 5 MB/s; beside these and a recorder of them;
under garbage; and, with its process stopped, a bare thread that only sleeps. Reported are the
ratios of the 99 % lateness with bootstrap intervals, and the processor time beside.
"""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from bench.loops.journal import read
from bench.loops.lateness import p99, p99_ratio
from bench.loops.lateness_command import run
from bench.loops.load_bench import SETTLING, Bench, benched, in_a_moment

from denoc_ros.cli.session.node_parameters import write_parameters
from denoc_ros.cli.session.session_config import load_config
from denoc_ros.dynamics.robot import load_robot
from denoc_ros.simulation.reference_motion import trajectory_from_config
from denoc_ros.types import Array

LOOP_RATE, PRIORITY = 1000.0, 40
GARBAGE_RATE = 500.0
KINDS = ('alone', 'load', 'recorder', 'garbage', 'bare')
# which block over which, and the limit of the ratio
PAIRS: tuple[tuple[str, str, float | None], ...] = (
    ('recorder', 'load', 1.1),
    ('garbage', 'alone', 1.1),
    ('alone', 'bare', 1.2),
    ('load', 'alone', None),
)


@dataclass
class Blocks:
    """Blocks of the loop's lateness [s] by kind, and the shares of a core by kind and process."""

    late: dict[str, list[Array]] = field(default_factory=lambda: {kind: [] for kind in KINDS})
    processor: dict[str, dict[str, float]] = field(default_factory=dict)  # of the last block

    @property
    def met(self) -> bool:
        return all(
            limit is None or p99_ratio(self.late[above], self.late[below]).met(limit)
            for above, below, limit in PAIRS
        )

    def record(self) -> dict[str, Any]:
        """Return plain values, ready for JSON."""
        found: dict[str, Any] = {
            'p99': {kind: p99(blocks) for kind, blocks in self.late.items()},
            'processor': self.processor,
        }
        for above, below, limit in PAIRS:
            ratio = p99_ratio(self.late[above], self.late[below])
            found[f'{above} / {below}'] = {
                'ratio': ratio.value,
                'interval': [ratio.low, ratio.high],
                'limit': limit,
                'met': limit is None or ratio.met(limit),
            }
        return found

    def text(self) -> list[str]:
        lines = []
        for kind, blocks in self.late.items():
            shares = self.processor.get(kind, {})
            cores = ', '.join(f'{name} {100 * share:.0f} %' for name, share in shares.items())
            lines.append(f'{kind:10} p99 lateness {1e6 * p99(blocks):6.0f} us; core: {cores}')
        for above, below, limit in PAIRS:
            ratio = p99_ratio(self.late[above], self.late[below])
            verdict = '' if limit is None else f', limit {limit}: '
            verdict += '' if limit is None else 'met' if ratio.met(limit) else 'MISSED'
            lines.append(f'{above} / {below}: {ratio}{verdict}')
        return lines


@contextmanager
def going_on(bench: Bench, kind: str) -> Iterator[None]:
    """Let a kind of block be."""
    loads = kind in ('load', 'recorder')
    if kind == 'recorder':
        bench.driver.trigger('/recorder/start')
        bench.wait_for_topics()
    if loads:
        bench.tell('load', True)
    if kind == 'garbage':
        bench.tell('garbage', True)
    if kind == 'bare':
        bench.processes.signal('feedforward', signal.SIGSTOP)
        bench.tell('sleeper', True)
    bench.driver.wait(SETTLING)
    try:
        yield
    finally:
        if loads:
            bench.tell('load', False)
        if kind == 'recorder':
            bench.driver.trigger('/recorder/stop')
        if kind == 'garbage':
            bench.tell('garbage', False)
        if kind == 'bare':
            bench.tell('sleeper', False)
            bench.processes.signal('feedforward', signal.SIGCONT)
        bench.driver.wait(0.5 * SETTLING)


def lateness(seconds: float, count: int) -> Blocks:
    """Run blocks of all kinds in turn.

    Parameters
    ----------
    seconds : float
        Length of a block.
    count : int
        Blocks of each kind.
    """
    config = load_config('config/ssrms.yaml')
    joints = list(load_robot(config.robot).joint_names)
    blocks, windows = Blocks(), list[tuple[str, float, float]]()
    with benched(config.robot.read_text()) as bench:
        start(bench, joints, list(config.gravity))
        for _ in range(count):
            for kind in KINDS:
                with going_on(bench, kind):
                    given = {**config.reference, 'duration': seconds + 2.0 * SETTLING}
                    trajectory = trajectory_from_config(given, joints)
                    if kind != 'bare':
                        bench.driver.publish_reference(trajectory, joints, in_a_moment(), 1)
                        bench.driver.wait(0.2)
                    before, begin = bench.processes.cpu_seconds(), time.perf_counter()
                    bench.driver.wait(seconds)
                    windows.append((kind, begin, time.perf_counter()))
                    blocks.processor[kind] = bench.processor(before, seconds)
        bench.processes.stop_all(())
        loops = {name: read(bench.folder / f'{name}.npz') for name in ('feedforward', 'sleeper')}
    for kind, begin, end in windows:
        entries = loops['sleeper' if kind == 'bare' else 'feedforward']
        blocks.late[kind].append(entries.late_in(kind, begin, end))
    return blocks


def start(bench: Bench, joints: Sequence[str], gravity: Sequence[float]) -> None:
    """Start all processes; the recorder rests."""
    bench.start_publisher('joints', LOOP_RATE, *joints)
    bench.start_load()
    bench.start_publisher('garbage', GARBAGE_RATE)
    bench.processes.start_watched(
        'sleeper', ['bench.loops.sleeper', str(LOOP_RATE), str(PRIORITY)]
    )
    given = {
        'gravity': list(gravity),
        'update_rate': LOOP_RATE,
        'thread_priority': PRIORITY,
        'enforce_command_limits': False,
        'max_publishers': 3,
    }
    write_parameters(bench.folder / 'feedforward.yaml', given)
    bench.start_node('feedforward')
    bench.driver.wait_active('feedforward', 120.0)
    bench.start_recorder(['/load/*', '/feedforward/*'])
    bench.wait_for_topics()
    bench.driver.trigger('/recorder/stop')


if __name__ == '__main__':
    sys.exit(run('loop_lateness', __doc__, lateness, 6.0))
