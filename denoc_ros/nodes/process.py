"""A node as a process: start, callbacks until a signal, clean end."""

from __future__ import annotations

import math
import signal
import sys
import time
from collections.abc import Callable, Sequence
from types import FrameType
from typing import Any

import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.signals import SignalHandlerOptions

from denoc_ros.errors import DenocError
from denoc_ros.nodes.base import DenocNode
from denoc_ros.nodes.watchdog import Watchdog

# a callback may load and compile a robot; beyond that (s) the executor hangs
PATIENCE = 60.0
# a waiting thread asks for the interpreter this often (s); the default of 5 ms is five ticks
SWITCH_INTERVAL = 2e-4


def run(
    make: Callable[[], DenocNode],
    arguments: Sequence[str] | None = None,
    patience: float = PATIENCE,
) -> int:
    """Run one node as a process until SIGINT or SIGTERM; return the exit status.

    Parameters
    ----------
    make : callable
        Makes the node, after rclpy is initialized.
    arguments : sequence of str, optional
        Command line; default the process's own.
    patience : float
        s that a callback may take; then the process saves what it has and ends itself.

    Returns
    -------
    int
        0 after a clean end; 1 for bad parameters or robot, or a failed loop: one clear message
        on stderr, no traceback.
    """
    signals: list[int] = []

    def on_signal(number: int, _frame: FrameType | None) -> None:
        signals.append(number)

    sys.setswitchinterval(SWITCH_INTERVAL)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, on_signal)
    try:
        # rclpy's own handlers would end the context before the safe command is out
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:
        print(f'denoc_ros: {error}', file=sys.stderr)
        return 1
    try:
        node = make()
    except DenocError as error:
        print(error, file=sys.stderr)
        rclpy.try_shutdown()
        return 1
    node.owns_process = True
    executor = EventsExecutor()
    executor.add_node(node)
    watchdog: Watchdog | None = None
    try:
        if node.settings.flag('autostart') and not _start(node, executor, signals):
            return 0 if signals else _fail(node)
        # started late: on a slow machine the first start compiles for minutes
        watchdog = Watchdog(node.get_name(), patience, node.save)
        return _spin(node, executor, signals, watchdog)
    finally:
        node.end()
        executor.remove_node(node)
        node.destroy_node()
        executor.shutdown()
        rclpy.try_shutdown()
        if watchdog is not None:  # the end must come to an end as well
            watchdog.stop()


def _spin(node: DenocNode, executor: Any, signals: list[int], watchdog: Watchdog) -> int:
    """Serve callbacks until the node is to end."""
    while rclpy.ok() and not signals:
        # .spin() hangs in the wheels of rclpy 7.1.6
        executor.spin_once(0.1)
        watchdog.beat()
        if node.fatal:
            return _fail(node)
    return 0


def _start(node: DenocNode, executor: Any, signals: list[int]) -> bool:
    """Configure as soon as the node has what it needs, then activate."""
    told = -math.inf
    while not node.ready:
        if signals or not rclpy.ok():
            return False
        if time.perf_counter() - told > 5.0:
            node.get_logger().info('waiting for robot_description')
            told = time.perf_counter()
        executor.spin_once(0.1)
    done = TransitionCallbackReturn.SUCCESS
    node.starting = True
    started = node.trigger_configure() == done and node.trigger_activate() == done
    node.starting = False
    return bool(started)


def _fail(node: DenocNode) -> int:
    print(f'{node.get_name()}: {node.fatal or node.failure}', file=sys.stderr)
    return 1
