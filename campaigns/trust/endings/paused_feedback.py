"""State feedback of `denoc up` while the system stops its processes in the middle of the motion.

`python -m campaigns pauses --seconds 0.1 --times 3` runs the last phase of config/tip.yaml
(a wrong model, with state feedback): once without a pause, then with SIGSTOP for the feedforward,
for the plant and for both. It prints how far the tip is from its reference.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import yaml
from bench.loops.rates_blocks import domain

from denoc_ros.parts import node_main

CONFIG = Path(__file__).resolve().parents[3] / 'config'
CHOICES: dict[str, tuple[str, ...]] = {
    'none': (),
    'feedforward': ('feedforward',),
    'plant': ('plant',),
    'both': ('feedforward', 'plant'),
}
BEGIN, END = 2.0, 8.0  # s after the feedforward is active: the arm moves
PATIENCE = 300.0  # s
LOST = 0.1  # m off at rest: the arm is lost


def configuration() -> dict[str, Any]:
    """Return a session of the last phase of config/tip.yaml."""
    given: dict[str, Any] = yaml.safe_load((CONFIG / 'tip.yaml').read_text())
    given['robot'] = str(CONFIG / given['robot'])
    given['phases'] = given['phases'][-1:]
    return given


def processes(node: str, run: Path) -> list[int]:
    """Return the processes of a node of a run."""
    found = []
    for entry in Path('/proc').glob('[0-9]*'):
        with suppress(OSError):
            words = (entry / 'cmdline').read_text()
            if f'{node_main(node)}\0' in words and str(run) in words:
                found.append(int(entry.name))
    return found


def pause(nodes: Sequence[str], run: Path, seconds: float, moments: Sequence[float]) -> int:
    """Stop nodes at moments [s from now]; return how often a process was stopped."""
    began, stopped = time.perf_counter(), 0
    pids = [pid for node in nodes for pid in processes(node, run)]
    for moment in sorted(moments):
        time.sleep(max(0.0, began + moment - time.perf_counter()))
        for number in (signal.SIGSTOP, signal.SIGCONT):
            for pid in pids:
                with suppress(ProcessLookupError):
                    os.kill(pid, number)
                    stopped += number == signal.SIGSTOP
            time.sleep(seconds if number == signal.SIGSTOP else 0.0)
    return stopped


def measured(
    session: Path, run: Path, nodes: Sequence[str], seconds: float, moments: Sequence[float]
) -> tuple[dict[str, Any], int]:
    """Run a session with pauses; return the summary of its phase, and how many pauses it had."""
    command = [sys.executable, '-m', 'denoc_ros.cli.main', 'up', '--time', 'real', str(session)]
    with subprocess.Popen(
        [*command, '--output', str(run)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stderr is not None
        words, stopped = '', 0
        for line in process.stderr:
            words += line
            if line.startswith('feedforward: active'):
                stopped = pause(nodes, run, seconds, moments)
        if process.wait(PATIENCE) != 0:
            raise SystemExit(f'denoc up must end with status 0, got {process.returncode}\n{words}')
    (summary,) = json.loads((run / 'summary.json').read_text())['phases'].values()
    return summary, stopped


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--seconds', type=float, default=0.1, help='length of a pause')
    parser.add_argument('--times', type=int, default=3, help='pauses in one motion')
    parser.add_argument('--stop', nargs='*', choices=CHOICES, default=list(CHOICES))
    parser.add_argument('--seed', type=int, default=random.randrange(1 << 30))
    args = parser.parse_args(argv)
    print(f'seed {args.seed}', flush=True)
    rng, lost = random.Random(args.seed), 0
    with tempfile.TemporaryDirectory(prefix='paused-') as place, domain() as environment:
        os.environ.update(environment)
        folder = Path(place)
        (folder / 'session.yaml').write_text(yaml.safe_dump(configuration()))
        for name in args.stop:
            moments = [rng.uniform(BEGIN, END) for _ in range(args.times)]
            summary, stopped = measured(
                folder / 'session.yaml', folder / name, CHOICES[name], args.seconds, moments
            )
            moving = summary['tip_error_moving']['max']
            settled = summary['tip_error_settled']['max']
            lost += settled > LOST
            print(
                f'{name}: {stopped} stops of {args.seconds:g} s; tip off by at most '
                f'{1e3 * moving:.3g} mm while moving, '
                f'{1e3 * settled:.3g} mm from 3 s after the stop',
                flush=True,
            )
    return 2 if lost else 0


if __name__ == '__main__':
    sys.exit(main())
