"""Real-time options of a process, each reported as taken or refused.

None of it needs ROS, and none of it fails: a system that does not allow it runs as without.
"""

from __future__ import annotations

import ctypes
import gc
import os
from collections.abc import Mapping
from pathlib import Path

PR_SET_TIMERSLACK = 29
MCL_CURRENT_AND_FUTURE = 3
OFF = 'off'
REFUSED = 'refused'
TRANSPORT = 'dds.'  # what the names of Fast DDS's threads begin with
WATCHDOG = 'dds.shm.wdog'  # looks after dead processes: nothing waits for it
# environment of a process with one thread of work: threads of a library would get in its way
SINGLE_THREADED = {f'{kind}_NUM_THREADS': '1' for kind in ('OMP', 'OPENBLAS', 'MKL', 'NUMBA')}

# loaded once: a look-up takes longer than a period
_LIBC = ctypes.CDLL(None, use_errno=True)
LARGE = 262_144  # bytes: far more than a tick allocates
MMAP_THRESHOLD = -3  # as <malloc.h> has it
CHOSEN = 'MALLOC_MMAP_THRESHOLD_'  # glibc's environment variable for the same


def make_thread_timely(priority: int, core: int = -1) -> dict[str, str]:
    """Set timer slack, priority and core of the calling thread.

    Parameters
    ----------
    priority : int
        SCHED_FIFO priority; 0: none.
    core : int
        Core to keep it on; -1: any.

    Returns
    -------
    dict of str to str
        By option: `taken: …`, `refused: …` or `off`.
    """
    return {
        'timer_slack': _timer_slack(),
        'cpu_affinity': _affinity(core),
        'thread_priority': schedule_thread(priority) if priority > 0 else OFF,
    }


def lock_memory(wanted: bool) -> dict[str, str]:
    """Keep all pages of the process in memory, now and from here on; return as for a thread."""
    if not wanted:
        return {'lock_memory': OFF}
    if _LIBC.mlockall(MCL_CURRENT_AND_FUTURE) != 0:
        return {'lock_memory': f'{REFUSED}: {os.strerror(ctypes.get_errno())}'}
    return {'lock_memory': 'taken: mlockall'}


def make_transport_timely(priority: int) -> dict[str, str]:
    """Set the priority of the threads that receive and send messages; return as for a thread.

    Parameters
    ----------
    priority : int
        SCHED_FIFO priority; 0: none. Fast DDS starts its threads with the participant, ordinary
        ones: a message for a timely loop would wait for them on a busy machine.
    """
    return {'transport thread_priority': _threads_priority(priority, TRANSPORT)}


def make_process_timely(priority: int) -> dict[str, str]:
    """Set the priority of all threads that there are; return as for a thread."""
    return {'thread_priority': _threads_priority(priority)}


def make_callbacks_timely(priority: int) -> dict[str, str]:
    """Serve callbacks of a loop with a priority in the calling thread; return as for a thread.

    Callbacks hold the interpreter: they run just below the loop. The threads that receive and send
    messages need no interpreter, and have the loop's priority.
    """
    callbacks = make_thread_timely(priority - 1)['thread_priority']
    return {'callbacks thread_priority': callbacks, **make_transport_timely(priority)}


def lower_priority(niceness: int) -> dict[str, str]:
    """Lower the priority of all present and future threads; return as for a thread."""
    for task in Path('/proc/self/task').iterdir():
        try:
            os.setpriority(os.PRIO_PROCESS, int(task.name), niceness)
        except OSError as error:
            return {'niceness': f'{REFUSED}: {niceness}, {error.strerror}'}
    return {'niceness': f'taken: {niceness}'}


def freeze_gc() -> dict[str, str]:
    """Collect once, freeze survivors, disable automatic collection; return as for a thread.

    What an earlier call froze is collected as well, if it is no longer needed.
    """
    gc.unfreeze()
    gc.collect()
    gc.freeze()
    gc.disable()
    return {'garbage': f'taken: {gc.get_freeze_count()} objects frozen, collected once a second'}


def refusals(realtime_options: Mapping[str, str]) -> list[str]:
    """Return a sentence for each option that was refused."""
    return [
        f'{name} {what}' for name, what in realtime_options.items() if what.startswith(REFUSED)
    ]


def _timer_slack() -> str:
    # the default slack of 50 us would be added to every sleep
    if _LIBC.prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0) != 0:
        return f'{REFUSED}: {os.strerror(ctypes.get_errno())}'
    return 'taken: 1 ns'


def _affinity(core: int) -> str:
    if core < 0:
        return OFF
    try:
        os.sched_setaffinity(0, {core})
    except OSError as error:
        return f'{REFUSED}: core {core}, {error.strerror}'
    return f'taken: core {core}'


def schedule_thread(priority: int) -> str:
    """Give the calling thread a SCHED_FIFO priority, 0: make it ordinary; return as above."""
    try:
        _schedule(0, priority)
    except OSError as error:
        return f'{REFUSED}: {priority}, {error.strerror}'
    return f'taken: SCHED_FIFO {priority}' if priority > 0 else 'taken: SCHED_OTHER'


def _threads_priority(priority: int, prefix: str = '') -> str:
    """Set the SCHED_FIFO priority of the threads whose names begin so."""
    if priority <= 0:
        return OFF
    count = 0
    for task in Path('/proc/self/task').iterdir():
        try:
            name = (task / 'comm').read_text().strip()
            if not name.startswith(prefix) or name == WATCHDOG:
                continue
            _schedule(int(task.name), priority)
        except (FileNotFoundError, ProcessLookupError):  # a thread that has just ended
            continue
        except OSError as error:
            return f'{REFUSED}: {priority}, {error.strerror}'
        count += 1
    return f'taken: SCHED_FIFO {priority}, {count} threads'


def _schedule(thread: int, priority: int) -> None:
    """Run a thread under SCHED_FIFO, 0: ordinarily; threads that it starts stay ordinary."""
    # once set, only who may set priorities can take the reset off again
    policy = (os.SCHED_FIFO if priority > 0 else os.SCHED_OTHER) | os.SCHED_RESET_ON_FORK
    os.sched_setscheduler(thread, policy, os.sched_param(priority))


def return_large_pieces() -> bool:
    """Have the C library map pieces of 256 KiB and more on their own; say whether it will.

    It does not where the user has set a size, and where it is not glibc.

    glibc maps large pieces of memory one by one, but raises the size from which it does so with
    each such piece that is freed, up to 32 MB. Later pieces come from the heap, among small ones
    that live long: a process keeps the memory of large messages, and more of it with each burst.
    """
    adjust = getattr(ctypes.CDLL(None), 'mallopt', None)
    if adjust is None or CHOSEN in os.environ:
        return False
    return bool(adjust(MMAP_THRESHOLD, LARGE))
