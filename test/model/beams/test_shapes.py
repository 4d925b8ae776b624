"""Laws of the shape functions."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import brentq

from denoc_ros.errors import StateError
from denoc_ros.model.beams.shapes import (
    SHAPES,
    ShapeFunctions,
    WaveShapes,
    shape_functions,
    torsion_shapes,
    wave_numbers,
)
from denoc_ros.types import Array

LENGTH = 2.5
WAVES = [shape for shape in SHAPES if shape != 'craig-bampton']
# Characteristic functions divided by cosh, so that they are of size 1 at any order.
CHARACTERISTIC: dict[str, Callable[[float], float]] = {
    'clamped-free': lambda b: math.cos(b) + 1.0 / math.cosh(b),
    'clamped-clamped': lambda b: math.cos(b) - 1.0 / math.cosh(b),
    'clamped-pinned': lambda b: math.sin(b) - math.tanh(b) * math.cos(b),
    'pinned-pinned': math.sin,
}
# Derivatives that vanish at root and tip.
BOUNDARY = {
    'clamped-free': ((0, 1), (2, 3)),
    'clamped-clamped': ((0, 1), (0, 1)),
    'clamped-pinned': ((0, 1), (0, 2)),
    'pinned-pinned': ((0, 2), (0, 2)),
    'craig-bampton': ((0, 1), ()),
}


def every(modes: int) -> list[tuple[str, ShapeFunctions]]:
    found = [(shape, shape_functions(shape, modes, LENGTH)) for shape in SHAPES]
    return [*found, ('torsion', torsion_shapes(modes, LENGTH))]


def correlation(gram: Array) -> Array:
    size = np.sqrt(np.diag(gram))
    return np.asarray(gram / np.outer(size, size))


@pytest.mark.parametrize('shape', WAVES)
def test_eigenvalues_are_the_roots_that_bisection_finds(shape: str) -> None:
    function = CHARACTERISTIC[shape]
    grid = np.linspace(0.5, 40.0, 4000)
    values = [function(b) for b in grid]
    roots = [
        brentq(function, a, b, xtol=1e-15, rtol=1e-15)
        for a, b, fa, fb in zip(grid, grid[1:], values, values[1:], strict=False)
        if fa * fb < 0.0
    ][:12]
    np.testing.assert_allclose(wave_numbers(shape, 12), roots, rtol=4e-16, atol=2e-14)


def test_first_eigenvalues_are_the_tables() -> None:
    np.testing.assert_allclose(
        wave_numbers('clamped-free', 2), [1.8751040687119611, 4.694091132974175], rtol=1e-15
    )


@pytest.mark.parametrize('modes', [2, 12])
def test_shapes_are_orthogonal_in_mass_and_stiffness(modes: int) -> None:
    # craig-bampton's come from an eigenvalue problem, and round by the processor's BLAS: 2e-11
    for shape, functions in every(modes):
        orders = (0, 1) if shape == 'torsion' else (0, 2)
        for order in orders:
            np.testing.assert_allclose(
                correlation(functions.gram(order)), np.eye(modes), atol=1e-10, err_msg=shape
            )


def test_rayleigh_quotient_is_the_eigenvalue() -> None:
    for shape in WAVES:
        functions = shape_functions(shape, 12, LENGTH)
        quotient = np.diag(functions.gram(2)) / np.diag(functions.gram(0)) * LENGTH**4
        np.testing.assert_allclose(quotient**0.25, wave_numbers(shape, 12), rtol=1e-13)


@pytest.mark.parametrize('modes', [2, 5, 12])
def test_largest_value_on_the_beam_is_one(modes: int) -> None:
    x = np.linspace(0.0, LENGTH, 40001)
    for shape, functions in every(modes):
        peak = np.abs(functions.values(x)).max(axis=0)
        np.testing.assert_allclose(peak, 1.0, atol=1e-6, err_msg=shape)
        assert peak.max() <= 1.0 + 1e-14, shape


def test_shapes_are_positive_at_or_just_inboard_of_the_tip() -> None:
    x = LENGTH * np.array([1.0 - 1e-3])
    for shape, functions in every(6):
        assert np.all(functions.values(x) > 0.0), shape


def test_clamped_free_amplitude_is_the_tips_deflection() -> None:
    tip = shape_functions('clamped-free', 12, LENGTH).values(np.array([LENGTH]))
    np.testing.assert_allclose(tip, 1.0, rtol=1e-15)


@pytest.mark.parametrize('shape', SHAPES)
def test_boundary_conditions_hold_to_rounding(shape: str) -> None:
    functions = shape_functions(shape, 12, LENGTH)
    scale = max(functions.wave_numbers) / LENGTH
    for station, orders in zip((0.0, LENGTH), BOUNDARY[shape], strict=True):
        for order in orders:
            value = functions.derivatives(np.array([station]), order) / scale**order
            np.testing.assert_allclose(value, 0.0, atol=5e-14, err_msg=f'{station} {order}')


def test_pinned_roots_turn_and_clamped_ones_do_not() -> None:
    root = np.zeros(1)
    assert np.all(np.abs(shape_functions('pinned-pinned', 3, LENGTH).slopes(root)) > 1.0)
    np.testing.assert_array_equal(shape_functions('clamped-free', 3, LENGTH).slopes(root), 0.0)


def test_derivatives_agree_with_differences() -> None:
    x, h = np.linspace(0.1, LENGTH - 0.1, 7), 1e-3
    for shape, functions in every(4):
        steps = np.array([-2.0, -1.0, 1.0, 2.0]) * h
        weights = np.array([1.0, -8.0, 8.0, -1.0]) / (12.0 * h)
        assert isinstance(functions, WaveShapes)
        scale = max(functions.wave_numbers) / LENGTH
        for order in range(3):
            around = [functions.derivatives(x + step, order) for step in steps]
            difference = sum(w * part for w, part in zip(weights, around, strict=True))
            exact = functions.derivatives(x, order + 1)
            # error of the five-point rule: h^4 / 30 of the fifth higher derivative
            atol = 2.0 * scale ** (order + 5) * h**4 / 30.0 + 1e-11
            np.testing.assert_allclose(difference, exact, atol=atol, err_msg=shape)


def test_named_derivatives_are_the_first_four() -> None:
    functions, x = shape_functions('craig-bampton', 3, LENGTH), np.linspace(0.0, LENGTH, 5)
    named = (functions.values, functions.slopes, functions.curvatures, functions.third_derivatives)
    for order, method in enumerate(named):
        np.testing.assert_array_equal(method(x), functions.derivatives(x, order))
        assert method(x).shape == (5, 3)


def test_high_modes_keep_their_digits() -> None:
    x = np.linspace(0.0, LENGTH, 1001)
    functions = shape_functions('clamped-free', 40, LENGTH)
    assert np.abs(functions.values(x)).max() <= 1.0 + 1e-14
    np.testing.assert_allclose(correlation(functions.gram(0)), np.eye(40), atol=1e-12)


def test_craig_bampton_spans_the_static_shapes() -> None:
    functions = shape_functions('craig-bampton', 3, LENGTH)
    x = np.linspace(0.0, LENGTH, 21)
    xi = x / LENGTH
    for static in (3.0 * xi**2 - 2.0 * xi**3, xi**2 - xi**3):
        values = functions.values(x)
        fit, *_ = np.linalg.lstsq(values, static, rcond=None)
        np.testing.assert_allclose(values @ fit, static, atol=1e-13)


def test_craig_bampton_tends_to_the_clamped_free_beam() -> None:
    functions = shape_functions('craig-bampton', 10, LENGTH)
    quotient = np.diag(functions.gram(2)) / np.diag(functions.gram(0)) * LENGTH**4
    exact = wave_numbers('clamped-free', 3)
    assert np.all(quotient[:3] ** 0.25 >= exact * (1.0 - 1e-12))
    np.testing.assert_allclose(quotient[:3] ** 0.25, exact, rtol=5e-5)


def test_length_scales_the_derivatives_only() -> None:
    short, long = (shape_functions('clamped-pinned', 3, length) for length in (1.0, 4.0))
    xi = np.linspace(0.0, 1.0, 9)
    for order in range(4):
        np.testing.assert_allclose(
            long.derivatives(4.0 * xi, order) * 4.0**order, short.derivatives(xi, order)
        )


def test_torsion_shapes_are_the_contracts_sines() -> None:
    x = np.linspace(0.0, LENGTH, 11)
    values = torsion_shapes(3, LENGTH).values(x)
    for j, sign in ((1, 1.0), (2, -1.0), (3, 1.0)):
        expected = sign * np.sin((j - 0.5) * np.pi * x / LENGTH)
        np.testing.assert_allclose(values[:, j - 1], expected, atol=1e-15)


@pytest.mark.parametrize(
    ('shape', 'modes', 'length', 'message'),
    [
        ('free-free', 2, 1.0, "shape must be one of clamped-free, .*, got 'free-free'"),
        ('clamped-free', 0, 1.0, 'modes must be >= 1, got 0'),
        ('craig-bampton', 1, 1.0, 'modes must be >= 2, got 1'),
        ('clamped-free', 2, 0.0, 'length must be > 0 m, got 0.0'),
        ('clamped-free', 2, math.nan, 'length must be > 0 m, got nan'),
    ],
)
def test_wrong_arguments_are_refused(shape: str, modes: int, length: float, message: str) -> None:
    with pytest.raises(StateError, match=message):
        shape_functions(shape, modes, length)
    if shape == 'clamped-free':
        with pytest.raises(StateError, match=message):
            torsion_shapes(modes, length)
