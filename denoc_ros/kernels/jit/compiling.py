"""Compilation of kernels: each once, by one process, with messages, interruptible."""

from __future__ import annotations

import fcntl
import logging
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

from denoc_ros.kernels.jit.cache import cache_folder, is_kept

LOG = logging.getLogger('denoc_ros')
THREAD = 'compiling'  # name of the thread that compiles
LOOK = 0.05  # s between looks whether it is our turn, and between signs of life
SAY = 5.0  # s between two words on how far it is
PATIENCE = (
    20.0  # s without a sign of life after which what another process has claimed is ours too
)

Kernel = tuple[Any, Any]  # a dispatcher and the signature to compile it for


def compile_in_turn(groups: Sequence[Sequence[Kernel]]) -> None:
    """Compile kernels, or load those that have been compiled before.

    Processes that start beside each other share the work: each compiles what no other one does.

    Parameters
    ----------
    groups : sequence of sequences of (dispatcher, signature)
        What one process compiles by itself, because its inner functions are the same.
    """
    missing = [[each for each in group if not is_kept(each[0])] for group in groups]
    if any(missing):
        _compile([group for group in missing if group])
    for dispatcher, signature in chain(*groups):
        dispatcher.compile(signature)  # does nothing for what has just been compiled


def _compile(groups: Sequence[Sequence[Kernel]]) -> None:
    """Compile the kernels that no other process compiles, wait for the rest; report progress.

    A process that is stopped, or gets no processor, keeps nobody waiting for long.
    """
    count = sum(map(len, groups))
    counted = '1 kernel' if count == 1 else f'{count} kernels'
    LOG.info('compiling %s, once per version', counted)
    began = said = alive = time.monotonic()
    missing = list(groups)
    touched = 0.0
    while missing:
        for group in list(missing):
            lock = _lock_file(group[0][0])
            with _claim(lock) as ours:
                if ours or time.monotonic() - alive > PATIENCE:
                    _compile_group(group, lock)
                    missing.remove(group)
                    alive = time.monotonic()
            if time.monotonic() - said > SAY:
                said = time.monotonic()
                done = count - sum(map(len, missing))
                LOG.info('%d of %d kernels after %.0f s', done, count, said - began)
        if missing:  # other processes are at work on them
            time.sleep(LOOK)
            latest = max(_touched(_lock_file(group[0][0])) for group in missing)
            if latest != touched:
                touched, alive = latest, time.monotonic()
    LOG.info('kernels compiled in %.0f s', time.monotonic() - began)


def _compile_group(group: Sequence[Kernel], lock: Path | None) -> None:
    """Compile in a thread, for a signal's handler has its turn in the main one only."""
    for dispatcher, signature in group:
        if not is_kept(dispatcher):  # by another process, while we waited
            _in_thread(partial(dispatcher.compile, signature), lock)


def _in_thread(act: Callable[[], object], lock: Path | None) -> None:
    """Do something in another thread; wait for it so that this one can be interrupted.

    Meanwhile the lock is touched, so that other processes see that this one is at work.

    An interrupt does not wait for a kernel that is being compiled. The interpreter does, before it
    ends: it must not go from under a compiler at work.
    """
    failures: list[BaseException] = []

    def run() -> None:
        try:
            act()
        except BaseException as error:
            failures.append(error)

    thread = threading.Thread(target=run, name=THREAD, daemon=False)
    thread.start()
    while thread.is_alive():
        thread.join(LOOK)
        with suppress(OSError):
            if lock is not None:
                os.utime(lock)
    if failures:
        raise failures[0]


def at_work() -> bool:
    """Say whether a kernel is being compiled, also one that nobody waits for any more."""
    return any(thread.name == THREAD for thread in threading.enumerate())


def _lock_file(dispatcher: Any) -> Path | None:
    """Return the file that is locked by who compiles a kernel, and all with it; None: no cache."""
    folder = cache_folder()
    if folder is None:
        return None
    function = dispatcher.py_func
    name = f'{function.__module__.rpartition(".")[2]}.{function.__qualname__}.lock'
    return folder / name


def _touched(lock: Path | None) -> float:
    """Return when a lock was touched last, 0 if never."""
    with suppress(OSError):
        return lock.stat().st_mtime if lock is not None else 0.0
    return 0.0


@contextmanager
def _claim(path: Path | None) -> Iterator[bool]:
    """Say whether kernels are ours to compile; also where the cache cannot be locked."""
    with ExitStack() as stack:
        try:
            lock = stack.enter_context(path.open('a')) if path is not None else None
        except OSError:
            lock = None
        yield lock is None or _locked(lock)


def _locked(lock: Any) -> bool:
    """Lock a file; say whether nobody else has, which some network file systems cannot tell."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True
