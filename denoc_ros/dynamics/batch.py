"""Many states in one call: rows shared out over threads, each with a workspace of its own."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.robot_model import RobotModel
from denoc_ros.dynamics.validation import same_rows
from denoc_ros.kernels.compiled import ready
from denoc_ros.types import Array

ROWS_PER_THREAD = 64  # below that a thread costs more than it saves


def cores() -> int:
    """Return how many processors this process may use."""
    return (
        len(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else os.cpu_count() or 1
    )


@lru_cache(maxsize=1)
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max_workers=cores(), thread_name_prefix='denoc-rows')


def run_rows(
    robot: RobotModel,
    kernel: Any,
    count: int,
    inputs: Sequence[Any],
    outputs: Sequence[NDArray[Any]],
) -> int:
    """Run a `*_rows` kernel over all rows; return the worst status of all threads.

    Parameters
    ----------
    kernel : compiled function
    inputs, outputs : arrays that follow the handle in the kernel's arguments, rows first .. last
        standing between them.
    """
    if not kernel.overloads:
        ready(kernel)
    chunks = max(1, min(cores(), count // ROWS_PER_THREAD))
    edges = [count * k // chunks for k in range(chunks + 1)]

    spaces = [robot.new_workspace() for _ in range(chunks)] if chunks > 1 else []

    def run(k: int) -> int:
        handle = spaces[k].handle if spaces else robot.handle
        return int(kernel(handle, *inputs, edges[k], edges[k + 1], *outputs))

    return max(_pool().map(run, range(chunks))) if spaces else run(0)


def each_row(function: Callable[..., Any], *states: Array) -> Any:
    """Return function(*states) of vectors, or of rows one by one, its results stacked.

    A function that returns a tuple gives a tuple of stacked arrays.
    """
    if all(state.ndim == 1 for state in states):
        return function(*states)
    results = [function(*row) for row in zip(*same_rows(states), strict=True)]
    if isinstance(results[0], tuple):
        return tuple(np.array(part) for part in zip(*results, strict=True))
    return np.array(results)
