"""Shape functions of beams in bending and torsion.

Every bending mode of an Euler-Bernoulli beam of length l is, with z = beta x / l,

    s(x) = A exp(-z) + B exp(z - beta) + C cos z + D sin z

which needs no difference of large cosh and sinh terms and so keeps its digits at any order. A
shape function here is a linear combination of such waves and of cubics (the static shapes of a
Craig-Bampton set), scaled to max |s| = 1 on the beam.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from typing import TypeVar, cast

import numpy as np
from scipy.linalg import eigh

from denoc_ros.errors import StateError
from denoc_ros.model.beams.along import CONSTANT, Along
from denoc_ros.types import Array

# Below this, a boundary value of a function scaled to 1 is the rounding of a zero.
BOUNDARY_ZERO = 1e-7
Edges = Sequence[float] | Array
EDGE = 1e-12  # share of a length: edges that are nearer are one


AnyShapes = TypeVar('AnyShapes', bound='ShapeFunctions')


class ShapeFunctions(ABC):
    """Shape functions of one deformation of a beam, by rising frequency."""

    length: float  # of the beam [m]

    @property
    def edges(self) -> tuple[float, ...]:
        """Shares of the length, from 0 to 1, between each two of which the shapes are smooth."""
        return 0.0, 1.0

    @property
    @abstractmethod
    def modes(self) -> int:
        """Number of shape functions."""

    @abstractmethod
    def derivatives(self, x: Array, order: int) -> Array:
        """Return the derivative of a given order [1/m^order], (k, modes), at stations x (k,)."""

    @abstractmethod
    def combined(self, matrix: Array) -> ShapeFunctions:
        """Return the combinations of the shapes that the columns of a matrix make."""

    def values(self, x: Array) -> Array:
        """Return s(x).

        Parameters
        ----------
        x : ndarray (k,)
            Stations [m], 0 at the root.

        Returns
        -------
        ndarray (k, modes)
            Values [-], at most 1 in size on the beam.
        """
        return self.derivatives(x, 0)

    def slopes(self, x: Array) -> Array:
        """Return s'(x) [1/m], (k, modes), at stations x (k,) [m]."""
        return self.derivatives(x, 1)

    def curvatures(self, x: Array) -> Array:
        """Return s''(x) [1/m^2], (k, modes), at stations x (k,) [m]."""
        return self.derivatives(x, 2)

    def third_derivatives(self, x: Array) -> Array:
        """Return s'''(x) [1/m^3], (k, modes), at stations x (k,) [m]."""
        return self.derivatives(x, 3)

    def gram(self, order: int, along: Along = CONSTANT) -> Array:
        """Return the integrals over the beam of products of derivatives.

        Parameters
        ----------
        order : int
            0 for int s s^T dx [m], 1 for slopes [1/m], 2 for curvatures [1/m^3].
        along : Along
            Weight of the integrand.

        Returns
        -------
        ndarray (modes, modes)
            Exact to rounding; worked out once, not to be written.
        """
        key = order, along
        if key not in self._grams:
            if len(self.edges) == 2 and along.uniform:
                x, weights = quadrature(self.length, 24 + 4 * self.modes)
            else:
                x, weights = panels(self.length, merged_edges(self.edges, along.breaks), 24)
            part = self.derivatives(x, order)
            weights = weights * along.values(x / self.length)
            gram: Array = (part * weights[:, None]).T @ part
            gram.setflags(write=False)
            self._grams[key] = gram
        return self._grams[key]

    @cached_property
    def _grams(self) -> dict[tuple[int, Along], Array]:
        """Results of `gram`: a change of damping asks for them again."""
        return {}


@dataclass(frozen=True, eq=False)
class WaveShapes(ShapeFunctions):
    """Shape functions of a uniform beam."""

    length: float  # length of the beam [m]
    wave_numbers: Array  # (w,) beta of the waves [-]
    waves: Array  # (w, 4) a, B, C, D of each wave
    cubics: Array  # (c, 4) coefficients of each cubic in x / length, constant first
    # (w + c, modes) each column makes one shape function of the waves and cubics
    mixing: Array

    @property
    def modes(self) -> int:
        """Number of shape functions."""
        return int(self.mixing.shape[1])

    def derivatives(self, x: Array, order: int) -> Array:
        """Return the derivative of a given order [1/m^order], (k, modes), at stations x (k,)."""
        xi = np.atleast_1d(np.asarray(x, dtype=np.float64)) / self.length
        basis = np.hstack([self._waves_at(xi, order), self._cubics_at(xi, order)])
        return np.asarray(basis @ self.mixing / self.length**order)

    def combined(self, matrix: Array) -> WaveShapes:
        """Return the combinations of the shapes that the columns of a matrix make."""
        mixing = np.asarray(self.mixing @ matrix)
        return WaveShapes(self.length, self.wave_numbers, self.waves, self.cubics, mixing)

    def _waves_at(self, xi: Array, order: int) -> Array:
        beta = self.wave_numbers
        a, b, c, d = self.waves.T
        for _ in range(order):
            a, c, d = -a, d, -c
        z = np.outer(xi, beta)
        wave = a * np.exp(-z) + b * np.exp(z - beta) + c * np.cos(z) + d * np.sin(z)
        return np.asarray(wave * beta**order)

    def _cubics_at(self, xi: Array, order: int) -> Array:
        polynomials = self.cubics.T
        if order and len(self.cubics):
            polynomials = np.polynomial.polynomial.polyder(polynomials, order)
        return np.asarray(np.polynomial.polynomial.polyval(xi, polynomials).T)


STEP, HINGE = 0, 1  # the lowest derivative that jumps


@dataclass(frozen=True)
class CutShapes(ShapeFunctions):
    """Shape functions, and behind them those of a beam that is cut at some stations."""

    smooth: ShapeFunctions
    # station [m], and HINGE (x - station beyond it, 0 before) or STEP (1 beyond it). Their
    # curvature at the station itself is left out.
    cuts: tuple[tuple[float, int], ...]

    @property
    def length(self) -> float:  # type: ignore[override]
        """Length of the beam [m]."""
        return self.smooth.length

    @property
    def edges(self) -> tuple[float, ...]:
        """Shares of the length, from 0 to 1, between each two of which the shapes are smooth."""
        return merged_edges(self.smooth.edges, [at / self.length for at, _ in self.cuts])

    @property
    def modes(self) -> int:
        """Number of shape functions."""
        return self.smooth.modes + len(self.cuts)

    def derivatives(self, x: Array, order: int) -> Array:
        """Return the derivative of a given order [1/m^order], (k, modes), at stations x (k,)."""
        x = np.atleast_1d(np.asarray(x, dtype=np.float64))
        beyond = np.array([x - at for at, _ in self.cuts]).T
        powers = np.array([kind for _, kind in self.cuts]) - order
        cut = np.where((beyond >= 0.0) & (powers >= 0), beyond ** np.maximum(powers, 0), 0.0)
        return np.hstack([self.smooth.derivatives(x, order), cut])

    def combined(self, matrix: Array) -> ShapeFunctions:
        """Return the combinations of the shapes that the columns of a matrix make."""
        raise StateError('shapes of a beam that is cut must not be combined, got a matrix')


@cache
def gauss_rule(points: int) -> tuple[Array, Array]:
    """Return nodes on -1 .. 1 and weights, each (points,); worked out once, not to be written."""
    nodes, weights = np.polynomial.legendre.leggauss(points)
    nodes.setflags(write=False)
    weights.setflags(write=False)
    return nodes, weights


def quadrature(length: float, points: int) -> tuple[Array, Array]:
    """Return Gauss-Legendre stations and weights [m] on 0 .. length, each (points,)."""
    nodes, weights = gauss_rule(points)
    return 0.5 * length * (nodes + 1.0), 0.5 * length * weights


def panels(length: float, edges: Edges, points: int) -> tuple[Array, Array]:
    """Return Gauss stations and weights [m] of a beam, so many between each two edges."""
    nodes, weights = gauss_rule(points)
    at = length * np.asarray(edges)
    half = 0.5 * np.diff(at)[:, None]
    return (at[:-1, None] + half * (nodes + 1.0)).ravel(), (half * weights).ravel()


def merged_edges(*each: Edges) -> tuple[float, ...]:
    """Return the shares of all, rising, without those that are equal but for rounding."""
    every = np.unique(np.concatenate([np.asarray(edges) for edges in each]))
    apart = np.concatenate([[True], np.diff(every) > EDGE])
    merged = every[apart]
    merged[-1] = 1.0
    return tuple(float(x) for x in merged)


@lru_cache(maxsize=256)
def shape_functions(shape: str, modes: int, length: float) -> WaveShapes:
    """Return bending shape functions of a uniform beam.

    Parameters
    ----------
    shape : str
        One of `SHAPES`: clamped-free, clamped-clamped, clamped-pinned, pinned-pinned (root
        first) or craig-bampton.
    modes : int
        Number of shape functions, >= 1; craig-bampton: >= 2, its two static shapes included.
    length : float
        Length of the beam [m].

    Returns
    -------
    ShapeFunctions
        Scaled to max |s| = 1, positive at the tip; where s(tip) = 0 positive just inboard of it
        (negative slope at the tip, or positive curvature where the slope is 0 as well).

    Raises
    ------
    StateError
        For an unknown shape, too few modes or a length that is not positive.
    """
    _check(shape in SHAPES, 'shape', f'one of {", ".join(SHAPES)}', shape)
    _check_counts(modes, length, 2 if shape == 'craig-bampton' else 1)
    unit = _unit_shapes(shape, modes)
    return WaveShapes(length, unit.wave_numbers, unit.waves, unit.cubics, unit.mixing)


def torsion_shapes(modes: int, length: float) -> WaveShapes:
    """Return shape functions sin((j - 1/2) pi x / length) of twist, positive at the tip.

    Parameters
    ----------
    modes : int
        Number of shape functions, >= 1.
    length : float
        Length of the beam [m].

    Returns
    -------
    ShapeFunctions
        Scaled to max |s| = 1.

    Raises
    ------
    StateError
        For too few modes or a length that is not positive.
    """
    _check_counts(modes, length, 1)
    index: Array = np.arange(1.0, modes + 1)
    waves = np.zeros((modes, 4))
    waves[:, 3] = (-1.0) ** (index + 1)
    return WaveShapes(length, (index - 0.5) * np.pi, waves, np.zeros((0, 4)), np.eye(modes))


def wave_numbers(shape: str, modes: int) -> Array:
    """Return the eigenvalues beta = l sqrt(omega) (rho / EI)^(1/4) of a shape, (modes,).

    Notes
    -----
    cosh(beta) cos(beta) = -1 clamped-free, 1 clamped-clamped; tan(beta) = tanh(beta)
    clamped-pinned; sin(beta) = 0 pinned-pinned. Solved for the small distance from the
    asymptote, which converges to rounding.
    """
    index: Array = np.arange(1.0, modes + 1)
    if shape == 'pinned-pinned':
        return np.asarray(index * np.pi)
    if shape == 'clamped-pinned':
        return _iterate(
            lambda beta: np.asarray(index * np.pi + np.arctan(np.tanh(beta))), index * np.pi
        )
    offset = -0.5 if shape == 'clamped-free' else 0.5
    asymptote: Array = (index + offset) * np.pi
    sign: Array = (-1.0) ** (index + 1)
    return _iterate(
        lambda beta: np.asarray(asymptote + np.arcsin(sign / np.cosh(beta))), asymptote
    )


def _iterate(step: Callable[[Array], Array], start: Array) -> Array:
    """Return the fixed point of a contraction of factor <= 0.3."""
    beta = start
    for _ in range(64):
        beta = step(beta)
    return np.asarray(beta)


def _check(holds: bool, name: str, rule: str, value: object) -> None:
    if not holds:
        raise StateError(f'shape functions: {name} must be {rule}, got {value!r}')


def _check_counts(modes: int, length: float, least: int) -> None:
    _check(modes >= least, 'modes', f'>= {least}', modes)
    _check(np.isfinite(length) and length > 0.0, 'length', '> 0 m', length)


def _clamped_free(beta: Array) -> Array:
    """Return A, B, C, D (w, 4) from s(0) = s'(0) = s''(1) = 0."""
    decay, sine, cosine = np.exp(-beta), np.sin(beta), np.cos(beta)
    b = (sine - cosine - decay) / (1.0 + decay * (cosine + sine))
    return _clamped_root(beta, b)


def _clamped_clamped(beta: Array) -> Array:
    """Return A, B, C, D (w, 4) from s(0) = s'(0) = s(1) = 0."""
    decay, sine, cosine = np.exp(-beta), np.sin(beta), np.cos(beta)
    b = (cosine - sine - decay) / (1.0 - decay * (cosine + sine))
    return _clamped_root(beta, b)


def _clamped_pinned(beta: Array) -> Array:
    """Return A, B, C, D (w, 4) from s(0) = s'(0) = s(1) + s''(1) = 0."""
    return _clamped_root(beta, -np.exp(-beta))


def _pinned_pinned(beta: Array) -> Array:
    """Return A, B, C, D (w, 4) of sines."""
    zero = np.zeros_like(beta)
    return np.column_stack([zero, zero, zero, zero + 1.0])


def _clamped_root(beta: Array, b: Array) -> Array:
    """Return A, B, C, D (w, 4) with A = 1, given B, from s(0) = s'(0) = 0."""
    a = np.ones_like(beta)
    root = b * np.exp(-beta)
    return np.column_stack([a, b, -a - root, a - root])


_WAVES: dict[str, Callable[[Array], Array]] = {
    'clamped-free': _clamped_free,
    'clamped-clamped': _clamped_clamped,
    'clamped-pinned': _clamped_pinned,
    'pinned-pinned': _pinned_pinned,
}
SHAPES = (*_WAVES, 'craig-bampton')


@lru_cache(maxsize=64)
def _unit_shapes(shape: str, modes: int) -> WaveShapes:
    """Return the scaled shapes of a beam of length 1; the scaled values hold at any length."""
    if shape == 'craig-bampton':
        return scaled_shapes(_craig_bampton(modes))
    beta = wave_numbers(shape, modes)
    return scaled_shapes(
        WaveShapes(1.0, beta, _WAVES[shape](beta), np.zeros((0, 4)), np.eye(modes))
    )


def _craig_bampton(modes: int) -> WaveShapes:
    """Return the two static and modes - 2 clamped-clamped shapes, diagonalized, unscaled."""
    static = np.array([[0.0, 0.0, 3.0, -2.0], [0.0, 0.0, -1.0, 1.0]])
    beta = wave_numbers('clamped-clamped', modes - 2)
    raw = WaveShapes(1.0, beta, _clamped_clamped(beta), static, np.eye(modes))
    _, mixing = eigh(raw.gram(2), raw.gram(0))
    return WaveShapes(1.0, beta, raw.waves, static, np.asarray(mixing))


def scaled_shapes(raw: AnyShapes) -> AnyShapes:
    """Return shapes scaled to max |s| = 1 and positive at, or just inboard of, the tip."""
    scale = _largest_values(raw)
    tip = np.array([raw.length])
    value, slope, curvature = (
        raw.derivatives(tip, order)[0] * raw.length**order / scale for order in range(3)
    )
    sign = np.where(np.abs(slope) > BOUNDARY_ZERO, -np.sign(slope), np.sign(curvature))
    sign = np.where(np.abs(value) > BOUNDARY_ZERO, np.sign(value), sign)
    return cast(AnyShapes, raw.combined(np.diag(sign / scale)))


def _largest_values(raw: ShapeFunctions) -> Array:
    """Return max |s| over the beam of each shape, (modes,), its tip and inner extrema."""
    grid = np.linspace(0.0, raw.length, 64 * (raw.modes + 1) + 1)
    column = np.arange(raw.modes)
    place = grid[np.argmax(np.abs(raw.values(grid)), axis=0)]
    best = np.abs(raw.values(place)[column, column])
    for _ in range(4):
        slope = raw.slopes(place)[column, column]
        curvature = raw.curvatures(place)[column, column]
        step = np.divide(slope, curvature, out=np.zeros_like(slope), where=curvature != 0.0)
        place = np.clip(place - np.clip(step, -grid[1], grid[1]), 0.0, raw.length)
        best = np.maximum(best, np.abs(raw.values(place)[column, column]))
    return np.asarray(best)
