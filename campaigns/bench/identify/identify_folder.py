"""Throughput of `denoc identify modal` over a folder: local workers against one process.

Run as `python -m campaigns folder [RECORDS] [WORKERS]`. Rounds
alternate, so that what else the machine does falls on both; processor time counts what a record
costs, with scheduling, transport and the start of the workers.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

from denoc_ros.runtime.loop.realtime import SINGLE_THREADED
from denoc_ros.text_table import Row

# as the workers have it; numpy reads it when it is imported
os.environ.update(SINGLE_THREADED)

import numpy as np
from book.selftest import Defects, Truth, synthetic_decay

from denoc_ros.cli.main import build_parser
from denoc_ros.cli.many_runs import FAILURE, WorkerConfig
from denoc_ros.identification.verbs.identify_records import MODAL, decay_options
from denoc_ros.identification.verbs.identify_rows import identify_all

ROUNDS = 2
BAG = Defects(40.0, offset=0.1, drift=0.05, jitter=0.1, lost=0.05)


def write_decays(folder: Path, count: int) -> list[Path]:
    """Write short decays of two modes as tables."""
    draw = np.random.default_rng(1)
    paths = []
    for k in range(count):
        first, second = draw.uniform(2.0, 4.0), draw.uniform(8.0, 14.0)
        modes = [Truth(first, 0.01, 1.0, 0.3), Truth(second, 0.02, 0.5, 1.0)]
        record = synthetic_decay(modes, 100.0, 4.0, BAG, draw).record
        paths.append(folder / f'decay-{k:04d}.csv')
        table = np.column_stack((record.t, record.y))
        np.savetxt(paths[-1], table, delimiter=',', header='time,y', comments='')
    return paths


def measure(paths: list[Path], workers: WorkerConfig) -> tuple[float, float, list[Row]]:
    """Return elapsed and processor time per record [s], and the rows."""
    args = build_parser(['identify', 'modal']).parse_args(['identify', 'modal', 'folder'])
    before, began = sum(os.times()[:4]), time.perf_counter()
    rows = identify_all(MODAL, decay_options(args), paths, workers)
    elapsed = time.perf_counter() - began
    assert not any(row[FAILURE] for row in rows), rows[0][FAILURE]
    return elapsed / len(paths), (sum(os.times()[:4]) - before) / len(paths), rows


def main() -> None:
    """Measure and print."""
    count, workers = (int(a) for a in (*sys.argv[1:], '500', '2')[:2])
    with tempfile.TemporaryDirectory() as folder:
        paths = write_decays(Path(folder), count)
        measure(paths[:5], WorkerConfig())  # imports
        setups = {'one process': WorkerConfig(), f'{workers} workers': WorkerConfig(workers)}
        found: dict[str, list[tuple[float, float, float]]] = {name: [] for name in setups}
        for _ in range(ROUNDS):
            for name, config in setups.items():
                elapsed, processor, rows = measure(paths, config)
                of_task = float(np.median([row['processor_s'] for row in rows]))
                found[name].append((elapsed, processor, of_task))
                print(
                    f'{name}: {1e3 * elapsed:.1f} ms elapsed, {1e3 * processor:.1f} ms of '
                    f'processor per record, {1e3 * of_task:.1f} ms in the task'
                )
    one, several = (np.min(rows, axis=0) for rows in found.values())
    print(f'throughput per core: {100.0 * one[2] / several[2]:.1f} % of one process once running,')
    print(f'{100.0 * one[1] / several[1]:.1f} % with the start of the workers')
    print(f'elapsed: {one[0] / several[0]:.2f} times as fast with {workers} workers')


if __name__ == '__main__':
    main()
