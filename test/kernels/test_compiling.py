"""Kernels are compiled once, each by one process, and kept wherever the package is installed."""

from __future__ import annotations

import errno
import fcntl
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn

import numba
import pytest
from child_processes import child
from numba import types
from numba.core.caching import NullCache

from denoc_ros.dynamics.robot_model import KERNELS
from denoc_ros.kernels import CHECKED
from denoc_ros.kernels.constraints import closing
from denoc_ros.kernels.derivatives import forward_derivatives
from denoc_ros.kernels.dynamics import articulated, driven_step, inverse
from denoc_ros.kernels.jit import compiled, compiling
from denoc_ros.kernels.jit.cache import cache_folder, is_kept
from denoc_ros.kernels.jit.compiled import LongLoops, ShortLoops

# three kernels that take a while, and are kept by a file as numba keeps them
SLOW = """
import logging, sys, time
from types import SimpleNamespace
from denoc_ros.kernels.jit.cache import SUFFIX, _write, cache_folder
from denoc_ros.kernels.jit.compiling import compile_in_turn

logging.basicConfig(level=logging.INFO, format='%(message)s', stream=sys.stdout)

class Slow:
    def __init__(self, name):
        code = SimpleNamespace(co_firstlineno=1)
        self.py_func = SimpleNamespace(__module__='a.slow', __qualname__=name, __code__=code)
        self.kept = cache_folder() / f'slow.{name}-1.key{SUFFIX}'

    def compile(self, signature):
        if not self.kept.exists():
            print('compiles', self.py_func.__qualname__, flush=True)
            time.sleep(1.0)
            _write(self.kept, b'')

print('begins', flush=True)
sys.stdin.readline()
compile_in_turn([[(Slow('one'), None), (Slow('with one'), None)], [(Slow('two'), None)]])
print('has all', flush=True)
"""


def test_processes_beside_each_other_share_the_work(tmp_path: Path) -> None:
    environment = {**os.environ, 'NUMBA_CACHE_DIR': str(tmp_path)}
    streams = {'stdin': subprocess.PIPE, 'stdout': subprocess.PIPE}
    with ExitStack() as running:
        processes = [
            running.enter_context(child([sys.executable, '-c', SLOW], env=environment, **streams))
            for _ in range(2)
        ]
        for process in processes:
            assert process.stdout is not None
            assert process.stdout.readline() == 'begins\n'
        for process in processes:
            assert process.stdin is not None
            process.stdin.write('\n')
            process.stdin.flush()
        said = [process.communicate(timeout=60)[0].splitlines() for process in processes]
    done = [line for lines in said for line in lines if line.startswith('compiles')]
    assert sorted(done) == ['compiles one', 'compiles two', 'compiles with one']
    ours = [[line for line in lines if line.startswith('compiles')] for lines in said]
    assert sorted(ours) == [['compiles one', 'compiles with one'], ['compiles two']]
    assert all(lines[-1] == 'has all' for lines in said)
    assert all('compiling 3 kernels' in lines[0] for lines in said)


class Quick:
    """Stands for a kernel; remembers for what it was compiled."""

    def __init__(self) -> None:
        code = SimpleNamespace(co_firstlineno=1)
        self.py_func = SimpleNamespace(__module__='a.quick', __qualname__='one', __code__=code)
        self.compiled: list[Any] = []

    def compile(self, signature: Any) -> None:
        self.compiled.append(signature)


@pytest.fixture
def kernel_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Return an empty cache folder that this process uses instead of its own."""
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(tmp_path))
    cache_folder.cache_clear()
    folder = cache_folder()
    assert folder is not None
    assert folder.parent == tmp_path
    yield folder
    cache_folder.cache_clear()


@contextmanager
def claimed_elsewhere(folder: Path) -> Iterator[Path]:
    """Hold the claim of a quick kernel as another process does; yield its lock."""
    lock = folder / 'quick.one.lock'
    with lock.open('w') as claimed:
        fcntl.flock(claimed, fcntl.LOCK_EX)
        yield lock


def test_a_claim_of_a_process_that_stands_still_holds_nobody_for_long(
    kernel_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiling, 'PATIENCE', 0.2)
    kernel = Quick()
    with claimed_elsewhere(kernel_folder):
        begin = time.monotonic()
        compiling.compile_in_turn([[(kernel, 'f(i)')]])
    assert set(kernel.compiled) == {'f(i)'}
    assert time.monotonic() - begin > 0.2


@pytest.mark.long
def test_a_claim_of_a_process_at_work_is_kept_however_long_it_takes(
    kernel_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiling, 'PATIENCE', 2.0)  # a loaded machine may pause the signs
    kernel = Quick()
    with claimed_elsewhere(kernel_folder) as lock:
        waiting = threading.Thread(
            target=compiling.compile_in_turn, args=([[(kernel, 'f(i)')]],), daemon=True
        )
        waiting.start()
        for stamp in range(60):  # signs of life for three seconds
            os.utime(lock, (stamp, stamp))
            time.sleep(0.05)
        assert kernel.compiled == []
        waiting.join(60.0)  # and none any more
    assert set(kernel.compiled) == {'f(i)'}


def test_who_compiles_touches_the_lock(kernel_folder: Path) -> None:
    lock = kernel_folder / 'quick.one.lock'
    seen: list[bool] = []

    class Long(Quick):
        def compile(self, signature: Any) -> None:
            if not seen:
                os.utime(lock, (1.0, 1.0))
                wait_until(lambda: lock.stat().st_mtime > 1.0)
            seen.append(True)

    compiling.compile_in_turn([[(Long(), 'f(i)')]])
    assert seen


@pytest.mark.usefixtures('kernel_folder')
def test_an_interrupt_does_not_wait_for_the_kernel_that_is_being_compiled() -> None:
    begun, goes_on = threading.Event(), threading.Event()

    class Endless(Quick):
        def compile(self, signature: Any) -> None:
            begun.set()
            goes_on.wait(60.0)

    def interrupt() -> None:
        begun.wait(60.0)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt).start()
    with pytest.raises(KeyboardInterrupt):
        compiling.compile_in_turn([[(Endless(), 'f(i)')]])
    assert compiling.at_work()
    goes_on.set()
    wait_until(lambda: not compiling.at_work())


def wait_until(true: Callable[[], bool]) -> None:
    """Wait until a condition holds, a minute at most."""
    end = time.monotonic() + 60.0
    while not true():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.long
def test_a_command_is_interrupted_while_it_compiles(tmp_path: Path) -> None:
    command = [sys.executable, '-m', 'denoc_ros.cli.main', 'warmup']
    environment = {**os.environ, 'NUMBA_CACHE_DIR': str(tmp_path)}
    with child(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment
    ) as process:
        assert process.stderr is not None
        assert process.stderr.readline() == 'denoc: loading the compiler\n'
        assert process.stderr.readline().startswith('denoc: compiling')
        # within the first kernel: what it calls is compiled before it
        wait_until(lambda: any(tmp_path.rglob('*.kernel')))
        process.send_signal(signal.SIGINT)
        assert process.wait(60.0) == 130
        said = process.stderr.read()
        assert said.endswith('denoc warmup: interrupted\n')
        assert 'Traceback' not in said
    assert not any(tmp_path.rglob('inverse.inverse_dynamics-*.kernel'))  # it did not wait for it


@pytest.mark.usefixtures('kernel_folder')
def test_a_file_system_without_locks_keeps_nobody_from_compiling(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_: Any) -> NoReturn:
        raise OSError(errno.ENOLCK, 'No locks available')

    monkeypatch.setattr(fcntl, 'flock', refuse)
    kernel = Quick()
    compiling.compile_in_turn([[(kernel, 'f(i)')]])
    assert set(kernel.compiled) == {'f(i)'}


def test_kernels_are_kept_by_name_wherever_the_package_is() -> None:
    kernel = inverse.inverse_dynamics
    file = kernel.py_func.__code__.co_filename
    assert str(Path(file).parent) not in kernel._cache.cache_path
    assert kernel._cache.cache_path == str(cache_folder())
    assert isinstance(compiled.shared(doubled)._cache, NullCache)  # a function of this file


def test_what_has_been_compiled_is_known() -> None:
    from denoc_ros.kernels.jit.compiled import ready

    ready(inverse.inverse_dynamics)
    assert is_kept(inverse.inverse_dynamics)


def doubled(a: Any) -> None:
    for k in range(a.size):
        a[k] *= 2.0


@pytest.mark.skipif(CHECKED, reason='checked kernels are not optimized')
def test_loops_are_vectorized_but_where_they_are_short() -> None:
    before = numba.config.LOOP_VECTORIZE
    signature = 'void(float64[::1])'
    long = numba.njit(signature, pipeline_class=LongLoops)(doubled)
    short = numba.njit(signature, pipeline_class=ShortLoops)(doubled)
    assert 'vector.body' in next(iter(long.inspect_llvm().values()))
    assert 'vector.body' not in next(iter(short.inspect_llvm().values()))
    assert before == numba.config.LOOP_VECTORIZE


@pytest.mark.skipif(CHECKED, reason='checked kernels call each other as numba has it')
@pytest.mark.parametrize(
    ('called', 'names'),
    [
        (inverse.inverse_dynamics, []),
        (articulated.forward_dynamics, ['dynamics.articulated.find_acceleration']),
        (driven_step.advance_driven, ['dynamics.articulated.find_articulated']),
        (driven_step.driven_torque, ['dynamics.articulated.find_articulated']),
        (closing.advance_tied, ['constraints.constrained.find_constrained']),
        (
            forward_derivatives.forward_dynamics_derivatives,
            [
                'dynamics.articulated.find_articulated',
                'derivatives.inverse_derivatives.find_derivatives',
            ],
        ),
    ],
    ids=lambda each: getattr(each, '__name__', ''),
)
def test_a_kernel_is_ready_with_all_that_it_calls_apart(called: Any, names: list[str]) -> None:
    from denoc_ros.kernels.jit.compiled import ready

    symbols = {f'denoc_ros.kernels.{name}' for name in names}
    assert compiled._symbols(called) == symbols
    if called in KERNELS:  # others take long to compile
        ready(called)
        assert all(len(compiled.APART[symbol].signatures) == 1 for symbol in symbols)


@pytest.mark.skipif(CHECKED, reason='checked kernels call each other as numba has it')
def test_what_stands_apart_calls_nothing_apart() -> None:
    """All of it is compiled before all kernels, in any order."""
    assert compiled.APART
    for dispatcher in compiled.APART.values():
        assert compiled._symbols(dispatcher) == set()


def uncached(function: Any) -> Any:
    """Return a function that numba keeps in no file."""
    function._cache = NullCache()
    return function


@pytest.mark.skipif(CHECKED, reason='checked kernels inline nothing')
@pytest.mark.parametrize('called', ['shared', 'short_shared', 'inlined', 'short_inlined'])
def test_what_is_inlined_does_not_depend_on_the_caller(called: str) -> None:
    """Numba lets a function inherit options from the caller that has it compiled."""
    own = uncached(getattr(compiled, called)(lambda x: 2.0 * x))
    caller = uncached(compiled.inlined(lambda x: own(x) + 1.0))
    caller.compile((types.float64,))
    (code,) = own.overloads.values()
    assert code.fndesc.inline == (called in {'inlined', 'short_inlined'})
