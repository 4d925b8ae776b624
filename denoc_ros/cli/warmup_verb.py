"""`denoc warmup`: compile all kernels now, so that no first start has to."""

from __future__ import annotations

import argparse
import logging
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from denoc_ros.cli.arguments import add_option
from denoc_ros.cli.progress import Progress
from denoc_ros.dynamics.robot_model import CONSTRAINT_KERNELS, KERNELS
from denoc_ros.dynamics.stepper import DRIVEN_KERNELS
from denoc_ros.errors import DenocError
from denoc_ros.kernels.algebra import kalman, spline
from denoc_ros.kernels.derivatives import inverse_derivatives
from denoc_ros.kernels.dynamics import inverse, world
from denoc_ros.kernels.jit.cache import cache_folder, is_kept
from denoc_ros.kernels.jit.compiled import DECLARED, kernel_modules, ready
from denoc_ros.kernels.runtime import fault_bank, message_values, torque_limits
from denoc_ros.model.reading.urdf import load_tree
from denoc_ros.parts import optional
from denoc_ros.python_start import module_words
from denoc_ros.terminal_text import say

ORDERS = ('first', 'last')  # from which end of the list a process begins
# s of a processor, on the machine of docs/rates.md
HEAVY = {
    'constrained_derivatives_rows': 60.0,
    'advance_tied': 17.0,
    'forward_dynamics': 16.0,
    'inverse_dynamics_derivatives': 15.0,
    'frame_acceleration_derivatives_rows': 5.0,
}
USUAL = 1.5  # s of any other
# that the speed is measured by: the first loads the compiler, neither calls an algorithm apart
PROBES, PROBED = ('limit_torque', 'write_quaternion'), 0.17  # s of a processor, of the second
SPEEDS = (0.1, 4.0)  # that so short a look may find
LOADING = 3.0  # s until a process has loaded the compiler
LOOK = 0.1  # s
OF_LOOPS = ('clos', 'constrain')  # how modules begin that only robots with constraints need
LOG = logging.getLogger('denoc_ros')
DESCRIPTION = (
    'Compile the kernels of all commands and nodes in two processes, and cache them for all '
    'processes of this user. Cached kernels are only loaded.'
)


def all_kernels(loops: bool = True) -> list[Any]:
    """Return all that any command or node may compile, heavy ones at both ends."""
    kernel_modules()
    found = [each for each in DECLARED if loops or not _module(each).startswith(OF_LOOPS)]
    return _heavy_at_both_ends(found)


def kernels(
    loops: bool, plans: bool, feedback: bool = False, identifies: bool = False
) -> list[Any]:
    """Return the kernels of a session: heavy ones at both ends."""
    of_robot = CONSTRAINT_KERNELS if loops else DRIVEN_KERNELS
    found = [*KERNELS, *of_robot, inverse_derivatives.inverse_dynamics_derivatives]
    found += [kalman.take_values, kalman.predict_covariance, kalman.take_readings]
    found += [fault_bank.advance_filters, fault_bank.compare_filters]
    found += [message_values.take_numbers, message_values.put_numbers, spline.sample_quintics]
    found += [torque_limits.saturate]
    if plans:
        found += [
            inverse.inverse_dynamics_rows,
            world.frame_pose_rows,
            world.frame_jacobian_rows,
            inverse_derivatives.inverse_dynamics_derivatives_rows,
        ]
    if feedback and (part := optional('feedback.state_feedback')):
        found += part.FEEDBACK_KERNELS
    if identifies and (part := optional('identification.run_numbers')):
        found += part.IDENTIFICATION_KERNELS
    return _heavy_at_both_ends(found)


def missing(wanted: Sequence[Any]) -> list[Any]:
    """Return the kernels that are not in the cache."""
    return [each for each in wanted if not is_kept(each)]


def estimate(wanted: Sequence[Any], speed: float = 1.0) -> float:
    """Estimated time to compile the missing kernels [s], 0 if none is missing.

    `speed` is that of this machine, as :func:`measured_speed` finds it.
    """
    each = [_seconds(kernel) for kernel in missing(wanted)]
    if not each:
        return 0.0
    share = sum(each) / min(len(ORDERS), len(os.sched_getaffinity(0)))
    return max(share, max(each)) / speed + LOADING


def measured_speed(wanted: Sequence[Any]) -> float:
    """Compile a small kernel that is missing; return how fast, 1 on the machine of docs/rates.md.

    By processor time: beside other work all takes longer. 1 where the kernel is kept already.
    """
    left = {each.py_func.__name__: each for each in missing(wanted)}
    if not set(PROBES) <= set(left):
        return 1.0
    ready(left[PROBES[0]])
    began = time.process_time()
    ready(left[PROBES[1]])
    slowest, fastest = SPEEDS
    return min(max(PROBED / (time.process_time() - began), slowest), fastest)


def counted(wanted: Sequence[Any]) -> str:
    """Return how many kernels there are, in words."""
    return '1 kernel' if len(wanted) == 1 else f'{len(wanted)} kernels'


def compile_all(wanted: Sequence[Any], watch: Callable[[], None] = lambda: None) -> None:
    """Compile in processes beside each other; return when all is in the cache."""
    names = [_name(each) for each in wanted]
    processes = [
        subprocess.Popen(
            [sys.executable, *module_words('denoc_ros.cli.warmup_verb', order, *names)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        for order in ORDERS
    ]
    try:
        while any(process.poll() is None for process in processes):
            watch()
            time.sleep(LOOK)
        for process in processes:
            assert process.stderr is not None
            if process.returncode:
                raise DenocError(
                    f'kernels: compilation must succeed, got exit status {process.returncode}\n'
                    f'{process.stderr.read()[-2000:]}'
                )
    finally:
        for process in processes:
            process.kill()
            process.communicate()


def _heavy_at_both_ends(wanted: Sequence[Any]) -> list[Any]:
    ordered = sorted(wanted, key=_seconds, reverse=True)
    return [*ordered[::2], *reversed(ordered[1::2])]


def _seconds(kernel: Any) -> float:
    return HEAVY.get(kernel.py_func.__name__, USUAL)


def _module(kernel: Any) -> str:
    return str(kernel.py_func.__module__.rpartition('.')[2])


def _name(kernel: Any) -> str:
    return f'{_module(kernel)}.{kernel.py_func.__qualname__}'


def main(arguments: list[str]) -> None:
    """Compile from one end of the list."""
    order, *names = arguments
    known = {_name(each): each for each in all_kernels()}
    for name in names if order == ORDERS[0] else reversed(names):
        ready(known[name])


if __name__ == '__main__':
    main(sys.argv[1:])


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_option(
        parser,
        'robot ROBOT.urdf',
        'leave out the kernels for kinematic loops and mimic joints if this robot has none',
        nargs='?',
        type=Path,
    )


def run(args: argparse.Namespace) -> int:
    """Compile and print the time it took."""
    LOG.info('loading the compiler')
    tree = None if args.robot is None else load_tree(args.robot)
    wanted = all_kernels(tree is None or bool(tree.loops or tree.mimics))
    began = time.perf_counter()
    if missing(wanted):
        speed = measured_speed(wanted)
        left = missing(wanted)
        what = f'compiling {counted(left)}, once per version and user'
        with Progress().step(what, estimate(wanted, speed)):
            compile_all(left)
    took = time.perf_counter() - began
    said = counted(wanted)
    say(f'{said} ready after {took:.1f} s, kept in {cache_folder()}')
    return 0
