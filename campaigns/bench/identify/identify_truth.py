"""`denoc identify model` on random robots whose truth is known, blind: what it finds, and says.

Run with `python -m campaigns identification`.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from truth_robots import truth_case
from truth_runs import truth_run
from truth_scores import NumberScore, is_rightly_refused, scored, summary

import denoc_ros as dn
from denoc_ros.text_table import text_table

NICENESS = 10
LIMITS = 'median error <= 0.005, coverage 0.92 .. 0.98, untold_found 0'

Document = dict[str, Any]


def identified(seed: int, duration: float = 4.0) -> Document:
    """Return how one robot's identification went.

    Parameters
    ----------
    seed : int
        Of robot, truth, motion and noise.
    duration : float
        Of the recording [s].
    """
    case = truth_case(seed)
    run = truth_run(case, duration)
    began = time.process_time()
    found = dn.identify_model(case.robot, run.recording, case.free)
    seconds = time.process_time() - began
    return {
        'seed': seed,
        'joints': len(case.robot.joint_names),
        'coordinates': case.robot.n,
        'trap': case.trap,
        'held': case.held,
        'processor_seconds': seconds,
        'evaluations': found.evaluations,
        'reasons': list(found.reasons),
        'combinations': found.combinations,
        'numbers': [asdict(score) for score in scored(case, run, found)],
    }


def totals(robots: Sequence[Document]) -> Document:
    """Return the measures over all robots.

    `refused` counts those whose refusal names a sensor that, in truth, shows rounding alone;
    `failed` all other errors.
    """
    scores = [NumberScore(**number) for robot in robots for number in robot.get('numbers', ())]
    times = [robot['processor_seconds'] for robot in robots if 'processor_seconds' in robot]
    return {
        'robots': len(robots),
        'refused': sum(robot.get('is_rightly_refused', False) for robot in robots),
        'failed': sum(
            'error' in robot and not robot.get('is_rightly_refused', False) for robot in robots
        ),
        **summary(scores),
        'median_processor_seconds': float(np.median(times)) if times else float('nan'),
    }


def by_kind(robots: Sequence[Document]) -> list[Document]:
    """Return the measures of each kind of number."""
    kinds: dict[str, list[NumberScore]] = {}
    for robot in robots:
        for number in robot.get('numbers', ()):
            kinds.setdefault(kind_of(number['path']), []).append(NumberScore(**number))
    return [{'kind': kind, **summary(scores)} for kind, scores in sorted(kinds.items())]


def kind_of(path: str) -> str:
    """Return a path without its name, such as `beam ei`, `sensor offset`, `link inertia`."""
    kind, _, rest = path.partition('.')
    term = rest.partition('.')[2]
    return f'{kind} {term.removeprefix("y.").removeprefix("z.").partition(".")[0]}'.strip()


def _attempt(seed: int, duration: float) -> Document:
    """Return what `identified` does, or the error, and whether the truth agrees with it."""
    try:
        return identified(seed, duration)
    except dn.DenocError as error:
        message = str(error)
    run = truth_run(truth_case(seed), duration)
    is_right = is_rightly_refused(run, message)
    return {'seed': seed, 'error': message, 'is_rightly_refused': is_right}


def campaign(
    seeds: Sequence[int], duration: float, workers: int, minutes: float, output: Path | None
) -> list[Document]:
    """Return the results of robots, as many as are done in time; the file grows with each.

    Robots that the file has already are not worked out again.
    """
    robots: list[Document] = []
    if output is not None and output.exists():
        robots = json.loads(output.read_text(encoding='utf-8'))['robots']
    done = {robot['seed'] for robot in robots}
    until = time.monotonic() + 60.0 * minutes
    context = multiprocessing.get_context('spawn')
    with ProcessPoolExecutor(workers, context, os.nice, (NICENESS,)) as pool:
        waiting = {pool.submit(_attempt, seed, duration) for seed in seeds if seed not in done}
        try:
            for ended in as_completed(waiting, max(until - time.monotonic(), 0.0)):
                robots.append(ended.result())
                _report(robots, output)
        except TimeoutError:
            for future in waiting:
                future.cancel()
    return robots


def _report(robots: Sequence[Document], output: Path | None) -> None:
    found = totals(robots)
    print(' '.join(f'{key} {_short(value)}' for key, value in found.items()), flush=True)
    if output is not None:
        output.parent.mkdir(parents=True, exist_ok=True)
        document = {'totals': found, 'kinds': by_kind(robots), 'robots': list(robots)}
        output.write_text(json.dumps(document, indent=1), encoding='utf-8')


def _short(value: float) -> str:
    return f'{value:.4g}'


def main() -> int:
    """Run the campaign; the exit status says whether the limits hold."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--count', type=int, default=100)
    parser.add_argument('--first', type=int, default=0, help='the first seed')
    parser.add_argument('--duration', type=float, default=4.0, help='of each recording [s]')
    parser.add_argument('--workers', type=int, default=2)
    parser.add_argument('--minutes', type=float, default=120.0, help='no new result after that')
    parser.add_argument(
        '--json', type=Path, help='all results; robots that it has stay as they are'
    )
    args = parser.parse_args()
    # matrices are small: more threads wait for each other, which counts as processor time
    os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
    seeds = range(args.first, args.first + args.count)
    robots = campaign(seeds, args.duration, args.workers, args.minutes, args.json)
    rows = [
        {key: _short(v) if key != 'kind' else v for key, v in r.items()} for r in by_kind(robots)
    ]
    print(text_table(rows) if rows else 'no robot has numbers')
    found = totals(robots)
    good = (
        found['median_error'] <= 0.005
        and 0.92 <= found['coverage'] <= 0.98
        and not found['untold_found']
        and not found['failed']
    )
    print(f'{"within" if good else "outside"} the limits: {LIMITS}')
    return 0 if good else 1


if __name__ == '__main__':
    raise SystemExit(main())
