"""Ends of nodes: from every phase of their life, by every signal, once and twice in a row.

`python -m campaigns ends --count 500` ends each node so often and prints how many ends had
another status than 0, left words on stderr that none should, or came late; and what is left in
shared memory. Each end is preceded by a start that must come to its phase: after an end that left
something broken the next start would not.
"""

from __future__ import annotations

import argparse
import random
import re
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from node_robots import GRAVITY
from trust.stage import PARAMETERS, PATIENCE, Stage, StageError, staged
from trust.zygote import NODES, Zygote

from denoc_ros.cli.session.node_parameters import write_parameters
from denoc_ros.parts import node_main

SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
PHASES = ('importing', 'starting', 'waiting', 'inactive', 'active', 'working')
LONGEST_END = 20.0  # s; on a busy machine
BAD_WORDS = re.compile(r'Traceback|terminate called|Aborted|Fatal Python|free\(\)|malloc|corrupt')
HEARD = {'recorder': 'recording', 'viewer': 'page'}  # status that says that a node is active
SHARED = Path('/dev/shm')
ASK_AGAIN = 20.0  # s; on a busy machine a node takes some to configure itself


@dataclass
class Tally:
    """What came of the ends of one node."""

    ends: Counter[str] = field(default_factory=Counter)  # by phase
    bad: list[str] = field(default_factory=list)
    longest: float = 0.0  # s from the signal to the end

    def line(self, node: str) -> str:
        phases = ', '.join(f'{phase} {self.ends[phase]}' for phase in PHASES if self.ends[phase])
        total = self.ends.total()
        return (
            f'{node}: {total} ends, {len(self.bad)} bad ({phases}), longest {self.longest:.2f} s'
        )


class Ends:
    """Starts nodes on a stage and ends them."""

    def __init__(self, stage: Stage, zygote: Zygote, rng: random.Random) -> None:
        self.stage, self._zygote, self._rng = stage, zygote, rng
        self._count = 0

    def once(self, node: str, phase: str, tally: Tally) -> None:
        """Start a node, end it from a phase, and judge the end."""
        self._count += 1
        log = self.stage.folder / f'{node}-{self._count}.log'
        log.touch()
        process = self._started(node, phase, log)
        numbers = self._rng.choices(SIGNALS, k=self._rng.choice([1, 2]))
        what = f'{node} {phase} {"+".join(signal.Signals(n).name for n in numbers)}'
        try:
            self._come_to(node, phase, log)
            time.sleep(self._rng.uniform(0.0, 0.3))
            began = time.perf_counter()
            for number in numbers:
                with suppress(ProcessLookupError):
                    process.send_signal(number)
                time.sleep(self._rng.uniform(0.0, 0.2) if len(numbers) > 1 else 0.0)
            self.stage.until(lambda: process.poll() is not None, LONGEST_END, 'the end')
            tally.longest = max(tally.longest, time.perf_counter() - began)
        except StageError as error:
            tally.bad.append(f'{what}: {error}\n{log.read_text()}')
            with suppress(ProcessLookupError):
                process.send_signal(signal.SIGKILL)
        tally.ends[phase] += 1
        said = log.read_text()
        if process.poll() not in (0, None) or BAD_WORDS.search(said):
            tally.bad.append(f'{what}: status {process.poll()}\n{said}')
        log.unlink()

    def _started(self, node: str, phase: str, log: Path) -> Any:
        parameters = self._parameters(node)
        if phase == 'waiting':
            parameters.pop('urdf_path', None)
        parameters['autostart'] = phase != 'inactive'
        file = self.stage.folder / f'{node}.yaml'
        write_parameters(file, parameters)
        arguments = ['--ros-args', '--params-file', str(file)]
        arguments += ['-r', 'joint_states:=plant/joint_states'] if node == 'plant' else []
        if phase != 'importing':
            return self._zygote.start(node, arguments, log)
        self.stage.processes.start(node, ['-m', node_main(node), *arguments])
        return self.stage.processes._running.pop(node)

    def _parameters(self, node: str) -> dict[str, Any]:
        robot = {'urdf_path': str(self.stage.urdf), 'gravity': GRAVITY}
        return {
            'feedforward': {**PARAMETERS, **robot},
            'predictor': {**robot, 'update_rate': 500.0},
            'plant': {**robot, 'update_rate': 500.0},
            'viewer': {**robot, 'port': 0},
            'shaper': {**robot, 'update_rate': 500.0},
            'recorder': {
                'output': str(self.stage.folder / f'run-{self._count}'),
                'topics': ['/joint_states'],
            },
        }[node]

    def _come_to(self, node: str, phase: str, log: Path) -> None:
        """Wait until a node is in a phase of its life."""
        if phase == 'importing':
            words = self.stage.folder / 'logs' / f'{node}.log'
            self.stage.until(
                lambda: f'{node}: starting' in words.read_text(), PATIENCE, 'a first word'
            )
            words.write_text('')
        elif phase == 'starting':
            self.stage.until(lambda: 'starting' in log.read_text(), PATIENCE, 'a first word')
            time.sleep(self._rng.uniform(0.0, 0.7))
        elif phase == 'waiting':
            self.stage.until(lambda: 'waiting for' in log.read_text(), PATIENCE, 'waiting')
        elif phase == 'inactive':
            self._configure(node)
        else:
            self._come_to_life(node, phase)

    def _configure(self, node: str) -> None:
        """Ask a node to configure itself, again where the request was lost."""
        client = self.stage.node.create_client(ChangeState, f'/{node}/change_state')
        request = ChangeState.Request(transition=Transition(id=1))
        self.stage.until(client.service_is_ready, PATIENCE, f'{node}: its service')
        futures: list[Any] = []

        def answered() -> bool:
            if len(futures) < (time.perf_counter() - began) / ASK_AGAIN:
                futures.append(client.call_async(request))
            return any(future.done() for future in futures)

        began = time.perf_counter()
        self.stage.until(answered, PATIENCE, f'{node}: a reply')
        self.stage.node.destroy_client(client)

    def _come_to_life(self, node: str, phase: str) -> None:
        if node == 'feedforward' and phase == 'working':
            self.stage.follow(PATIENCE)
            return
        since = time.time()
        status = f'{node}: {HEARD.get(node, "loop")}'
        self.stage.until(lambda: self.stage.heard_at(status) > since, PATIENCE, f'{status}')


def phases(node: str) -> tuple[str, ...]:
    """Return the phases that a node has."""
    return tuple(phase for phase in PHASES if node != 'recorder' or phase != 'waiting')


@contextmanager
def ending(folder: Path, seed: int) -> Iterator[Ends]:
    """Give a stage on which nodes are ended."""
    with staged(folder) as stage:
        zygote = Zygote(stage.urdf, stage.environment)
        try:
            yield Ends(stage, zygote, random.Random(seed))
        finally:
            zygote.close()


def shared_memory() -> int:
    """Return how many files of the middleware are in shared memory."""
    return sum('fastrtps' in path.name for path in SHARED.iterdir())


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--count', type=int, default=500, help='ends of each node')
    parser.add_argument('--minutes', type=float, default=1e9, help='at most')
    parser.add_argument('--nodes', nargs='*', default=list(NODES), choices=NODES)
    parser.add_argument('--phases', nargs='*', default=list(PHASES), choices=PHASES)
    parser.add_argument('--seed', type=int, default=random.randrange(1 << 30))
    args = parser.parse_args(argv)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # nohup's deafness would be inherited
    print(f'seed {args.seed}', flush=True)
    tallies = {node: Tally() for node in args.nodes}
    before, end = shared_memory(), time.perf_counter() + 60.0 * args.minutes
    with (
        tempfile.TemporaryDirectory(prefix='ends-') as folder,
        ending(Path(folder), args.seed) as ends,
    ):
        for k in range(args.count):
            if time.perf_counter() > end:
                break
            for node, tally in tallies.items():
                bad = len(tally.bad)
                choices = [phase for phase in phases(node) if phase in args.phases]
                ends.once(node, choices[k % len(choices)], tally)
                for text in tally.bad[bad:]:
                    print(f'BAD: {text}', flush=True)
            if k % 10 == 9:
                print('; '.join(tally.line(node) for node, tally in tallies.items()), flush=True)
    for node, tally in tallies.items():
        print(tally.line(node))
    print(f'shared memory: {before} files before, {shared_memory()} after')
    return 2 if any(tally.bad for tally in tallies.values()) else 0


if __name__ == '__main__':
    sys.exit(main())
