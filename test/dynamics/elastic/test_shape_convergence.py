"""How shape functions converge, and natural frequencies against closed forms."""

from __future__ import annotations

import re

import numpy as np
import pytest
from planar_chains import PlanarLink, planar_chain
from shape_study import (
    DENSITY,
    DOCUMENT,
    EI,
    LENGTH,
    LOAD,
    beam,
    cantilever,
    document,
    frequency_errors,
    hertz,
    pinned,
    roots,
    sag_error,
)

from denoc_ros.dynamics.robot import load_robot
from denoc_ros.model.beams.shapes import wave_numbers
from denoc_ros.types import Array

# Table 3.2 by what its rows are; the labels of the last two are wrong (docs/shapes.md).
PRINTED = {
    'pinned-pinned': [3.142, 6.283, 9.425, 12.566, 15.708],
    'clamped-free': [1.875, 4.694, 7.855, 10.996, 14.137],
    'clamped-clamped': [4.730, 7.853, 10.996, 14.137, 17.279],
    'clamped-pinned': [3.927, 7.069, 10.210, 13.352, 16.493],
}


@pytest.mark.parametrize('shape', PRINTED)
def test_eigenvalues_are_those_of_table_3_2(shape: str) -> None:
    # three decimals are printed
    np.testing.assert_allclose(wave_numbers(shape, 5), PRINTED[shape], rtol=0.0, atol=5.1e-4)


def test_table_3_2_calls_the_pinned_tip_free() -> None:
    free = wave_numbers('clamped-free', 5)
    assert np.min(np.abs(free - np.array(PRINTED['clamped-pinned']))) > 0.5


@pytest.mark.parametrize('ratio', [0.0, LOAD])
@pytest.mark.parametrize('modes', [2, 3, 6])
def test_craig_bampton_tip_sags_exactly_under_any_load(modes: int, ratio: float) -> None:
    # its other shapes do not move the tip and do not couple with the static ones in stiffness
    assert sag_error('craig-bampton', modes, ratio) < 1e-8


@pytest.mark.parametrize('modes', [1, 2, 3, 4, 6])
def test_clamped_free_tip_load_is_met_by_a_known_series(modes: int) -> None:
    robot = beam('clamped-free', modes, 0.0)
    load = 1e-2
    levels = (
        robot.static_deflection(np.zeros(1)),
        robot.static_deflection(np.zeros(1), {'tip': np.array([0.0, load, 0.0, 0.0, 0.0, 0.0])}),
    )
    sag, loaded = (robot.tip_deflection('arm', q)[1] for q in levels)
    exact = load * LENGTH**3 / (3.0 * EI)
    missed = 1.0 - np.sum(12.0 / wave_numbers('clamped-free', modes) ** 4)
    assert 1.0 - (loaded - sag) / exact == pytest.approx(missed, rel=1e-3)


@pytest.mark.parametrize(
    ('shape', 'held'),
    [('clamped-free', True), ('craig-bampton', True), ('craig-bampton', False)]
    + [('clamped-free', False), ('pinned-pinned', False)],
)
@pytest.mark.parametrize('ratio', [0.0, LOAD])
def test_frequencies_fall_towards_the_closed_form(shape: str, held: bool, ratio: float) -> None:
    counts = (3, 4, 6, 8)
    errors = np.array([frequency_errors(shape, modes, ratio, held) for modes in counts])
    assert np.all(errors > -1e-8)  # Ritz: from above
    assert np.all(np.diff(errors, axis=0) < 1e-8)  # and a wider space is never worse
    assert np.all(errors[-1] < 2e-3)


def test_heavy_tip_wants_static_shapes() -> None:
    for modes in (2, 4, 6):
        static = frequency_errors('craig-bampton', modes, LOAD, True)[0]
        assert static < 2e-3 * frequency_errors('clamped-free', modes, LOAD, True)[0]
    on_free_joint = frequency_errors('pinned-pinned', 2, LOAD, False)
    assert np.all(on_free_joint < 1e-4 * frequency_errors('clamped-free', 2, LOAD, False))


def test_bare_beams_have_the_familiar_eigenvalues() -> None:
    np.testing.assert_allclose(roots(cantilever, 0.0, 2), [1.8751040687, 4.6940911330], rtol=1e-9)
    np.testing.assert_allclose(roots(pinned, 0.0, 2), [3.9266023120, 7.0685827456], rtol=1e-9)


def test_heavy_tip_mass_alone_is_the_textbook_spring() -> None:
    # Rayleigh: 3 EI / l^3 on the tip mass and 33/140 of the beam's
    beta = roots(cantilever, 100.0, 1)[0]
    assert beta**4 == pytest.approx(3.0 / (100.0 + 33.0 / 140.0), rel=1e-5)


HALF = PlanarLink(0.5 * LENGTH, 0.5 * LENGTH * DENSITY, EI)
NONE = (0.0, 0.0, 0.0)


def test_two_links_in_line_are_one_cantilever() -> None:
    robot = load_robot(planar_chain([HALF, HALF], 5, 'craig-bampton'), gravity=NONE)
    straight = np.zeros(robot.n)
    straight[robot.joint_indices[0]] = 0.7
    found = robot.natural_frequencies(straight)[:2]
    np.testing.assert_allclose(found, hertz(wave_numbers('clamped-free', 2)), rtol=2e-4)


def test_configuration_sets_the_frequencies_not_where_the_whole_points() -> None:
    robot = load_robot(planar_chain([HALF, HALF], 3, 'craig-bampton'), gravity=NONE)

    def first(base: float, elbow: float, held: bool) -> Array:
        q = np.zeros(robot.n)
        q[robot.joint_indices] = base, elbow
        return robot.natural_frequencies(q, held)

    for held in (True, False):
        np.testing.assert_allclose(first(1.1, 0.9, held)[2:], first(0.0, 0.9, held)[2:], rtol=1e-8)
    # folded back, the chain is stiffer than stretched out
    assert first(0.0, 3.0, True)[0] > 1.5 * first(0.0, 0.0, True)[0]


def test_held_joints_raise_every_frequency() -> None:
    robot = load_robot(planar_chain([HALF, HALF], 3, 'craig-bampton'), gravity=NONE)
    q = np.zeros(robot.n)
    q[robot.joint_indices] = 0.3, 0.9
    held, free = robot.natural_frequencies(q), robot.natural_frequencies(q, held=False)
    assert len(free) == len(held) + 2
    assert np.max(np.abs(free[:2])) < 1e-3 * free[2]
    # two constraints: each frequency stands between the free ones two places apart
    assert np.all(free[: len(held)] <= held * (1.0 + 1e-9))
    assert np.all(held <= free[2:] * (1.0 + 1e-9))


NUMBER = re.compile(r'\d\.\de[+-]\d\d')


def test_document_is_what_the_study_gives() -> None:
    written, made = DOCUMENT.read_text(encoding='utf-8'), document()
    assert NUMBER.sub('#', written) == NUMBER.sub('#', made), (
        'run: python test/support/oracles/shape_study.py'
    )
    values = [[float(text) for text in NUMBER.findall(page)] for page in (written, made)]
    # two digits are shown
    np.testing.assert_allclose(values[0], values[1], rtol=0.06)
