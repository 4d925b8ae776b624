"""A node as a process: start, callbacks until a signal, clean end."""

from __future__ import annotations

import gc
import logging
import math
import os
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, NoReturn

import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy
from rclpy.signals import SignalHandlerOptions

from denoc_ros.errors import DenocError
from denoc_ros.nodes.base.denoc_node import DenocNode
from denoc_ros.nodes.base.guarded_node import leave_graph
from denoc_ros.nodes.base.middleware import release_buffers, use_sockets
from denoc_ros.runtime.loop.ending import SIGNALS, Interrupted, Watchdog
from denoc_ros.runtime.loop.realtime import return_large_pieces
from denoc_ros.terminal_text import say, visible_record

# a callback may load and compile a robot; beyond that (s) the executor hangs
PATIENCE = 60.0
# a waiting thread asks for the interpreter this often (s); the default of 5 ms is five ticks
SWITCH_INTERVAL = 2e-4


def run(
    make: Callable[[], DenocNode],
    arguments: Sequence[str] | None = None,
    patience: float = PATIENCE,
    shared_memory: bool = False,
) -> int:
    """Run one node as a process until SIGINT, SIGTERM or SIGHUP; return the exit status.

    Nothing of ROS is left when it returns: node, executor, context, their threads.

    Parameters
    ----------
    make : callable
        Makes the node, after rclpy is initialized.
    arguments : sequence of str, optional
        Command line; default the process's own.
    patience : float
        s that a callback may take; then the process saves what it has and ends itself.
    shared_memory : bool
        Whether the middleware may use it: for nodes that receive much and command nothing.

    Returns
    -------
    int
        0 after a clean end; 1 for bad parameters or robot, or a failed loop: one clear message
        on stderr, no traceback.
    """
    sys.setswitchinterval(SWITCH_INTERVAL)
    return_large_pieces()
    SIGNALS.keep()
    _show_log()
    if not shared_memory:
        use_sockets()
    release_buffers()
    try:
        # rclpy's own handlers would end the context before the safe command is out
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:
        say(f'denoc_ros: {error}', file=sys.stderr)
        return 1
    watchdog = Watchdog(patience, _compiles)
    try:
        return _live(make, watchdog)
    finally:
        leave_graph()
        watchdog.stop()  # the end must come to an end as well


def _compiles() -> bool:
    """Say whether kernels are being compiled; a node without a model has not loaded any."""
    compiling = sys.modules.get('denoc_ros.kernels.jit.compiling')
    return compiling is not None and bool(compiling.at_work())


def leave(status: int) -> NoReturn:
    """End the process now, after its clean end.

    At exit C++ destroys its objects in an undefined order, while threads of the middleware may
    still use them: this corrupted the heap once in a hundred ends. Everything that matters is
    closed by now; only memory would be given back.
    """
    with suppress(Exception):
        logging.shutdown()
    for stream in (sys.stdout, sys.stderr):
        with suppress(Exception):
            stream.flush()
    os._exit(status)


def _show_log() -> None:
    """Send the package's log, such as the compilation of its kernels, to stdout."""
    log = logging.getLogger('denoc_ros')
    if not log.handlers:
        handler = logging.StreamHandler(sys.stdout)
        handler.addFilter(visible_record)
        log.addHandler(handler)
    log.setLevel(logging.INFO)


def _live(make: Callable[[], DenocNode], watchdog: Watchdog) -> int:
    """Make the node, serve it, end it; return the status."""
    node: DenocNode | None = None
    executor: Any = None
    try:
        node = make()
        node.owns_process = True
        executor = EventsExecutor()
        executor.add_node(node)
        if node.settings.flag('autostart') and not _start(node, executor):
            return 0 if SIGNALS.received else _fail(node)
        # begun late: on a slow machine the first start compiles for minutes
        watchdog.begin(node.get_name(), node.save)
        return _spin(node, executor, watchdog)
    except Interrupted:
        return 0
    except DenocError as error:
        say(error, file=sys.stderr)
        return 1
    except Exception:
        say(traceback.format_exc(), end='', file=sys.stderr)
        return 1
    finally:
        # what is frozen would outlive its last reference, with the middleware's threads in it
        gc.unfreeze()
        if node is not None:
            _end(node, executor)
        watchdog.forget()


def _end(node: DenocNode, executor: Any) -> None:
    """Take node and executor down; a failure of one does not stop the rest."""
    steps: list[Callable[[], object]] = [node.end, node.destroy_node]
    if executor is not None:
        steps = [node.end, lambda: executor.remove_node(node), node.destroy_node]
        steps.append(executor.shutdown)
    for step in steps:
        try:
            step()
        except Exception:
            say(traceback.format_exc(), end='', file=sys.stderr)


def _spin(node: DenocNode, executor: Any, watchdog: Watchdog) -> int:
    """Serve callbacks until the node is to end."""
    while rclpy.ok() and not SIGNALS.received:
        _turn(node, executor)
        watchdog.beat()
        if node.fatal:
            return _fail(node)
    return 0


def _start(node: DenocNode, executor: Any) -> bool:
    """Configure as soon as the node has its inputs, then activate."""
    done = TransitionCallbackReturn.SUCCESS
    node.starting = True
    try:
        while _wait(node, executor):
            if node.trigger_configure() == done:
                return bool(node.trigger_activate() == done)
            if node.ready:
                return False
            node.get_logger().error(node.failure)  # of what a topic said: it may say better
    finally:
        node.starting = False
    return False


def _wait(node: DenocNode, executor: Any) -> bool:
    """Wait until the node has its inputs; False when it is to end before."""
    told = -math.inf
    while not SIGNALS.received and rclpy.ok():
        if node.ready:
            return True
        if time.perf_counter() - told > 5.0:
            node.get_logger().info(f'waiting for robot_description{_why_in_vain(node)}')
            told = time.perf_counter()
        _turn(node, executor)
    return False


def _why_in_vain(node: DenocNode) -> str:
    """Return why a published description cannot arrive, '' if it may."""
    offers = node.get_publishers_info_by_topic(node.resolve_topic_name('robot_description'))
    if offers and all(o.qos_profile.durability == DurabilityPolicy.VOLATILE for o in offers):
        return ': its publisher must be transient local, got volatile'
    return ''


def _turn(node: DenocNode, executor: Any) -> None:
    """Serve a callback, if one comes in time."""
    try:
        # .spin() hangs in the wheels of rclpy 7.1.6
        executor.spin_once(0.1)
    except Exception as error:  # what no guarded callback can catch, such as a broken request
        node.guard.note('executor', error)


def _fail(node: DenocNode) -> int:
    say(f'{node.get_name()}: {node.fatal or node.failure}', file=sys.stderr)
    return 1
