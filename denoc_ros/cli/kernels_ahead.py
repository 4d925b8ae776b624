"""The kernels of a session, compiled by processes beside each other before anything else.

`python -m denoc_ros.cli.kernels_ahead ORDER LOOPS PLANS` is one of these processes; what one
compiles, the others do not.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

from denoc_ros.errors import DenocError

ORDERS = ('first', 'last')  # from which end of the list a process begins
HEAVY = {'forward_dynamics': 16.0, 'inverse_dynamics_derivatives': 15.0}  # s of a processor
USUAL = 1.5  # s of any other
LOADING = 3.0  # s until a process has loaded the compiler
LOOK = 0.1  # s


def kernels(loops: bool, plans: bool) -> list[Any]:
    """Return the kernels of a session: heavy ones at both ends.

    Parameters
    ----------
    loops : bool
        Whether the robot has constraints.
    plans : bool
        Whether a phase shapes its reference, or a node plans.
    """
    from denoc_ros.dynamics.robot_model import CONSTRAINT_KERNELS, KERNELS
    from denoc_ros.kernels import correction, inverse, inverse_derivatives, world

    heavy_first = sorted(KERNELS, key=_seconds, reverse=True)
    found = [*heavy_first, *(CONSTRAINT_KERNELS if loops else ()), correction.take_values]
    if plans:
        found += [
            inverse.inverse_dynamics_rows,
            world.frame_pose_rows,
            world.frame_jacobian_rows,
            inverse_derivatives.inverse_dynamics_derivatives_rows,
            inverse_derivatives.inverse_dynamics_derivatives,
        ]
    return found


def estimate(loops: bool, plans: bool) -> float:
    """Return about how long the compilation of what is missing takes [s], 0 if nothing is."""
    from denoc_ros.kernels.cache import is_kept

    missing = [each for each in kernels(loops, plans) if not is_kept(each)]
    share = sum(map(_seconds, missing)) / min(len(ORDERS), len(os.sched_getaffinity(0)))
    return max(share, max(map(_seconds, missing))) + LOADING if missing else 0.0


def compile_all(loops: bool, plans: bool, watch: Callable[[], None] = lambda: None) -> None:
    """Compile in processes beside each other; return when all is in the cache.

    Parameters
    ----------
    loops, plans : bool
        As of :func:`kernels`.
    watch : callable
        Called while they work; may raise.

    Raises
    ------
    DenocError
        A process failed.
    """
    flags = [str(int(loops)), str(int(plans))]
    processes = [
        subprocess.Popen(
            [sys.executable, '-m', 'denoc_ros.cli.kernels_ahead', order, *flags],
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


def _seconds(kernel: Any) -> float:
    return HEAVY.get(kernel.py_func.__name__, USUAL)


def main(arguments: list[str]) -> None:
    """Compile from one end of the list."""
    from denoc_ros.kernels.compiled import ready

    order, loops, plans = arguments
    found = kernels(loops == '1', plans == '1')
    for kernel in found if order == ORDERS[0] else reversed(found):
        ready(kernel)


if __name__ == '__main__':
    main(sys.argv[1:])
