"""What is asked of the system to be on time is what the system then says it does."""

from __future__ import annotations

import ctypes
import gc
import os
import re
import subprocess
import sys
import threading
from typing import Any

import pytest
from node_robots import GRAVITY, two_links

from denoc_ros.nodes.feedforward import FeedforwardNode
from denoc_ros.runtime.loop.realtime import make_thread_timely, make_transport_timely, refusals
from denoc_ros.runtime.loop.status import WARN, realtime_status

PR_GET_TIMERSLACK = 30
PR_SET_NAME = 15


def in_a_thread(priority: int, core: int) -> tuple[dict[str, str], int, set[int], int]:
    """Return what a thread was told, its priority, cores and timer slack [ns]."""
    found: list[Any] = []

    def ask() -> None:
        realtime_options = make_thread_timely(priority, core)
        slack = ctypes.CDLL(None).prctl(PR_GET_TIMERSLACK, 0, 0, 0, 0)
        found.append(
            (realtime_options, os.sched_getparam(0).sched_priority, os.sched_getaffinity(0), slack)
        )

    thread = threading.Thread(target=ask)
    thread.start()
    thread.join(60.0)
    return found[0]  # type: ignore[no-any-return]


def test_each_knob_is_reported_as_the_system_has_it() -> None:
    core = min(os.sched_getaffinity(0))
    realtime_options, priority, cores, slack = in_a_thread(7, core)
    taken = realtime_options['thread_priority'].startswith('taken')
    assert priority == (7 if taken else 0)  # refused without CAP_SYS_NICE
    assert realtime_options['cpu_affinity'] == f'taken: core {core}'
    assert cores == {core}
    # a thread under SCHED_FIFO has none anyway
    assert slack == (0 if taken else 1) or realtime_options['timer_slack'].startswith('refused')
    assert os.sched_getparam(0).sched_priority == 0


def test_what_is_off_changes_nothing_and_what_cannot_be_is_refused() -> None:
    before = os.sched_getaffinity(0)
    realtime_options, priority, cores, _ = in_a_thread(0, 1023)
    assert realtime_options['thread_priority'] == 'off'
    assert priority == 0
    assert realtime_options['cpu_affinity'] == 'refused: core 1023, Invalid argument'
    assert cores == before
    assert refusals(realtime_options) == ['cpu_affinity refused: core 1023, Invalid argument']
    status = realtime_status(realtime_options)
    assert status.level == WARN
    assert 'core 1023' in status.message


PROBE = """
from denoc_ros.runtime.loop.realtime import lock_memory, freeze_gc
print(lock_memory(True)['lock_memory'])
print(freeze_gc()['garbage'])
print(open('/proc/self/status').read())
"""


def test_memory_is_locked_where_it_says_so() -> None:
    done = subprocess.run(
        [sys.executable, '-c', PROBE], capture_output=True, text=True, timeout=60, check=True
    )
    said, settled, *_ = done.stdout.splitlines()
    locked = re.search(r'VmLck:\s+(\d+) kB', done.stdout)
    assert locked is not None
    # an interpreter has some MB
    assert (int(locked[1]) > 4000) == said.startswith('taken'), said
    assert int(settled.split()[1]) > 1000


def test_threads_of_the_transport_get_the_priority_of_the_loop_and_no_others_do() -> None:
    found: dict[str, int] = {}
    stop, named = threading.Event(), threading.Barrier(4)

    def wait(name: str) -> None:
        ctypes.CDLL(None).prctl(PR_SET_NAME, name.encode(), 0, 0, 0)
        named.wait(60.0)
        stop.wait(60.0)
        found[name] = os.sched_getparam(0).sched_priority

    names = ('dds.udp.7410', 'dds.shm.wdog', 'numbers')
    threads = [threading.Thread(target=wait, args=(name,)) for name in names]
    for thread in threads:
        thread.start()
    named.wait(60.0)
    said = make_transport_timely(7)['transport thread_priority']
    stop.set()
    for thread in threads:
        thread.join(60.0)
    taken = said.startswith('taken: SCHED_FIFO 7, ')
    assert taken or said.startswith('refused: 7, ')
    assert found == {'dds.udp.7410': 7 if taken else 0, 'dds.shm.wdog': 0, 'numbers': 0}
    assert make_transport_timely(0) == {'transport thread_priority': 'off'}


ALL_THREADS = """
import os, threading
from denoc_ros.runtime.loop.realtime import make_process_timely
stop = threading.Event()
threading.Thread(target=stop.wait, args=(5.0,)).start()
said = make_process_timely(5)['thread_priority']
found = {os.sched_getparam(int(task)).sched_priority for task in os.listdir('/proc/self/task')}
stop.set()
print(said, found, sep=';')
"""


def test_a_process_gets_its_priority_for_all_its_threads() -> None:
    done = subprocess.run(
        [sys.executable, '-c', ALL_THREADS], capture_output=True, text=True, timeout=60, check=True
    )
    said, found = done.stdout.strip().split(';')
    taken = said.startswith('taken: SCHED_FIFO 5, ')
    assert taken or said.startswith('refused: 5, ')
    assert found == ('{5}' if taken else '{0}')


@pytest.mark.ros
def test_diagnostics_say_what_was_taken(graph: Any) -> None:
    graph.add(
        FeedforwardNode,
        start=False,
        urdf_path='',
        gravity=GRAVITY,
        update_rate=50.0,
        cpu_affinity=1023,
    )
    node = graph.nodes[-1]
    node.description, node.ready = two_links(), True
    node.trigger_configure()
    node.trigger_activate()
    name = 'feedforward: realtime'
    graph.until(lambda: graph.value(name, 'loop cpu_affinity'))
    assert graph.value(name, 'loop cpu_affinity') == 'refused: core 1023, Invalid argument'
    assert graph.value(name, 'lock_memory') == 'off'
    assert graph.value(name, 'loop thread_priority') == 'off'
    assert graph.diagnostics[name].level == WARN
    assert gc.isenabled()  # the process is not the node's
