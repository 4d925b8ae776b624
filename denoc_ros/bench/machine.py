"""Peak rate of one core of this machine, measured by compiled loops."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from denoc_ros.kernels.compiled import kernel, ready

TURNS = 4_000  # of a loop per measurement: short enough to run undisturbed now and then
CHAINS = 8  # independent numbers in a loop, enough to fill the pipelines
REPEATS = 300


@kernel('float64(int64, float64, float64)')
def fused(turns: int, a: float, b: float) -> float:
    """Turn eight independent numbers by x a + b; one fused operation each."""
    s, t, u, v = b, 2.0 * b, 3.0 * b, 4.0 * b
    w, x, y, z = 5.0 * b, 6.0 * b, 7.0 * b, 8.0 * b
    for _ in range(turns):
        s = s * a + b
        t = t * a + b
        u = u * a + b
        v = v * a + b
        w = w * a + b
        x = x * a + b
        y = y * a + b
        z = z * a + b
    return s + t + u + v + w + x + y + z


@kernel('float64(int64, float64, float64)')
def divided(turns: int, a: float, b: float) -> float:
    """Divide eight independent numbers."""
    s, t, u, v = b, 2.0 * b, 3.0 * b, 4.0 * b
    w, x, y, z = 5.0 * b, 6.0 * b, 7.0 * b, 8.0 * b
    for _ in range(turns):
        s = a / s
        t = a / t
        u = a / u
        v = a / v
        w = a / w
        x = a / x
        y = a / y
        z = a / z
    return s + t + u + v + w + x + y + z


@kernel('float64(int64, float64, float64)')
def rooted(turns: int, a: float, b: float) -> float:
    """Take the roots of eight independent numbers."""
    s, t, u, v = b, 2.0 * b, 3.0 * b, 4.0 * b
    w, x, y, z = 5.0 * b, 6.0 * b, 7.0 * b, 8.0 * b
    for _ in range(turns):
        s = np.sqrt(s)
        t = np.sqrt(t)
        u = np.sqrt(u)
        v = np.sqrt(v)
        w = np.sqrt(w)
        x = np.sqrt(x)
        y = np.sqrt(y)
        z = np.sqrt(z)
    return s + t + u + v + w + x + y + z + a


@kernel('float64(int64, float64, float64)')
def turned(turns: int, a: float, b: float) -> float:
    """Take sine and cosine of eight angles."""
    total = 0.0
    for k in range(turns):
        for n in range(4):
            x = a * k + b * n
            total += np.sin(x) + np.cos(x)
    return total


@dataclass(frozen=True)
class Machine:
    """Times per operation of one core, nothing waiting for anything [s].

    Attributes
    ----------
    fused : float
        A scalar multiplication with its addition.
    division, root, trigonometric : float
    """

    fused: float
    division: float
    root: float
    trigonometric: float


def measure_machine() -> Machine:
    """Return the shortest times that were seen."""
    ready(fused, divided, rooted, turned)
    return Machine(*(_shortest(loop) for loop in (fused, divided, rooted, turned)))


def _shortest(loop: Any) -> float:
    clock = time.perf_counter
    took = []
    for _ in range(REPEATS):
        start = clock()
        loop(TURNS, 0.999, 0.001)
        took.append(clock() - start)
    return min(took) / (TURNS * CHAINS)
