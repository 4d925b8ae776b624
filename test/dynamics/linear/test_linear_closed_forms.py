"""Linear models of uniform beams against transcendental frequency responses."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from beam_closed_forms import HubBeam, roots
from beam_robots import STATION, SURFACE, beam_robot
from numpy.typing import NDArray

from denoc_ros.dynamics.linear.linear_model import LinearModel
from denoc_ros.types import Array

BEAM = HubBeam(ei=120.0, density=1.5, length=1.6, tip_mass=0.8, hub=0.35)
STEP = 0.3  # rad/s, finer than roots lie apart


def hub_model(modes: int, shape: str) -> LinearModel:
    robot = beam_robot(BEAM, modes, shape=shape)
    return robot.linearize(np.zeros(robot.n), outputs=('joints', 'pose:tip', 'gauge'))


def curvature(s2: float) -> float:
    return BEAM.to_curvature(s2, STATION * BEAM.length)


def oscillating(values: NDArray[np.complex128]) -> Array:
    """Sizes of pairs on the imaginary axis."""
    on_axis = values[(values.imag > 0) & (np.abs(values.real) < 1e-6 * np.abs(values))]
    return np.asarray(np.sort(on_axis.imag))


def real_pairs(values: NDArray[np.complex128]) -> Array:
    """Sizes of pairs on the real axis, zeros at 0 left out."""
    found = values[(values.real > 1e-3) & (np.abs(values.imag) < 1e-6 * np.abs(values))].real
    return np.asarray(np.sort(found))


def test_closed_forms_are_those_of_the_textbooks() -> None:
    plain = HubBeam(1.0, 1.0, 1.0)
    np.testing.assert_allclose(
        roots(plain.clamped, 3, 0.5, -1),
        np.array([1.87510406871196, 4.69409113297417, 7.85475743823761]) ** 2,
        rtol=1e-12,
    )
    pinned = [3.92660231204792, 7.06858274562873]  # tan b = tanh b: clamped and pinned
    np.testing.assert_allclose(
        roots(plain.tip_force_to_tip, 2, 0.5, -1), np.square(pinned), rtol=1e-12
    )
    # pinned and free, hub without inertia
    np.testing.assert_allclose(roots(plain.free, 2, 0.5, -1), np.square(pinned), rtol=1e-12)
    # the tip's real zeros: tan b + tanh b = 0, s = 2 b^2, whatever hub and tip mass
    for beam in (plain, HubBeam(1.0, 1.0, 1.0, tip_mass=0.7, hub=0.4)):
        np.testing.assert_allclose(
            roots(beam.to_tip, 2, 0.5, 1),
            2 * np.square([2.36502037243135, 5.49780391900084]),
            rtol=1e-11,  # hyperbolic functions of the tip cancel
        )


# relative errors that modes allow, about twice what they are: poles 1 and 2; zeros of the hub
# angle 1 and 2; the tip's real pair; the gauge's zero 1
BOUNDS = [
    ('clamped-free', 4, (6e-4, 4e-3, 3e-4, 4e-3, 1e-3, 4e-3)),
    ('clamped-free', 8, (8e-5, 5e-4, 3e-5, 5e-4, 2e-5, 1e-3)),
    ('craig-bampton', 4, (2e-5, 4e-5, 3e-5, 2e-5, 2e-3, 3e-3)),
    ('craig-bampton', 8, (1e-6, 3e-6, 5e-7, 3e-6, 1e-5, 3e-4)),
]


@pytest.mark.parametrize(('shape', 'modes', 'bounds'), BOUNDS)
def test_poles_and_zeros_of_a_flexible_link_converge_to_the_beams(
    shape: str, modes: int, bounds: tuple[float, ...]
) -> None:
    model = hub_model(modes, shape)
    poles, hub = (roots(f, 2, STEP, -1) for f in (BEAM.free, BEAM.to_hub))
    tip = roots(BEAM.to_tip, 1, STEP, 1)
    gauge = roots(curvature, 1, STEP, -1)
    found_poles = oscillating(model.poles())[:2]
    found_hub = oscillating(model.zeros('hub', 'hub'))[:2]
    found_tip = model.zeros('hub', 'pose:tip/y')
    found_gauge = oscillating(model.zeros('hub', 'gauge'))[:1]
    found = np.concatenate([found_poles, found_hub, real_pairs(found_tip)[:1], found_gauge])
    errors = found / np.concatenate([poles, hub, tip, gauge]) - 1
    assert np.all(np.abs(errors) < bounds), errors
    # the tip is non-minimum phase: its pair is mirrored about the imaginary axis
    np.testing.assert_allclose(np.sort(-found_tip.real), np.sort(found_tip.real), rtol=1e-6)
    # Rayleigh: modes only ever stiffen
    assert np.all(errors[:4] > 0)


@pytest.mark.parametrize('output', ['hub', 'pose:tip/y', 'gauge'])
def test_response_of_a_flexible_link_is_the_beams_up_to_its_second_mode(output: str) -> None:
    model = hub_model(8, 'craig-bampton')
    second = roots(BEAM.free, 2, STEP, -1)[1]
    # between the resonances, where the closed form is finite
    omega = np.array([1.0, 5.0, 12.0, 20.0, 32.0, 50.0, 0.97 * second])
    exact: dict[str, Callable[[float], float]] = {
        'hub': BEAM.to_hub,
        'pose:tip/y': BEAM.to_tip,
        'gauge': lambda s2: -SURFACE * curvature(s2),
    }
    expected = np.array([exact[output](-w * w) / BEAM.free(-w * w) for w in omega])
    found = model.frequency_response(omega)[:, model.output_names.index(output), 0]
    # a gauge at the root sees what modes are worst at: local curvature
    bound = 2e-3 if output == 'gauge' else 1e-4
    np.testing.assert_allclose(found, expected, rtol=bound)


@pytest.mark.parametrize(
    ('shape', 'modes', 'tip', 'gauge'),
    [('clamped-free', 4, 0.1, 0.05), ('craig-bampton', 8, 1e-5, 2e-3)],
)
def test_response_of_a_clamped_beam_with_tip_mass_is_the_closed_form(
    shape: str, modes: int, tip: float, gauge: float
) -> None:
    robot = beam_robot(BEAM, modes, 'fixed', shape)
    model = robot.linearize(
        np.zeros(robot.n), inputs=('wrench:tip',), outputs=('deflection:arm', 'gauge')
    )
    first, second = roots(BEAM.clamped, 2, STEP, -1)
    # near a resonance an error of its frequency counts ten times: 0.95 of it is near
    omega = np.array([0.5 * first, 2 * first, 4 * first, 0.95 * second])
    force = model.input_names.index('wrench:tip/fy')
    found = model.frequency_response(omega)[:, :, force]
    at = STATION * BEAM.length
    for name, bound, numerator in (
        ('deflection:arm/uy', tip, BEAM.tip_force_to_tip),
        ('gauge', gauge, lambda s2: -SURFACE * BEAM.tip_force_to_curvature(s2, at)),
    ):
        expected = np.array([numerator(-w * w) / BEAM.clamped(-w * w) for w in omega])
        scale = np.abs(expected).max()
        column = found[:, model.output_names.index(name)]
        np.testing.assert_allclose(column, expected, rtol=bound, atol=bound * 1e-3 * scale)
    zero = oscillating(model.zeros('wrench:tip/fy', 'deflection:arm/uy'))[0]
    exact = roots(BEAM.tip_force_to_tip, 1, STEP, -1)[0]
    assert zero == pytest.approx(exact, rel=tip)
    np.testing.assert_allclose(oscillating(model.poles())[:2], [first, second], rtol=tip / 3)
