"""Failures of `denoc up`: a node is killed, stopped or starved in a phase; the report tells of it.

`python -m campaigns session-failures --count 20` prints each, and how many sessions ended
otherwise than with a report of all that came before, the cause named, and status 1.
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
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from bench.loops.rates_blocks import domain
from node_robots import two_links
from trust.endings.ends_campaign import BAD_WORDS
from trust.endings.session_ends import left_over

from denoc_ros.bags.reader import bag_topics
from denoc_ros.parts import node_main

PATIENCE = 240.0  # s
NODES = ('recorder', 'plant', 'predictor', 'feedforward')
HARMS = ('killed', 'stopped', 'starved')
SAID = {'killed': 'SIGKILL', 'stopped': 'stopped', 'starved': 'starve'}
PHASES = ('first', 'second', 'third')
LASTING = 16.0  # s of the phase that is spoiled: starving shows after some
BUSY = 'while True: pass'
SESSION = """
robot: arm.urdf
time: real
reference: {kind: sine, amplitude: 0.2, frequency: 0.5, duration: DURATION}
nodes:
  plant: {update_rate: 200}
  predictor: {update_rate: 200}
  feedforward: {update_rate: 200}
# The plant drifts while nobody commands it: the harm is to be found, and not the drift.
plant: {position_margin: 1000.0}
phases: [{name: first}, {name: second, feedforward: {model: rigid}}, {name: third}]
"""


def session(folder: Path, name: str, environment: dict[str, str]) -> subprocess.Popen[str]:
    """Start a session of three phases in real time."""
    command = [sys.executable, '-m', 'denoc_ros.cli.main', 'up', str(folder / f'{name}.yaml')]
    return subprocess.Popen(
        [*command, '--output', str(folder / name)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, **environment},
        text=True,
    )


def process_of(folder: Path, node: str) -> int:
    """Return the process of a session's node."""
    for entry in Path('/proc').iterdir():
        with suppress(OSError):
            line = (entry / 'cmdline').read_text().split('\0')
            if node_main(node) in line and any(f'{folder}/' in each for each in line):
                return int(entry.name)
    raise AssertionError(f'no process of {node}')


@contextmanager
def starving(pid: int) -> Iterator[None]:
    """Leave a process what a busy one on the same core does not take: next to nothing."""
    core = min(os.sched_getaffinity(0))
    busy = subprocess.Popen([sys.executable, '-c', BUSY], start_new_session=True)
    os.sched_setaffinity(busy.pid, {core})
    try:
        # Linux shares a core among sessions first
        Path(f'/proc/{pid}/autogroup').write_text('19')
        Path(f'/proc/{busy.pid}/autogroup').write_text('-10')
        for task in Path(f'/proc/{pid}/task').iterdir():
            with suppress(OSError):
                os.sched_setaffinity(int(task.name), {core})
        yield
    finally:
        busy.kill()
        busy.wait()


def spoil(
    folder: Path,
    name: str,
    environment: dict[str, str],
    case: tuple[str, str, int],
    without: str = '',
) -> str:
    """Run a session and do harm to a node in a phase; return what is wrong with its end.

    A node that the session is `without` takes no part in it.
    """
    node, harm, k = case
    text = SESSION.replace('DURATION', str(LASTING if harm == 'starved' else 2.0))
    if without:
        text = text.replace(f'{without}: {{update_rate: 200}}', f'{without}: false')
    (folder / f'{name}.yaml').write_text(text)
    with session(folder, name, environment) as process, ExitStack() as harms:
        assert process.stderr is not None
        heard = []
        for line in process.stderr:
            heard.append(line)
            if line.startswith(f'{PHASES[k]}:'):
                break
        else:
            return 'it ended before the phase:\n' + ''.join(heard)
        time.sleep(1.2)  # the phase is on
        pid = process_of(folder / name, node)
        if harm == 'starved':
            harms.enter_context(starving(pid))
        else:
            os.kill(pid, signal.SIGKILL if harm == 'killed' else signal.SIGSTOP)
        out, err = process.communicate(timeout=PATIENCE)
    return '; '.join(_wrong(folder / name, process.returncode, ''.join(heard) + err, out, case))


def _wrong(
    run: Path, status: int, err: str, out: str, case: tuple[str, str, int]
) -> Iterator[str]:
    """Yield what is wrong with the end of a session."""
    node, harm, k = case
    if status != 1:
        yield f'status {status}'
    if f'denoc up: {node}: ' not in err or SAID[harm] not in err or BAD_WORDS.search(err):
        yield f'said\n{err}'
    for file in ('report.html', 'summary.json', 'bag/metadata.yaml'):
        if not (run / file).is_file():
            yield f'no {file}: {err}'
            return
    page = (run / 'report.html').read_text()
    summary = json.loads((run / 'summary.json').read_text())
    if f'ended in phase “{PHASES[k]}”' not in page or f'{node}: ' not in page:
        yield 'no cause on the page'
    if not summary.get('failure', '').startswith(f'{node}: '):
        yield f'failure {summary.get("failure")!r}'
    if list(summary['phases']) != [*PHASES[:k], f'{PHASES[k]} (unfinished)']:
        yield f'phases {list(summary["phases"])}'
    for phase in PHASES[:k]:
        if 'joint_error_rms' not in summary['phases'].get(phase, {}):
            yield f'no figures of {phase}'
    if f'report  {run / "report.html"}' not in out:
        yield f'printed {out}'
    if '/joint_states' not in bag_topics(run / 'bag'):
        yield 'no joint states in the bag'
    yield from left_over(run)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--count', type=int, default=20)
    parser.add_argument('--seed', type=int, default=random.randrange(1 << 30))
    args = parser.parse_args(argv)
    print(f'seed {args.seed}', flush=True)
    rng = random.Random(args.seed)
    cases = [(node, harm, k) for node in NODES for harm in HARMS for k in range(len(PHASES))]
    rng.shuffle(cases)
    bad = 0
    with tempfile.TemporaryDirectory(prefix='failures-') as place, domain() as environment:
        folder = Path(place)
        (folder / 'arm.urdf').write_text(two_links())
        for count in range(args.count):
            case = cases[count % len(cases)]
            began = time.perf_counter()
            wrong = spoil(folder, f'run-{count}', dict(environment), case)
            bad += bool(wrong)
            node, harm, k = case
            what = f'{node} {harm} in the {PHASES[k]} phase, {time.perf_counter() - began:.0f} s'
            print(f'{what}: {"BAD: " + wrong if wrong else "reported"}', flush=True)
    print(f'denoc up: {args.count} failures, {bad} bad')
    return 2 if bad else 0


if __name__ == '__main__':
    sys.exit(main())
