"""What the viewer costs the control loops of the SSRMS beside it.

`python -m campaigns watched`: feedforward and predictor at 1000 Hz on joints that swing, in
blocks that take turns: alone; with the viewer and nobody looking; with a client that receives all
updates and does not draw. Reported are the ratios of the loops' 99 % lateness with bootstrap
intervals, the processor time of every process, and the updates that the client got.
"""

from __future__ import annotations

import json
import sys
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from bench.loops.journal import read
from bench.loops.lateness import p99, p99_ratio
from bench.loops.lateness_command import run
from bench.loops.load_bench import SETTLING, Bench, benched, in_a_moment

from denoc_ros.cli.session.node_parameters import write_parameters
from denoc_ros.cli.session.session_config import load_config
from denoc_ros.dynamics.robot import load_robot
from denoc_ros.errors import DenocError
from denoc_ros.simulation.reference_motion import trajectory_from_config
from denoc_ros.types import Array

LOOP_RATE, PRIORITY = 1000.0, 40
UPDATE_RATE = 30.0  # Hz that one client should get
NEARLY = 0.9  # of them
LIMIT = 1.1  # of the ratios
LOOPS = ('feedforward', 'predictor')
KINDS = ('alone', 'idle', 'watched')
START_TIMEOUT = 120.0  # s, with kernels to compile


@dataclass
class Blocks:
    """Blocks of the loops' lateness [s], processor time and updates.

    Attributes
    ----------
    loops : tuple of str
        Those that run.
    late : dict
        Of each loop and kind, a block each.
    processor : dict
        Shares of a core of each kind's blocks, by process.
    updates : list of float
        Updates per second that the client got, a number each watched block.
    """

    loops: tuple[str, ...] = LOOPS
    late: dict[tuple[str, str], list[Array]] = field(default_factory=lambda: defaultdict(list))
    processor: dict[str, list[dict[str, float]]] = field(default_factory=lambda: defaultdict(list))
    updates: list[float] = field(default_factory=list)

    @property
    def met(self) -> bool:
        ratios = [self.ratio(loop, kind) for loop in self.loops for kind in ('idle', 'watched')]
        return all(ratio.met(LIMIT) for ratio in ratios) and self.has_updates

    @property
    def has_updates(self) -> bool:
        """Whether the client got what it should, in the middle."""
        return float(np.median(self.updates)) >= NEARLY * UPDATE_RATE

    def ratio(self, loop: str, kind: str) -> Any:
        return p99_ratio(self.late[loop, kind], self.late[loop, 'alone'])

    def share(self, kind: str) -> dict[str, float]:
        """Return the share of a core that each process took, the median over the blocks."""
        blocks = self.processor[kind]
        return {name: float(np.median([b[name] for b in blocks])) for name in blocks[0]}

    def record(self) -> dict[str, Any]:
        """Return plain values, ready for JSON."""
        found: dict[str, Any] = {
            'met': self.met,
            'updates_per_s': self.updates,
            'processor': {kind: self.share(kind) for kind in KINDS},
        }
        for loop in self.loops:
            p99s = {f'{kind} p99': p99(self.late[loop, kind]) for kind in KINDS}
            found[loop] = {**p99s, 'limit': LIMIT}
            for kind in ('idle', 'watched'):
                ratio = self.ratio(loop, kind)
                found[loop][f'{kind} / alone'] = {
                    'ratio': ratio.value,
                    'interval': [ratio.low, ratio.high],
                    'met': ratio.met(LIMIT),
                }
        return found

    def text(self) -> list[str]:
        lines = []
        for kind in KINDS:
            cores = ', '.join(f'{n} {100 * share:.0f} %' for n, share in self.share(kind).items())
            lines.append(f'{kind:8} core: {cores}')
        for loop in self.loops:
            for kind in KINDS:
                line = f'{loop:12}{kind:8} p99 lateness {1e6 * p99(self.late[loop, kind]):6.0f} us'
                if kind != 'alone':
                    ratio = self.ratio(loop, kind)
                    verdict = 'met' if ratio.met(LIMIT) else 'MISSED'
                    line += f', over alone {ratio}, limit {LIMIT}: {verdict}'
                lines.append(line)
        rates = ', '.join(f'{rate:.1f}' for rate in self.updates)
        verdict = 'met' if self.has_updates else 'MISSED'
        lines.append(
            f'updates per second at the client: {rates}; {UPDATE_RATE:g} wanted: {verdict}'
        )
        return lines


class Session:
    """The processes of the bench, and what goes on in each kind of block."""

    def __init__(
        self, bench: Bench, config: Any, joints: Sequence[str], loops: Sequence[str]
    ) -> None:
        self._bench, self._config, self._joints = bench, config, joints
        self._loops = loops
        bench.start_publisher('moving', LOOP_RATE, *joints)
        given = {
            'gravity': list(config.gravity),
            'update_rate': LOOP_RATE,
            'thread_priority': PRIORITY,
        }
        loose = {'feedforward': {'enforce_command_limits': False}}
        for loop in loops:
            write_parameters(bench.folder / f'{loop}.yaml', {**given, **loose.get(loop, {})})
            bench.start_node(loop)
        for loop in loops:
            bench.driver.wait_active(loop, START_TIMEOUT)
        viewer = {'gravity': list(config.gravity), 'port': 0, 'rate': UPDATE_RATE}
        write_parameters(bench.folder / 'viewer.yaml', viewer)

    def go_to(self, kind: str) -> None:
        """Start and end what a kind of block has and has not."""
        processes, driver = self._bench.processes, self._bench.driver
        if kind != 'watched':
            processes.stop('client')
        if kind == 'alone':
            processes.stop('viewer')
            driver.forget('viewer')
        elif 'address' not in driver.diagnostics('viewer: page'):
            file = str(self._bench.folder / 'viewer.yaml')
            arguments = ['denoc_ros.viewer.viewer', '--ros-args', '--params-file', file]
            processes.start_plain('viewer', arguments)
            driver.wait_active('viewer', START_TIMEOUT)
        if kind == 'watched':
            self._log.unlink(missing_ok=True)
            address = driver.diagnostics('viewer: page')['address']
            processes.start_plain('client', ['viewer_client', address])
            if not driver.until(self._is_drawn, START_TIMEOUT):
                raise DenocError('viewer: must draw for its client')
        driver.wait(SETTLING)

    @property
    def _log(self) -> Any:
        return self._bench.folder / 'logs' / 'client.log'

    def _is_drawn(self) -> bool:
        return float(self._bench.driver.diagnostics('viewer: page').get('rate_hz', 0)) > 1.0

    def run(self, seconds: float) -> tuple[float, float, dict[str, float]]:
        """Let a block be; return when it began and ended [s], and the processor time."""
        driver, processes = self._bench.driver, self._bench.processes
        reference = {**self._config.reference, 'duration': seconds + 2.0 * SETTLING}
        trajectory = trajectory_from_config(reference, self._joints)
        driver.publish_reference(trajectory, list(self._joints), in_a_moment(), len(self._loops))
        driver.wait(0.2)
        before, begin = processes.cpu_seconds(), time.perf_counter()
        driver.wait(seconds)
        end = time.perf_counter()
        return begin, end, self._bench.processor(before, end - begin)

    def received(self) -> list[float]:
        """End the client; return when it got updates [s, steady clock]."""
        self._bench.processes.stop('client')
        times: list[float] = json.loads(self._log.read_text().splitlines()[-1])
        return times


def lateness(seconds: float, count: int, loops: tuple[str, ...] = LOOPS) -> Blocks:
    """Run blocks of all kinds in turn, there and back.

    Parameters
    ----------
    seconds : float
        Length of a block.
    count : int
        Blocks of each kind.
    loops : tuple of str
        Of LOOPS.
    """
    config = load_config('config/ssrms.yaml')
    joints = list(load_robot(config.robot).joint_names)
    blocks, windows = Blocks(loops), list[tuple[str, float, float]]()
    with benched(config.robot.read_text()) as bench:
        session = Session(bench, config, joints, loops)
        for number in range(count):
            for kind in KINDS if number % 2 == 0 else reversed(KINDS):
                session.go_to(kind)
                begin, end, processor = session.run(seconds)
                windows.append((kind, begin, end))
                blocks.processor[kind].append(processor)
                if kind == 'watched':
                    times = np.array(session.received())
                    within = np.count_nonzero((times > begin) & (times < end))
                    blocks.updates.append(float(within / (end - begin)))
        bench.processes.stop_all(())
        journals = {loop: read(bench.folder / f'{loop}.npz') for loop in loops}
    for kind, begin, end in windows:
        for loop, entries in journals.items():
            blocks.late[loop, kind].append(entries.late_in(loop, begin, end))
    return blocks


if __name__ == '__main__':
    sys.exit(run('viewer_lateness', __doc__, lateness, 8.0))
