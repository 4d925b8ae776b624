"""Many states in one call: rows shared out over threads, each with a workspace of its own."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from math import prod
from typing import Any

import numpy as np

from denoc_ros.dynamics.robot_model import RobotModel
from denoc_ros.dynamics.validation import same_rows
from denoc_ros.kernels.jit.compiled import entry
from denoc_ros.types import Array

# rows times coordinates of a thread: with fewer it costs more, some 60 us, than it saves
LEAST_PER_THREAD = 2000


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
    *arrays: Array,
) -> int:
    """Run a kernel of :func:`~denoc_ros.kernels.dynamics.states.over_rows` on all rows of states.

    Parameters
    ----------
    kernel : compiled function
    count : int
        Number of states.
    *arrays : (count, ...), or (m,) or (1, m) for what is the same for all states
        What the kernel's computation reads, then what it writes; C-contiguous float64.

    Returns
    -------
    int
        The worst status of all rows.
    """
    wide = [a[None] if a.ndim == 1 else a for a in arrays]
    rows = tuple([a if a.ndim == 2 else a.reshape(len(a), prod(a.shape[1:])) for a in wide])
    compiled = entry(kernel)
    if _threads(robot, count) == 1:
        return compiled(robot.handle, rows, 0, count)
    return run_chunks(robot, count, lambda handle, *edges: compiled(handle, rows, *edges))


def run_chunks(robot: RobotModel, count: int, run: Callable[..., int]) -> int:
    """Return the worst status of run(handle, first, last) over rows shared out over threads."""
    chunks = _threads(robot, count)
    if chunks == 1:
        return run(robot.handle, 0, count)
    edges = [count * k // chunks for k in range(chunks + 1)]
    spaces = [robot.new_workspace() for _ in range(chunks)]
    handles = [space.handle for space in spaces]
    return max(_pool().map(run, handles, edges[:-1], edges[1:]))


def _threads(robot: RobotModel, count: int) -> int:
    """Return on how many threads so many rows are shared out."""
    threads = count * robot.n // LEAST_PER_THREAD
    return min(cores(), threads) if threads > 1 else 1


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
