"""Ends of `denoc up`: interrupted at any moment, above all while it enters the graph.

`python -m campaigns session-ends --count 100` prints how many ended otherwise than interrupted,
and their messages.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from bench.loops.rates_blocks import domain
from node_robots import two_links
from trust.endings.ends_campaign import BAD_WORDS, SIGNALS

INTERRUPTED = 130
PATIENCE = 240.0  # s
SESSION = """
robot: arm.urdf
time: real
reference: {kind: sine, amplitude: 0.2, frequency: 0.5, duration: 2}
"""


def session(folder: Path, environment: dict[str, str], name: str) -> subprocess.Popen[str]:
    command = [sys.executable, '-m', 'denoc_ros.cli.main', 'up', str(folder / 'session.yaml')]
    return subprocess.Popen(
        [*command, '--output', str(folder / name)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env={**os.environ, **environment},
        text=True,
    )


def start_time(folder: Path, environment: dict[str, str]) -> float:
    """Return how long a session takes until its first node runs [s]."""
    began = time.perf_counter()
    with session(folder, environment, 'first') as process:
        while not (folder / 'first' / 'logs').exists() or not any(
            (folder / 'first' / 'logs').iterdir()
        ):
            assert process.poll() is None, process.communicate()[0]
            assert time.perf_counter() - began < PATIENCE
            time.sleep(0.02)
        took = time.perf_counter() - began
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=PATIENCE)
    return took


def left_over(folder: Path) -> list[str]:
    """Return the command lines of processes that still work on a folder."""
    found = []
    for entry in Path('/proc').iterdir():
        with suppress(OSError):
            line = (entry / 'cmdline').read_text().replace('\0', ' ')
            if entry.name != str(os.getpid()) and f'{folder}/' in line:
                found.append(line)
    return found


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--count', type=int, default=100)
    parser.add_argument('--seed', type=int, default=random.randrange(1 << 30))
    args = parser.parse_args(argv)
    for number in (signal.SIGHUP, signal.SIGINT):  # the shell's deafness would be inherited
        signal.signal(number, signal.SIG_DFL)
    print(f'seed {args.seed}', flush=True)
    rng = random.Random(args.seed)
    statuses: Counter[int] = Counter()
    bad = 0
    with tempfile.TemporaryDirectory(prefix='session-ends-') as place, domain() as environment:
        folder = Path(place)
        (folder / 'arm.urdf').write_text(two_links())
        (folder / 'session.yaml').write_text(SESSION)
        usual = start_time(folder, dict(environment))
        print(f'its first node runs after {usual:.2f} s', flush=True)
        for k in range(args.count):
            process = session(folder, dict(environment), f'run-{k}')
            moment = usual * rng.uniform(0.3, 1.5)
            time.sleep(moment)
            sent = rng.choice(SIGNALS)
            process.send_signal(sent)
            if rng.random() < 0.5:
                time.sleep(rng.uniform(0.0, 0.5))
                process.send_signal(signal.SIGINT)
            said, _ = process.communicate(timeout=PATIENCE)
            statuses[process.returncode] += 1
            rest = left_over(folder)
            # before its first word a process ends as any does that is told to
            begun = process.returncode == INTERRUPTED or 'loading' in said
            right = process.returncode == (INTERRUPTED if begun else -sent)
            if not right or BAD_WORDS.search(said) or rest:
                bad += 1
                print(
                    f'BAD: {moment:.2f} s: status {process.returncode}\n{said}{rest}', flush=True
                )
            elif k % 10 == 9:
                print(f'{k + 1} ends: {dict(statuses)}', flush=True)
    print(f'denoc up: {statuses.total()} ends, {bad} bad; by status {dict(statuses)}')
    return 2 if bad else 0


if __name__ == '__main__':
    sys.exit(main())
