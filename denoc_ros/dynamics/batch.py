"""Many states in one call: rows shared out over threads, each with a workspace of its own."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from denoc_ros.model.lowering import SLIP_RATE

if TYPE_CHECKING:
    from denoc_ros.dynamics.held_model import HeldModel

Array = NDArray[np.float64]
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
    robot: HeldModel,
    kernel: Callable[..., Any],
    count: int,
    inputs: Sequence[Array],
    outputs: Sequence[Array],
    held: NDArray[np.int64] | None = None,
    slip: bool = True,
) -> Any:
    """Run a `*_rows` kernel over all rows; return its status (the worst of all threads).

    Parameters
    ----------
    inputs, outputs : arrays that follow the model's in the kernel's arguments, rows first .. last
        standing between them.
    held : per-body flags, for the articulated kernels
    slip : bool
        Whether the kernel takes the slip rate of Coulomb friction.
    """
    low = robot.lowered
    chunks = max(1, min(cores(), count // ROWS_PER_THREAD))
    edges = [count * k // chunks for k in range(chunks + 1)]

    def run(k: int) -> Any:
        work = robot.model_arrays[2] if chunks == 1 else np.zeros(low.work_size)
        head = [low.ints, robot.model_arrays[1], work, low.diagonals]
        head += [] if held is None else [held]
        head += [low.bodies, SLIP_RATE] if slip else [low.bodies]
        return kernel(*head, *inputs, edges[k], edges[k + 1], *outputs)

    if chunks == 1:
        return run(0)
    statuses = list(_pool().map(run, range(chunks)))
    return all(statuses) if held is None else max(statuses)
