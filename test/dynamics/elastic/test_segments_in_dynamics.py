"""A link of segments bends far: against the elastica and against rods on sprung hinges."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from elastica import distance, divided_table, elastica
from elastica import model as tip
from hinged_rods import sagging
from segmented_robots import strip, strip_text

from denoc_ros.dynamics.robot import load_robot

STRAIGHT = 1.8751040687119611**2 / (2.0 * np.pi)  # Hz, of the strip without weight
SIZES = {'force': (0.3, 0.95, 2.0), 'moment': (0.2, 0.62, 1.3)}  # deflections 10, 29, 49-56 %


@pytest.mark.parametrize('load', ['force', 'moment'])
def test_eight_segments_are_the_elastica(load: str) -> None:
    robot = strip(8)
    truth = [elastica(load, size) for size in SIZES[load]]
    off = [distance(tip(robot, load, s), t) for s, t in zip(SIZES[load], truth, strict=True)]
    # required; reached are 0.00022, 0.0056 and 0.029 % under a force
    assert off[0] <= 0.0002
    assert off[1] <= 0.002
    assert off[2] <= 0.01
    assert np.all(np.array(off) <= [3e-6, 7e-5, 3.5e-4])


@pytest.mark.parametrize('load', ['force', 'moment'])
def test_the_error_falls_with_the_third_power_of_the_segments(load: str) -> None:
    size = SIZES[load][1]
    off = np.array([distance(tip(strip(k), load, size), elastica(load, size)) for k in (2, 4, 8)])
    # each segment's rotation is cubic in what it bends: so is its error, and its root does not add
    np.testing.assert_allclose(np.log2(off[:-1] / off[1:]), 3.0, atol=0.1)


def test_one_mode_is_constant_curvature_and_converges_with_the_square() -> None:
    force, moment = (elastica(load, SIZES[load][1]) for load in ('force', 'moment'))
    off = np.array([distance(tip(strip(k, 1), 'force', 0.95), force) for k in (4, 8, 16)])
    np.testing.assert_allclose(np.log2(off[:-1] / off[1:]), 2.0, atol=0.15)
    # a moment bends it by the same shape as two modes
    one, two = (tip(strip(4, modes), 'moment', 0.62) for modes in (1, 2))
    assert distance(one, two) < 1e-9
    assert distance(one, moment) < 2e-4


def test_a_sagging_strip_rings_as_high_as_rods_on_hinges() -> None:
    weight = 0.692
    place, frequency = sagging(weight)
    assert place[1] == pytest.approx(-0.086, abs=1e-3)
    assert frequency / STRAIGHT - 1.0 == pytest.approx(0.0043, abs=2e-4)
    robot = strip(8, weight=weight)
    q = robot.static_deflection(np.zeros(0))
    # eight segments: 0.006 % below; one beam has the wrong sign, -0.4 %
    assert robot.natural_frequencies(q)[0] == pytest.approx(frequency, rel=5e-4)
    assert robot.natural_frequencies(q)[0] == pytest.approx(frequency, rel=1e-4)
    np.testing.assert_allclose(robot.tip_deflection('strip', q)[:2], place - [1.0, 0.0], atol=1e-5)
    alone = strip(1, 4, weight=weight)
    low = alone.natural_frequencies(alone.static_deflection(np.zeros(0)))[0]
    assert low < STRAIGHT


def test_small_motions_are_those_of_one_long_beam() -> None:
    frequencies = strip(8).natural_frequencies(np.zeros(16))[:3]
    beta = np.array([1.8751040687, 4.6940911330, 7.8547574382])
    np.testing.assert_allclose(frequencies, beta**2 / (2.0 * np.pi), rtol=2e-3)


def test_the_table_of_the_page_is_what_comes_out() -> None:
    page = Path(__file__).resolve().parents[3] / 'docs' / 'theory.md'
    assert divided_table() in page.read_text(encoding='utf-8')


def test_a_link_bends_round_a_full_circle() -> None:
    robot = load_robot(strip_text(24), gravity=(0.0, 0.0, 0.0))
    q = np.zeros(robot.n)
    for moment in np.linspace(0.0, 2.0 * np.pi, 9):
        wrench = np.array([0, 0, 0, 0, 0, moment])
        q = robot.static_deflection(np.zeros(0), wrenches={'tip': wrench}, start=q)
    # a segment turns by 15 degrees: 24 chords of (15 degrees)^3 / 60 too much
    assert np.linalg.norm(robot.frame_pose('tip', q)[:3, 3]) < 0.01


@pytest.mark.parametrize('name', ['inverse_dynamics', 'forward_dynamics'])
def test_one_segment_is_the_beam_without_the_attribute(name: str) -> None:
    plain = load_robot(strip_text(1), gravity=(0.0, -9.81, 0.0))
    divided = load_robot(
        strip_text(1).replace('shape=', 'segments="1" shape='), gravity=(0, -9.81, 0)
    )
    state = np.random.default_rng(1).uniform(-0.1, 0.1, (3, plain.n))
    assert divided.coordinate_names == plain.coordinate_names
    np.testing.assert_array_equal(divided.arrays.constants, plain.arrays.constants)
    np.testing.assert_array_equal(getattr(divided, name)(*state), getattr(plain, name)(*state))
