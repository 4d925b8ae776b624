"""What requests cost a control loop: parameters set and services called beside it.

`python -m campaigns requests --minutes 10`: the feedforward of the SSRMS at 1000 Hz in blocks
that take turns: under requests (20 parameters a second, two of three a number of the model, and 20
services drawn at random); quiet; and, with its process stopped, a bare node that publishes one
message a tick, under the same rate of requests. Reported is how late ticks begin.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from bench.loops.journal import read
from bench.loops.lateness_command import say
from bench.loops.load_bench import SETTLING, Bench, benched, in_a_moment
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64MultiArray

from denoc_ros.cli.session.node_parameters import write_parameters
from denoc_ros.cli.session.session_config import load_config
from denoc_ros.dynamics.robot import load_robot
from denoc_ros.errors import DenocError
from denoc_ros.simulation.reference_motion import trajectory_from_config
from denoc_ros.types import Array

LOOP_RATE, PRIORITY = 1000.0, 40
REQUEST_RATE = 20.0
BLOCK = 12.0  # s under requests; the others take turns with a third of that each
SHARES = {'requests': 1.0, 'quiet': 1 / 3, 'bare': 1 / 3}
PERCENTILES = {'p99': 99.0, 'p99.9': 99.9, 'p99.99': 99.99, 'largest': 100.0}
ANSWERED = 0.95  # DDS drops requests to a node that stands still, as each does in turn
ASKED = {
    'feedforward': [
        'lead_time:0:0.002',
        'beam.link_2.y.damping_ratio:0.005:0.02',
        'joint.joint_2.damping:0:1',
    ],
    'bare': ['lead_time:0:0.002', 'damping:0.005:0.02', 'friction:0:1'],
}
START_TIMEOUT = 120.0  # s, with kernels to compile


@dataclass
class Found:
    """Blocks of lateness [s] by kind, and what the requests came to by node."""

    late: dict[str, list[Array]] = field(default_factory=lambda: {kind: [] for kind in SHARES})
    asked: dict[str, dict[str, float]] = field(default_factory=dict)

    @property
    def met(self) -> bool:
        """Whether nearly all that was asked was answered, and nothing refused."""
        return all(
            counts['answered'] >= ANSWERED * max(counts['sent'], 1.0) and not counts['refused']
            for counts in self.asked.values()
        )

    def percentiles(self, kind: str) -> dict[str, float]:
        """Return how late the ticks of all blocks of a kind began [s]."""
        late = np.concatenate(self.late[kind])
        return {name: float(np.percentile(late, share)) for name, share in PERCENTILES.items()}

    def record(self) -> dict[str, Any]:
        """Return plain values, ready for JSON."""
        rows = {
            kind: {'ticks': sum(map(len, blocks)), **self.percentiles(kind)}
            for kind, blocks in self.late.items()
        }
        return {'lateness': rows, 'requests': self.asked, 'met': self.met}

    def text(self) -> list[str]:
        lines = [f'lateness [us]{"ticks":>9}' + ''.join(f'{name:>9}' for name in PERCENTILES)]
        for kind, blocks in self.late.items():
            numbers = ''.join(f'{1e6 * late:9.0f}' for late in self.percentiles(kind).values())
            lines.append(f'{kind:13}{sum(map(len, blocks)):9}{numbers}')
        for name, counts in self.asked.items():
            lines.append(
                f'{name}: {counts["sent"]} requests, {counts["answered"]} answered, '
                f'{counts["refused"]} refused, the slowest after {1e3 * counts["worst"]:.0f} ms'
            )
        return lines


def start(bench: Bench, joints: Sequence[str], gravity: Sequence[float]) -> None:
    """Start all processes; nothing is asked yet."""
    bench.start_publisher('joints', LOOP_RATE, *joints)
    given = {
        'gravity': list(gravity),
        'update_rate': LOOP_RATE,
        'thread_priority': PRIORITY,
        'enforce_command_limits': False,
    }
    write_parameters(bench.folder / 'feedforward.yaml', given)
    bench.start_node('feedforward')
    message = serialize_message(Float64MultiArray(data=[0.0] * len(joints)))
    topic = {'topic': '/bare/commands', 'type': 'std_msgs/msg/Float64MultiArray', 'depth': 1}
    spec = {
        'name': 'bare',
        'publish': [{**topic, 'stamped': False, 'raw': message.hex()}],
        'listen': [{'topic': '/joint_states', 'type': 'sensor_msgs/msg/JointState'}],
        'parameters': [row.partition(':')[0] for row in ASKED['bare']],
        'rate': LOOP_RATE,
        'priority': PRIORITY,
    }
    file = bench.folder / 'bare.json'
    file.write_text(json.dumps(spec))
    bench.processes.start_bare('bare', file)
    for name, ranges in ASKED.items():
        log = str(bench.folder / f'{name}_requests.json')
        arguments = ['bench.loops.requester', log, name, str(REQUEST_RATE), *ranges]
        bench.processes.start_plain(f'{name}_requester', arguments)
    bench.driver.wait_active('feedforward', START_TIMEOUT)
    if not bench.driver.until((bench.folder / 'bare.ready').exists, START_TIMEOUT):
        raise DenocError('bare node: must find its listener')


@contextmanager
def going_on(bench: Bench, kind: str) -> Iterator[None]:
    """Let a kind of block be; the node whose turn it is not stands still."""
    turn, other = ('bare', 'feedforward') if kind == 'bare' else ('feedforward', 'bare')
    bench.processes.signal(other, signal.SIGSTOP)
    if kind != 'quiet':
        bench.tell(f'{turn}_requester', True)
    bench.driver.wait(SETTLING)
    try:
        yield
    finally:
        if kind != 'quiet':
            bench.tell(f'{turn}_requester', False)
        bench.processes.signal(other, signal.SIGCONT)
        bench.driver.wait(0.5 * SETTLING)


def lateness(minutes: float, block: float = BLOCK) -> Found:
    """Run blocks of all kinds in turn.

    Parameters
    ----------
    minutes : float
        Under requests; each other kind takes a third of that besides.
    block : float
        Length of one under requests [s].
    """
    config = load_config('config/ssrms.yaml')
    joints = list(load_robot(config.robot).joint_names)
    found, windows = Found(), list[tuple[str, float, float]]()
    with benched(config.robot.read_text()) as bench:
        start(bench, joints, list(config.gravity))
        for _ in range(max(1, round(60.0 * minutes / block))):
            for kind, share in SHARES.items():
                with going_on(bench, kind):
                    if kind != 'bare':
                        given = {**config.reference, 'duration': share * block + 2.0 * SETTLING}
                        trajectory = trajectory_from_config(given, joints)
                        bench.driver.publish_reference(trajectory, joints, in_a_moment(), 1)
                        bench.driver.wait(0.2)
                    begin = time.perf_counter()
                    bench.driver.wait(share * block)
                    windows.append((kind, begin, time.perf_counter()))
        for name in ASKED:
            bench.processes.stop(f'{name}_requester')
        bench.processes.stop_all(())
        loops = {name: read(bench.folder / f'{name}.npz') for name in ASKED}
        for name in ASKED:
            found.asked[name] = json.loads((bench.folder / f'{name}_requests.json').read_text())
    for kind, begin, end in windows:
        entries = loops['bare' if kind == 'bare' else 'feedforward']
        found.late[kind].append(entries.late_in(kind, begin, end))
    return found


def main(argv: Sequence[str] | None = None) -> int:
    """Run the bench; return the exit status: 0, 1 an error, 2 unanswered or refused requests."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--minutes', type=float, default=10.0, help='under requests')
    parser.add_argument('--block', type=float, default=BLOCK, help='seconds of a block, up to 15')
    parser.add_argument('--json', action='store_true', help='print machine-readable JSON')
    args = parser.parse_args(argv)
    return say('request_lateness', lambda: lateness(args.minutes, args.block), args.json)


if __name__ == '__main__':
    sys.exit(main())
