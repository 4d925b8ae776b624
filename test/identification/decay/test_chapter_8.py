"""The book's chapter 8: the printed numbers that can be had."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from data_files import DATA

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.identification.decay.damping import assign_damping
from denoc_ros.identification.decay.decrement import critical_joint_damping
from denoc_ros.identification.decay.modes_fit import fit_modes
from denoc_ros.identification.decay.records import Record
from denoc_ros.identification.joint.joint_swing import fit_joint
from denoc_ros.simulation.simulate import simulate

GRAVITY = (0.0, -9.81, 0.0)


@pytest.fixture(scope='module')
def experiments() -> dict[str, Any]:
    return dict(yaml.safe_load((DATA / 'book_experiments.yaml').read_text()))


def load(repository: Path, name: str, gravity: tuple[float, float, float] = GRAVITY) -> Robot:
    return load_robot(repository / 'config' / 'robots' / f'{name}.urdf', gravity=gravity)


def test_critical_and_joint_damping_of_the_pendulum_are_as_printed(
    experiments: dict[str, Any],
) -> None:
    link, printed = (experiments['rigid_pendulum'][key] for key in ('link', 'printed'))
    critical = critical_joint_damping(
        printed['f_experiment_hz'],
        mass_per_length=link['mass_per_length'],
        length=link['a'],
        convention='book',
    )
    assert round(critical, 4) == printed['critical_damping']
    assert round(critical * printed['damping_ratio'], 4) == printed['joint_damping']


@pytest.mark.long
def test_pendulum_swings_at_the_printed_frequency_and_gives_its_damping_back(
    repository: Path, experiments: dict[str, Any]
) -> None:
    printed = experiments['rigid_pendulum']['printed']
    robot = load(repository, 'rigid_pendulum')
    t = np.arange(0.0, 4.0, 0.01)
    angle = simulate(robot, np.zeros(1), np.zeros(1), t).q[:, 0] + 0.5 * np.pi
    crossings = np.flatnonzero(np.diff(np.sign(angle)))
    frequency = 0.5 / np.mean(np.diff(t[crossings][:5]))
    assert round(float(frequency), 1) == printed['f_simulation_hz']
    noisy = angle + 1e-3 * np.random.default_rng(4).standard_normal(len(t))
    inertia = float(robot.inertia_matrix([0.0])[0, 0])
    found = fit_joint(Record(t, noisy), inertia)
    assert found.terms == ('viscous',)
    # 1 mrad of noise on 400 samples of 1.5 rad
    assert found.viscous == pytest.approx(printed['joint_damping'], rel=0.01)


def test_clamped_beam_gives_the_printed_ratios_back_where_the_books_window_cannot(
    repository: Path, experiments: dict[str, Any]
) -> None:
    printed = experiments['clamped_beam']['printed']
    robot = load(repository, 'clamped_beam', (0.0, 0.0, 0.0))  # it swings horizontally
    q0 = np.array([0.0145, 0.0005])
    t = np.arange(0.0, 0.6, 0.001)
    tip = robot.tip_deflection('link_1', simulate(robot, q0, np.zeros(2), t).q)[:, 1]
    noisy = tip + 1e-5 * np.random.default_rng(5).standard_normal(len(t))
    modes = fit_modes(Record(t, noisy, 'tip', 'm'))
    assert modes.verdict == ('good', 'good')
    assigned = assign_damping(
        robot, np.zeros(2), modes.frequency, modes.damping_ratio, size=modes.amplitude
    )
    assert [one.coordinate for one in assigned] == ['link_1/y1', 'link_1/y2']
    # 63 dB: the Cramer-Rao bounds are 0.1 % and 1 %
    found = [one.damping_ratio for one in assigned]
    np.testing.assert_allclose(found, printed['modal_damping_ratio'], rtol=0.05)
    # critical damping 2 sqrt(k m) of tip-scaled shapes, not the printed 0.069 and 0.0065 kg/s
    critical = [one.coefficient / one.damping_ratio for one in assigned]
    np.testing.assert_allclose(critical, [1.44, 9.00], rtol=5e-3)
