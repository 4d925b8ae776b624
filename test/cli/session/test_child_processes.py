"""Child processes: their end is noticed, their last words are kept, none outlives its session."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from child_processes import child
from ros_domains import claimed_domain

from denoc_ros.cli.session import processes as module
from denoc_ros.cli.session.processes import ProcessError, Processes, free_domain

PATIENCE = 60.0  # s for what takes a second on a machine that does nothing else
STUBBORN = (
    'import signal, time; signal.signal(signal.SIGINT, signal.SIG_IGN); '
    'print("deaf", flush=True); time.sleep(300)'
)


@pytest.fixture
def processes(tmp_path: Path) -> Iterator[Processes]:
    running = Processes(tmp_path, {'FLAVOUR': 'mint'})
    yield running
    running.stop_all(())


def wait_for_log(folder: Path, text: str) -> None:
    end = time.perf_counter() + PATIENCE
    while text not in (folder / 'a.log').read_text():
        assert time.perf_counter() < end
        time.sleep(0.02)


def test_an_unexpected_end_is_told_with_its_last_words(
    processes: Processes, tmp_path: Path
) -> None:
    code = 'import os, sys; print(os.environ["FLAVOUR"]); sys.exit("bad robot")'
    processes.start('a', ['-c', code])
    wait_for_log(tmp_path, 'bad robot')
    end = time.perf_counter() + PATIENCE
    while processes.running('a') and time.perf_counter() < end:
        time.sleep(0.02)
    with pytest.raises(
        ProcessError, match=r'a: process must .* exit status 1\n  mint\n  bad robot'
    ):
        processes.check()


@pytest.mark.skipif(sys.version_info < (3, 11), reason='its Python cannot leave the folder out')
def test_nothing_is_imported_from_the_folder_a_session_is_started_in(
    processes: Processes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ('numpy', 'yaml', 'signal'):
        (tmp_path / f'{name}.py').write_text('raise SystemExit("planted")')
    monkeypatch.chdir(tmp_path)
    processes.start('a', ['-m', 'denoc_ros.cli.verbs'], ends=True)
    processes.start('b', ['-c', 'import signal, yaml, numpy; print("own")'], ends=True)
    end = time.perf_counter() + PATIENCE
    while any(map(processes.running, 'ab')) and time.perf_counter() < end:
        time.sleep(0.02)
    processes.check()
    assert 'own' in (tmp_path / 'b.log').read_text()


def test_a_process_that_may_end_well_is_no_failure(processes: Processes) -> None:
    processes.start('a', ['-c', 'pass'], ends=True)
    end = time.perf_counter() + PATIENCE
    while processes.running('a') and time.perf_counter() < end:
        time.sleep(0.02)
    processes.check()


def test_a_process_deaf_to_sigint_is_ended_all_the_same(
    processes: Processes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, 'PATIENCE', ((signal.SIGINT, 0.3), (signal.SIGTERM, PATIENCE)))
    processes.start('a', ['-c', STUBBORN])
    wait_for_log(tmp_path, 'deaf')
    began = time.perf_counter()
    processes.stop('a')
    assert 0.3 <= time.perf_counter() - began < PATIENCE
    assert processes.cpu_seconds() == {}


def test_a_process_that_cannot_end_in_order_is_killed_soon(
    processes: Processes, tmp_path: Path
) -> None:
    processes.start('a', ['-c', STUBBORN])
    wait_for_log(tmp_path, 'deaf')
    processes.give_up('a')
    began = time.perf_counter()
    processes.stop('a')
    assert time.perf_counter() - began < 0.5 * module.PATIENCE[0][1]
    assert processes.cpu_seconds() == {}


def test_children_end_when_their_parent_is_killed(tmp_path: Path) -> None:
    sleeper = "import time; print('up', flush=True); time.sleep(300)"
    code = (
        'import sys, time; from pathlib import Path; '
        'from denoc_ros.cli.session.processes import Processes; '
        f'p = Processes(Path(sys.argv[1]), {{}}); p.start("a", ["-c", {sleeper!r}]); '
        'print(p._running["a"].pid, flush=True); time.sleep(300)'
    )
    with child(
        [sys.executable, '-c', code, str(tmp_path)],
        stdout=subprocess.PIPE,
        preexec_fn=deafen,  # as a shell does with what it starts in the background
    ) as parent:
        assert parent.stdout is not None
        started = int(parent.stdout.readline())
        wait_for_log(tmp_path, 'up')
    end = time.perf_counter() + PATIENCE
    while Path(f'/proc/{started}').exists() and not is_zombie(started):
        assert time.perf_counter() < end, 'the child outlived its parent'
        time.sleep(0.02)


def deafen() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def is_zombie(pid: int) -> bool:
    try:
        text = Path(f'/proc/{pid}/stat').read_text()
    except OSError:
        return True
    return text.rpartition(')')[2].split()[0] == 'Z'


def test_a_free_domain_is_one_whose_port_can_be_had() -> None:
    first = free_domain()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(('', 7410 + 250 * first))
        assert free_domain() != first


def test_a_domain_that_a_test_has_claimed_is_not_free(monkeypatch: pytest.MonkeyPatch) -> None:
    with claimed_domain() as first, claimed_domain() as second:
        assert first != second
        monkeypatch.setattr('os.getpid', lambda: first - 1)  # where the search begins
        assert free_domain() not in (first, second)
