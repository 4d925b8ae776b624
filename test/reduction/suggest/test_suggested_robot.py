"""A proposed robot does what its proposal says, and is the plain one where it does not bend."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from suggested_robots import EI, LENGTH, MASS, tube_arm

from denoc_ros.dynamics.robot import load_robot
from denoc_ros.reduction.suggest.suggested_beam import BeamSuggestion
from denoc_ros.reduction.suggest.suggestion import suggest_flexibility

LEVEL = (-9.81, 0.0, 0.0)  # the arm stands along Z of its base and turns about Y


def level_arm(beyond: float = 0.0) -> tuple[BeamSuggestion, str]:
    suggestion = suggest_flexibility(tube_arm(beyond=beyond), bandwidth=50.0)
    (beam,) = suggestion.beams
    return beam, suggestion.text


def test_undeflected_it_is_the_plain_robot(repository: Path) -> None:
    file = repository / 'config' / 'robots' / 'ur10.urdf'
    links = ['shoulder_link', 'upper_arm_link', 'forearm_link']
    flexible = load_robot(suggest_flexibility(file, links=links, bandwidth=200.0).text)
    plain = load_robot(file)
    assert flexible.n > plain.n
    random = np.random.default_rng(3)
    for _ in range(5):
        q, qd, qdd = random.normal(size=(3, plain.n))
        states = np.zeros((3, flexible.n))
        states[:, flexible.joint_indices] = q, qd, qdd
        found = flexible.inverse_dynamics(*states)[flexible.joint_indices]
        expected = plain.inverse_dynamics(q, qd, qdd)
        # rounding of the remainders
        assert found == pytest.approx(expected, rel=1e-10, abs=1e-10 * np.abs(expected).max())
        inertia = flexible.inertia_matrix(states[0])
        rows = np.ix_(flexible.joint_indices, flexible.joint_indices)
        assert inertia[rows] == pytest.approx(plain.inertia_matrix(q), rel=1e-10, abs=1e-10)


@pytest.mark.parametrize('beyond', [0.0, 0.5])
def test_it_sags_and_swings_as_the_proposal_says(beyond: float) -> None:
    beam, text = level_arm(beyond)
    robot = load_robot(text, gravity=LEVEL)
    sag = robot.tip_deflection('boom', robot.static_deflection(np.zeros(1)))
    # two modes miss 0.5 % of a tip load's sag
    assert np.linalg.norm(sag) == pytest.approx(beam.sag, rel=6e-3)
    payload = LENGTH**3 / 3.0 + beyond * LENGTH**2 / 2.0
    closed = 9.81 * (MASS / LENGTH * LENGTH**4 / 8.0 + payload) / EI
    assert beam.sag == pytest.approx(closed, rel=2e-3)
    weightless = load_robot(text, gravity=(0.0, 0.0, 0.0))
    first = weightless.natural_frequencies(np.zeros(weightless.n))[0]
    # Rayleigh's quotient of the static shape of a tip force, from above; two modes stand 0.3 %
    # above the beam themselves
    assert 0.997 * first <= beam.frequency <= 1.02 * first


def test_it_bends_by_its_effort_as_the_proposal_says() -> None:
    beam, text = level_arm()
    robot = load_robot(text, gravity=(0.0, 0.0, 0.0))
    pushed = robot.static_deflection(np.zeros(1), {'tool': (60.0 / LENGTH, 0, 0, 0, 0, 0)})
    deflection = np.linalg.norm(robot.tip_deflection('boom', pushed))
    # foreshortening and two modes
    assert deflection == pytest.approx(beam.effort_deflection, rel=1e-2)


def test_frequency_of_the_tube_is_the_cantilever_s() -> None:
    suggestion = suggest_flexibility(tube_arm(payload=0.0), bandwidth=50.0)
    robot = load_robot(suggestion.text, gravity=(0.0, 0.0, 0.0))
    first = robot.natural_frequencies(np.zeros(robot.n))[0]
    root = 1.8751040687119612
    expected = root**2 * math.sqrt(EI / (MASS / LENGTH * LENGTH**4)) / (2.0 * math.pi)
    assert first == pytest.approx(expected, rel=2e-3)  # four digits, of EI and of the mass
