"""Numbers that vary along a beam: shares of their mean, as polynomials between breaks."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.polynomial import chebyshev

from denoc_ros.types import Array

DEGREE = 12  # a cube root of any length, interpolated cubically, to the fourth power
SAME = 1e-13  # relative: what arithmetic leaves of numbers that are equal


@cache
def _nodes() -> Array:
    """Return the Chebyshev points (DEGREE + 1,) on -1 .. 1."""
    return np.asarray(chebyshev.chebpts1(DEGREE + 1))


@cache
def _gauss() -> tuple[Array, Array]:
    nodes, weights = np.polynomial.legendre.leggauss(16)
    return np.asarray(nodes), np.asarray(weights)


@dataclass(frozen=True)
class Along:
    """A function of the share 0 .. 1 of a beam's length: a polynomial between each two breaks."""

    # rising, from 0 to 1. At a break the function, or a derivative of it, may jump.
    breaks: tuple[float, ...] = (0.0, 1.0)
    pieces: tuple[tuple[float, ...], ...] = ((1.0,),)  # Chebyshev coefficients of each interval

    @cached_property
    def uniform(self) -> bool:
        """Whether it is one number all along."""
        return len(self.pieces) == 1 and len(self.pieces[0]) == 1

    @cached_property
    def _coefficients(self) -> Array:
        table = np.zeros((max(len(piece) for piece in self.pieces), len(self.pieces)))
        for column, piece in enumerate(self.pieces):
            table[: len(piece), column] = piece
        return table

    def values(self, share: Array, order: int = 0) -> Array:
        """Return the function, or a derivative, at shares of the length.

        At a break it is that of the outboard side.
        """
        share = np.asarray(share, dtype=np.float64)
        edges: Array = np.array(self.breaks)
        place = np.clip(np.searchsorted(edges, share, side='right') - 1, 0, len(self.pieces) - 1)
        width = edges[place + 1] - edges[place]
        local = 2.0 * (share - edges[place]) / width - 1.0
        table: Array = self._coefficients
        if order:
            steep = chebyshev.chebder(table, order) if len(table) > order else 0.0 * table[:1]
            table = np.asarray(steep, dtype=np.float64)
        found = chebyshev.chebval(local, table[:, place], tensor=False)
        return np.asarray(found * (2.0 / width) ** order)

    def integral(self, start: float, end: float, power: int = 0) -> float:
        """Return the integral of x^power times the function from one share to another."""
        inner = [x for x in self.breaks if start < x < end]
        edges = np.array([start, *inner, end])
        node, weight = _gauss()
        half = 0.5 * np.diff(edges)[:, None]
        x = edges[:-1, None] + half * (node + 1.0)
        return float(np.sum(half * weight * x**power * self.values(x)))

    def moment(self, power: int) -> float:
        """Return the integral of x^power times the function over the whole."""
        if self.uniform:
            return self.pieces[0][0] / (power + 1.0)
        return self.integral(0.0, 1.0, power)

    def part(self, start: float, end: float) -> Along:
        """Return the function between two shares, as one of the share of that part."""
        if self.uniform or (start, end) == (0.0, 1.0):
            return self
        inner = [x for x in self.breaks if start + SAME < x < end - SAME]
        edges = np.array([start, *inner, end])
        nodes = _nodes() + 1.0
        samples = [self.values(a + 0.5 * (b - a) * nodes) for a, b in itertools.pairwise(edges)]
        return fitted((edges - start) / (end - start), samples)


CONSTANT = Along()


def fitted(edges: Array, samples: list[Array]) -> Along:
    """Return the function through samples at `sample_shares` of each interval."""
    flat = np.concatenate(samples)
    size = float(np.max(np.abs(flat)))
    if np.ptp(flat) <= SAME * size:
        return Along(pieces=((float(flat[0]),),))
    matrix = chebyshev.chebvander(_nodes(), DEGREE)
    pieces = []
    for sample in samples:
        fit = np.linalg.solve(matrix, sample)
        fit = chebyshev.chebtrim(fit, 4.0 * np.finfo(np.float64).eps * size)
        pieces.append(tuple(float(value) for value in fit))
    return Along(tuple(float(x) for x in edges), tuple(pieces))


def sample_shares() -> Array:
    """Return the shares of an interval at which `mean_and_along` asks for a function."""
    return np.asarray(0.5 * (_nodes() + 1.0))


def mean_and_along(breaks: Array, samples: list[Array]) -> tuple[float, Along]:
    """Return the mean of a function along a beam, and the function as shares of it.

    Parameters
    ----------
    breaks : ndarray (k + 1,)
        Shares of the length, 0 first, 1 last.
    samples : list of k ndarrays (n,)
        Values at `sample_shares` of each interval.

    Returns
    -------
    float, Along
        A function that is one number gives that number, to the digit, and `CONSTANT`.
    """
    raw = fitted(breaks, samples)
    mean = raw.moment(0)
    if raw.uniform or mean == 0.0:
        return mean, CONSTANT
    pieces = tuple(tuple(value / mean for value in piece) for piece in raw.pieces)
    return mean, Along(raw.breaks, pieces)
