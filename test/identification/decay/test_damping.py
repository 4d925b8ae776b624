"""Damping of a model from its measured modes: what was put in comes out."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from numpy.typing import NDArray
from segmented_robots import strip_text

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import IdentificationError
from denoc_ros.identification.decay.damping import assign_damping, damping_overrides

Floats = NDArray[np.float64]
STATE = {'joint_1': 0.1, 'joint_2': 0.5, 'joint_3': 0.3}
TRUE = {
    'beam.link_1.y.damping_ratio': [0.02, 0.03],
    'beam.link_2.y.damping_ratio': [0.01, 0.25],
}


@pytest.fixture(scope='module')
def arm(request: pytest.FixtureRequest) -> Robot:
    path = request.config.rootpath / 'config/robots/canadarm.urdf'
    return load_robot(path, gravity=(0.0, 0.0, 0.0))


def placed(robot: Robot) -> Floats:
    q = np.zeros(robot.n)
    q[robot.joint_indices] = list(STATE.values())
    return q


def measured_modes(robot: Robot, q: Floats, held: bool) -> tuple[Floats, Floats]:
    """Frequencies [Hz] and damping ratios by differences of forward dynamics, nothing shared."""
    moving = robot.flexible_indices if held else np.arange(robot.n)
    step, at = 1e-5, np.zeros(robot.n)

    def force(q: Floats, qd: Floats) -> Floats:
        return np.asarray(robot.bias_forces(q, qd))

    mass = robot.inertia_matrix(q)[np.ix_(moving, moving)]
    stiffness, damping = np.zeros_like(mass), np.zeros_like(mass)
    for column, j in enumerate(moving):
        at[:] = 0.0
        at[j] = step
        stiffness[:, column] = (force(q + at, 0 * q) - force(q - at, 0 * q))[moving] / (2 * step)
        damping[:, column] = (force(q, at) - force(q, -at))[moving] / (2 * step)
    zero = np.zeros_like(mass)
    first = np.block([[zero, np.eye(len(moving))], [-stiffness, -damping]])
    second = scipy.linalg.block_diag(np.eye(len(moving)), mass)
    poles = scipy.linalg.eigvals(first, second)
    poles = poles[poles.imag > 1e-3]
    poles = poles[np.argsort(np.abs(poles))]
    return np.abs(poles) / (2.0 * np.pi), -poles.real / np.abs(poles)


@pytest.mark.parametrize('held', [True, False])
def test_damping_of_two_coupled_links_comes_back(arm: Robot, held: bool) -> None:
    q = placed(arm)
    frequency, ratio = measured_modes(arm.with_overrides(TRUE), q, held)
    # the coupling is what this is about: no mode has an amplitude's own damping ratio
    assert np.min(np.abs(ratio[:, None] - np.ravel(list(TRUE.values()))) / ratio[:, None]) > 0.02
    assigned = assign_damping(arm, q, frequency, ratio, held)
    found = damping_overrides(arm, assigned)
    for path, value in TRUE.items():
        # differences of forces: 1e-10 of them over the smallest damping
        np.testing.assert_allclose(found[path], value, rtol=1e-3)


def test_coefficients_are_those_of_the_model(arm: Robot) -> None:
    q = placed(arm)
    damped = arm.with_overrides(TRUE)
    assigned = assign_damping(arm, q, *measured_modes(damped, q, True))
    byname = {one.coordinate: one.coefficient for one in assigned}
    link = next(body for body in damped.tree.bodies if body.name == 'link_1')
    assert link.beam is not None
    assert link.beam.y is not None
    names = [f'link_1/y{k + 1}' for k in range(2)]
    np.testing.assert_allclose([byname[n] for n in names], link.beam.y.damping, rtol=1e-3)


def test_what_is_no_mode_of_the_model_is_left_out(arm: Robot) -> None:
    q = placed(arm)
    frequency, ratio = measured_modes(arm.with_overrides(TRUE), q, True)
    size = np.ones(len(frequency))
    alone = assign_damping(arm, q, frequency, ratio)
    # a weak line beside the first mode, and one far from all
    more = assign_damping(
        arm,
        q,
        [*frequency, 1.1 * frequency[0], 50.0],
        [*ratio, 0.4, 0.4],
        size=[*size, 0.1, 2.0],
    )
    assert more == alone
    with pytest.raises(IdentificationError, match=r'must be within 30 % .* got 50, 60 Hz'):
        assign_damping(arm, q, [50.0, 60.0], [0.01, 0.01])


def test_damping_that_no_beam_can_explain_is_refused(arm: Robot) -> None:
    stiff = arm.with_overrides({'joint.joint_3.damping': 1e4})
    frequency, ratio = measured_modes(stiff, placed(arm), False)
    with pytest.raises(IdentificationError, match='other damping in the model'):
        assign_damping(stiff, placed(arm), frequency[:1], 1e-3 * ratio[:1], False)


def test_a_link_of_segments_has_one_ratio_for_all_its_modes() -> None:
    robot = load_robot(
        strip_text(6).replace('modes="2"', 'modes="2" damping_ratio="0.001"'), gravity=(0, 0, 0)
    )
    q = np.zeros(robot.n)
    frequency, ratio = measured_modes(
        robot.with_overrides({'beam.strip.y.damping_ratio': 0.02}), q, True
    )
    assigned = assign_damping(robot, q, frequency[:3], ratio[:3])
    assert [one.mode for one in assigned] == [0]  # of the three the first, which names the ratio
    assert assigned[0].coordinate == 'strip/y1'
    found = damping_overrides(robot, assigned)
    assert found.keys() == {'beam.strip.y.damping_ratio'}
    np.testing.assert_allclose(found['beam.strip.y.damping_ratio'], [0.02], rtol=1e-3)
    damped = robot.with_overrides(found)
    np.testing.assert_allclose(measured_modes(damped, q, True)[1][:3], ratio[:3], rtol=2e-3)
