"""The motion whose recording tells most: D-optimal within the limits."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linprog

from denoc_ros.errors import SolverError
from denoc_ros.identification.model.excited_channels import ExcitedChannels
from denoc_ros.identification.model.free_parameters import PRIOR
from denoc_ros.identification.model.motion_space import FULL, MotionSpace
from denoc_ros.types import Array

DRAWN = 16  # motions at random, the best of which the search starts from
FEWEST = 3  # of them, whatever the time
STARTS = 2  # of the search, as far as time allows
ITERATIONS = 60
STEP = 1e-4  # of the differences by x
SETTLED = 3e-3  # what a step must gain: 0.3 % of the intervals
WIDEST, NARROWEST = 0.3, 3e-3  # of the largest x: radius of a step
WIDER, NARROWER = 1.5, 0.4
NEAR = 0.5  # shares of limits that a step looks at
REGROWN = 1.3  # by how much a step may be scaled up to the limits
NOTHING = 1e3  # the criterion of a motion that the robot cannot follow


class _TimeIsOverError(Exception):
    """The search has taken as long as it may."""


@dataclass
class SearchClock:
    """Time limit of a search, and reports of its progress.

    Processor time: on a busy machine a search takes longer and comes as far.
    """

    limit: float
    report: Callable[[float], None]
    began: float = field(default_factory=time.process_time)

    @property
    def elapsed(self) -> float:
        """Processor time since the begin [s]."""
        return time.process_time() - self.began

    def check(self) -> None:
        """Tell the share of the time that is over; raise when it is all of it."""
        self.report(min(self.elapsed / self.limit, 1.0))
        if self.elapsed > self.limit:
            raise _TimeIsOverError


def random_motions(space: MotionSpace, times: Array, seed: int, clock: SearchClock) -> list[Array]:
    """Return motions drawn at random, all at their limits; fewer when half the time is over."""
    draw, found = np.random.default_rng(seed), list[Array]()
    while len(found) < DRAWN:
        found.append(space.to_limits(draw.normal(size=space.size), times))
        if len(found) >= FEWEST and clock.elapsed > 0.5 * clock.limit:
            break
    return found


class ExcitationSearch:
    """D-optimal motions: the determinant of the information and of a prior is the largest.

    Parameters
    ----------
    space : MotionSpace
    channels : ExcitedChannels
    times : (k,) array
        At which motions are worked out.
    """

    def __init__(self, space: MotionSpace, channels: ExcitedChannels, times: Array) -> None:
        self._space, self._channels, self._times = space, channels, times

    def criterion(self, x: Array) -> float:
        """Return how little is known after a motion: mean logarithm of the intervals, shifted.

        -log det(H + prior) / (2 p), so that a change by -0.01 is 1 % of the intervals.
        """
        try:
            jacobian = self._channels.jacobian(self._space.rows(x, self._times))
        except SolverError:  # bent beyond what a model of small deflections has
            return NOTHING
        size = jacobian.shape[1]
        whole = jacobian.T @ jacobian + np.eye(size) / PRIOR**2
        return float(-np.linalg.slogdet(whole)[1] / (2 * size))

    def best(self, motions: list[Array], clock: SearchClock) -> tuple[Array, float]:
        """Return the best motion found from given ones within the time, and its criterion."""
        order = sorted((self.criterion(x), k) for k, x in enumerate(motions))
        least, place = order[0]
        best = motions[place]
        for value, k in order[:STARTS]:
            try:
                for found, reached in self._improving(motions[k], value, clock):
                    if reached < least:
                        best, least = found, reached
            except _TimeIsOverError:
                break
        return best, least

    def _improving(
        self, x: Array, value: float, clock: SearchClock
    ) -> Iterator[tuple[Array, float]]:
        """Yield ever better motions and their criteria: linear programs within a radius.

        Each keeps the limits: what a step takes too much is scaled back.
        """
        radius = WIDEST * float(np.abs(x).max())
        for _ in range(ITERATIONS):
            slopes, shares, edges = self._slopes(x, value, clock)
            gained = 0.0
            while gained < SETTLED and radius > NARROWEST * float(np.abs(x).max()):
                clock.check()
                step = _linear_step(slopes, shares, edges, radius)
                trial = self._space.to_limits(x + step, self._times, REGROWN)
                gained = value - self.criterion(trial)
                radius *= WIDER if gained >= SETTLED else NARROWER
            if gained < SETTLED:
                return
            x, value = trial, value - gained
            yield x, value

    def _slopes(self, x: Array, value: float, clock: SearchClock) -> tuple[Array, Array, Array]:
        """Return the derivatives of the criterion (x,), the shares (m,) that matter and theirs.

        Shares of limits near or beyond which the motion is at some time, all to one side.
        """
        shares = self._space.shares(x, self._times).ravel()
        near = np.flatnonzero(np.abs(shares) > NEAR)
        side = np.sign(shares[near])
        slopes, edges = np.empty(len(x)), np.empty((len(near), len(x)))
        for k in range(len(x)):
            clock.check()
            moved = x.copy()
            moved[k] += STEP
            slopes[k] = (self.criterion(moved) - value) / STEP
            after = self._space.shares(moved, self._times).ravel()[near]
            edges[:, k] = side * (after - shares[near]) / STEP
        return slopes, np.abs(shares[near]), edges


def _linear_step(slopes: Array, shares: Array, edges: Array, radius: float) -> Array:
    """Return the step (x,) within a radius that lowers the criterion most, limits kept."""
    room = np.maximum(FULL - shares, 0.0)
    found = linprog(slopes, A_ub=edges, b_ub=room, bounds=[(-radius, radius)] * len(slopes))
    return np.asarray(found.x, dtype=np.float64)
