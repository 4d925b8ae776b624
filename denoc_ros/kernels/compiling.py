"""Compilation of kernels: each once, by one process, with messages, interruptible."""

from __future__ import annotations

import fcntl
import logging
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numba

from denoc_ros.kernels.cache import is_kept

LOG = logging.getLogger('denoc_ros')
THREAD = 'compiling'  # name of the thread that compiles
LOOK = 0.05  # s between looks whether it is our turn
SAY = 5.0  # s between two words on how far it is
PATIENCE = 20.0  # s without progress after which what another process has claimed is ours too


def compile_in_turn(kernels: Sequence[tuple[Any, Any]]) -> None:
    """Compile kernels, or load those that have been compiled before.

    Processes that start beside each other share the work: each compiles what no other one does.

    Parameters
    ----------
    kernels : sequence of (dispatcher, signature)
    """
    missing = [each for each in kernels if not is_kept(each[0])]
    if missing:
        _compile(missing)
    for dispatcher, signature in kernels:
        dispatcher.compile(signature)  # does nothing for what has just been compiled


def _compile(kernels: Sequence[tuple[Any, Any]]) -> None:
    """Compile what no other process compiles, wait for the rest; say how far it is.

    A process that is stopped, or gets no processor, keeps nobody waiting for long.
    """
    LOG.info('compiling %d kernels, once per version: a minute at most', len(kernels))
    began = said = moved = time.monotonic()
    missing = list(kernels)
    while missing:
        for each in list(missing):
            with _claim(each[0]) as ours:
                if ours or time.monotonic() - moved > PATIENCE:
                    _compile_one(*each)
                    missing.remove(each)
                    moved = time.monotonic()
            if time.monotonic() - said > SAY:
                said = time.monotonic()
                done = len(kernels) - len(missing)
                LOG.info('%d of %d kernels after %.0f s', done, len(kernels), said - began)
        time.sleep(LOOK if missing else 0.0)  # another process is at work on them
    LOG.info('kernels compiled in %.0f s', time.monotonic() - began)


def _compile_one(dispatcher: Any, signature: Any) -> None:
    """Compile in a thread, for a signal's handler has its turn in the main one only."""
    if not is_kept(dispatcher):  # by another process, while we waited
        _in_thread(lambda: dispatcher.compile(signature))


def _in_thread(act: Callable[[], object]) -> None:
    """Do something in another thread; wait for it so that this one can be interrupted.

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
    if failures:
        raise failures[0]


def at_work() -> bool:
    """Say whether a kernel is being compiled, also one that nobody waits for any more."""
    return any(thread.name == THREAD for thread in threading.enumerate())


@contextmanager
def _claim(dispatcher: Any) -> Iterator[bool]:
    """Say whether a kernel is ours to compile; also where the cache cannot be locked."""
    if not numba.config.CACHE_DIR:  # numba looks for places of its own
        yield True
        return
    function = dispatcher.py_func
    name = f'{function.__module__.rpartition(".")[2]}.{function.__qualname__}.lock'
    with ExitStack() as stack:
        try:
            lock = stack.enter_context(Path(numba.config.CACHE_DIR, name).open('w'))
        except OSError:
            yield True
            return
        yield _locked(lock)


def _locked(lock: Any) -> bool:
    """Lock a file; say whether nobody else has, which some network file systems cannot tell."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True
