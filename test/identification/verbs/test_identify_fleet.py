"""`denoc identify model --each`: a fleet's recordings in one table, whoever works and dies."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from identification_runs import recorded, sweeping

import denoc_ros as dn
from denoc_ros.cli.main import build_parser, main
from denoc_ros.cli.many_runs import FAILURE, RowStore
from denoc_ros.identification.verbs.identify_model import model_options, model_rows

ROBOT = Path(__file__).resolve().parents[3] / 'config' / 'robots' / 'rigid_pendulum.urdf'
DAMPING = [0.02, 0.03, 0.04, 0.05, 0.06, 0.07]
PATH = 'joint.joint_1.damping'
BOUND = 180.0  # s: a start of three interpreters on a busy machine


@pytest.fixture(scope='module')
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of tables: pendulums of one kind, each with a damping of its own."""
    folder = tmp_path_factory.mktemp('fleet')
    robot = dn.load_robot(ROBOT)
    for k, damping in enumerate(DAMPING):
        run = recorded(robot.with_overrides({PATH: damping}), sweeping(1, k), 3.0, seed=k)
        assert run.velocity is not None
        rows = np.column_stack((run.t, run.position, run.velocity, run.effort))
        names = 'time,joint_1/position,joint_1/velocity,joint_1/effort'
        np.savetxt(folder / f'arm-{k}.csv', rows, delimiter=',', header=names, comments='')
    return folder


def words(fleet: Path, output: Path) -> list[str]:
    given = ['identify', 'model', str(fleet), '--robot', str(ROBOT), '--free', PATH, '--json']
    return [*given, '--each', '-o', str(output)]


def require_each_damping(rows: list[dict[str, Any]]) -> None:
    assert [row[FAILURE] for row in rows] == [''] * len(DAMPING)
    for row, wanted in zip(rows, DAMPING, strict=True):
        # 600 samples with noise of 0.2 %: some 0.1 %
        assert row[PATH] == pytest.approx(wanted, rel=0.01)
        assert row[f'{PATH} verdict'] == 'found'


def test_each_recording_has_a_row_and_a_bad_one_says_why(
    fleet: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / 'bad.csv'
    bad.write_text('time,elbow\n' + '\n'.join(f'{k},{k}' for k in range(99)))
    told = words(fleet, tmp_path / 'rows')
    assert main([*told[:3], str(bad), *told[3:]]) == 2
    rows = json.loads(capsys.readouterr().out)['rows']
    require_each_damping(rows[:-1])
    assert 'table must have the position of a joint' in rows[-1][FAILURE]
    for row, wanted in zip(rows, DAMPING, strict=False):
        assert row[f'{PATH} from'] < wanted < row[f'{PATH} to']
    # again: stored rows are not worked out anew; text for people has a column for the number
    files = sorted((tmp_path / 'rows').iterdir())
    assert main([word for word in told if word != '--json']) == 0
    assert PATH in capsys.readouterr().out
    assert sorted((tmp_path / 'rows').iterdir()) == files


def test_one_file_for_many_models_is_refused(
    fleet: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*words(fleet, tmp_path / 'rows'), '--apply', str(tmp_path / 'new.urdf')]) == 1
    assert '--apply must come with one model' in capsys.readouterr().err


@pytest.mark.long
def test_a_worker_killed_half_way_loses_no_row(
    fleet: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with cluster(tmp_path) as (address, workers):
        from distributed import Client

        told = [*words(fleet, tmp_path / 'rows'), '--scheduler', address]
        found: list[int] = []
        work = threading.Thread(target=lambda: found.append(main(told)), daemon=True)
        with contextlib.closing(Client(address, timeout=BOUND)) as client:
            pids = awaited(lambda: client.run(os.getpid), lambda got: len(got) == len(workers))
            work.start()
            # stopped while it has work, killed once the other has done some of the rest
            busy = awaited(lambda: held(client), bool)
            victim = pids[busy]
            os.kill(victim, signal.SIGSTOP)
            awaited(lambda: done(client), lambda count: count > 0)
            assert held(client, busy), 'the victim must have work when it is killed'
            os.kill(victim, signal.SIGKILL)
        work.join(BOUND)
        assert [w.pid for w in workers if w.poll() is not None] == [victim]
    assert found == [0]
    require_each_damping(json.loads(capsys.readouterr().out)['rows'])
    options = model_options(build_parser(told).parse_args(told))
    store = RowStore(tmp_path / 'rows', model_rows(options).columns)
    assert len(store.rows()) == len(DAMPING)


@contextlib.contextmanager
def cluster(folder: Path) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Yield a scheduler's address and two workers, processes of their own."""
    file = folder / 'scheduler.json'
    local = ['--host', '127.0.0.1', '--no-dashboard', '--scheduler-file', str(file)]
    kinds = [
        ['dask_scheduler', '--port', '0'],
        *[['dask_worker', '--nthreads', '1', '--no-nanny']] * 2,
    ]
    started: list[subprocess.Popen[bytes]] = []
    try:
        for name, *more in kinds:
            call = [sys.executable, '-m', f'distributed.cli.{name}', *more, *local]
            started.append(
                subprocess.Popen(
                    call, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
                )
            )
            awaited(file.exists, bool)
        address = awaited(lambda: json.loads(file.read_text() or '{}'), bool)['address']
        yield address, started[1:]
    finally:
        for process in started:
            process.kill()
        for process in started:
            process.wait(BOUND)


def held(client: Any, worker: str = '') -> str:
    """Return a worker that has tasks, or the one that was asked for if it has."""
    having = [w for w, tasks in client.processing().items() if tasks]
    return next((w for w in having if worker in ('', w)), '')


def done(client: Any) -> int:
    """Return how many results the workers hold."""
    return sum(len(keys) for keys in client.has_what().values())


def awaited(look: Callable[[], Any], is_there: Callable[[Any], bool]) -> Any:
    """Return what a look gives once it is there."""
    end = time.monotonic() + BOUND
    while not is_there(found := look()):
        assert time.monotonic() < end, f'waited {BOUND} s in vain, last: {found}'
        time.sleep(0.02)
    return found
