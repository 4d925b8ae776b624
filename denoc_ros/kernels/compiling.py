"""Kernels compiled by one process at a time, said so, and to be interrupted at any moment."""

from __future__ import annotations

import fcntl
import logging
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numba

from denoc_ros.kernels.cache import is_kept

LOG = logging.getLogger('denoc_ros')
LOOK = 0.05  # s between looks whether it is our turn
SAY = 5.0  # s between two words on how far it is


def compile_in_turn(kernels: Sequence[tuple[Any, Any]]) -> None:
    """Compile kernels, or load those that have been compiled before.

    Processes that start beside each other compile one after the other: the second finds what the
    first has compiled.

    Parameters
    ----------
    kernels : sequence of (dispatcher, signature)
    """
    with ExitStack() as stack:
        missing = [each for each in kernels if not is_kept(each[0])]
        if missing:
            stack.enter_context(_turn())
            missing = [each for each in kernels if not is_kept(each[0])]
        if missing:
            _compile(missing)
        for dispatcher, signature in kernels:
            dispatcher.compile(signature)  # does nothing for what has just been compiled


def _compile(kernels: Sequence[tuple[Any, Any]]) -> None:
    """Compile in a thread, for a signal's handler has its turn in the main one only."""
    LOG.info('compiling %d kernels, once per version: a minute at most', len(kernels))
    began = said = time.monotonic()
    for done, (dispatcher, signature) in enumerate(kernels):
        if time.monotonic() - said > SAY:
            said = time.monotonic()
            LOG.info('%d of %d kernels compiled after %.0f s', done, len(kernels), said - began)
        _in_thread(lambda: dispatcher.compile(signature))  # noqa: B023 - joined in this turn
    LOG.info('kernels compiled in %.0f s', time.monotonic() - began)


def _in_thread(act: Callable[[], object]) -> None:
    """Do something in another thread; wait for it so that this one can be interrupted."""
    failures: list[BaseException] = []

    def run() -> None:
        try:
            act()
        except BaseException as error:
            failures.append(error)

    thread = threading.Thread(target=run, name='compiling', daemon=True)
    thread.start()
    try:
        while thread.is_alive():
            thread.join(LOOK)
    except KeyboardInterrupt:
        thread.join()  # the interpreter must not end under a compiler at work
        raise
    if failures:
        raise failures[0]


@contextmanager
def _turn() -> Iterator[None]:
    """Wait until no other process compiles; go ahead where the cache cannot be locked."""
    with ExitStack() as stack:
        try:
            lock = stack.enter_context(Path(numba.config.CACHE_DIR, 'lock').open('w'))
        except OSError:
            yield
            return
        told = False
        while not _locked(lock):
            if not told:
                LOG.info('waiting for another process that compiles kernels')
                told = True
            time.sleep(LOOK)
        yield


def _locked(lock: Any) -> bool:
    with suppress(BlockingIOError):
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return True
    return False
