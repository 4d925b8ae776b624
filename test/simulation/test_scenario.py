"""Scenarios: what they say is what is simulated, and what is wrong with them is all said."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from planar_chains import CANADARM, CANADARM_RIGID, FLEXIBLE, RIGID, planar_chain

import denoc_ros as dn
from denoc_ros.simulation.scenario import KEYS, model_settings, scenario_from_config
from denoc_ros.simulation.time_functions import SpinUp

BOOK = {
    'kind': 'book',
    'form': 'half',
    'rate': [0.075, 0.05, 0.1],
    'period': [10, 5, 5],
    'duration': 1.0,
}

SLOW = {'kind': 'book', 'rate': 0.1, 'period': 1}


def made(robot: dn.Robot, **values: Any) -> Any:
    return scenario_from_config(values, robot, 'a.yaml')


@pytest.fixture(scope='module')
def arm() -> dn.Robot:
    return dn.load_robot(planar_chain([FLEXIBLE, RIGID]), gravity=(0.0, -9.81, 0.0))


def test_rigid_torques_carry_the_rigid_robot_along_the_reference() -> None:
    robot = dn.load_robot(planar_chain(CANADARM_RIGID), gravity=(0.0, 0.0, 0.0))
    scenario = made(robot, torque={'kind': 'rigid_inverse_dynamics', 'reference': BOOK})
    run = scenario.run(robot)
    q, qd, qdd = np.zeros((3, 3))
    scenario.reference.sample(0.999999, q, qd, qdd)
    np.testing.assert_allclose(run.q[-1], q, atol=1e-6)
    assert run.t[-1] == 1.0
    assert len(run.t) == 101


def test_same_torques_leave_the_flexible_robot_behind() -> None:
    robot = dn.load_robot(planar_chain(CANADARM), gravity=(0.0, 0.0, 0.0))
    scenario = made(robot, torque={'kind': 'rigid_inverse_dynamics', 'reference': BOOK})
    run = scenario.run(robot)
    q, qd, qdd = np.zeros((3, 3))
    scenario.reference.sample(0.999999, q, qd, qdd)
    gap = np.abs(run.q[-1, robot.joint_indices] - q)
    assert np.max(gap) > 1e-3


def test_torques_of_a_table_are_held_or_joined_between_its_entries() -> None:
    robot = dn.load_robot(planar_chain(CANADARM_RIGID), gravity=(0.0, 0.0, 0.0))
    exact = {'kind': 'rigid_inverse_dynamics', 'reference': BOOK}
    smooth = made(robot, torque=exact).torque
    zero = np.zeros(3)

    def at(t: float) -> Any:
        return smooth(t, zero, zero).copy()

    held = made(robot, torque={**exact, 'every': 0.1}).torque
    joined = made(robot, torque={**exact, 'every': 0.1, 'between': 'linear'}).torque
    for k in (0, 3, 7):  # 0.3 and 0.7 are a rounding below 3 and 7 tenths
        np.testing.assert_array_equal(held(0.1 * k, zero, zero), at(0.1 * k))
        np.testing.assert_array_equal(held(0.1 * k + 0.09, zero, zero), at(0.1 * k))
        np.testing.assert_allclose(joined(0.1 * k, zero, zero), at(0.1 * k), rtol=1e-12)
        middle = 0.5 * (at(0.1 * k) + at(0.1 * k + 0.1))
        np.testing.assert_allclose(joined(0.1 * k + 0.05, zero, zero), middle, rtol=1e-12)


def test_reference_is_followed_exactly(arm: dn.Robot) -> None:
    reference = {'kind': 'book', 'rate': [0.5, -0.3], 'period': 0.5, 'start': [-1.0, 0.2]}
    scenario = made(arm, reference=reference, output_rate=50)
    run = scenario.run(arm)
    assert len(run.t) == 26
    np.testing.assert_allclose(
        run.q[-1, arm.joint_indices], [-1.0 + 0.5 * 0.5, 0.2 - 0.3 * 0.5], atol=1e-12
    )


def test_one_prescribed_joint_leaves_the_other_free(arm: dn.Robot) -> None:
    spin = {'joint_1': {'kind': 'spin_up', 'rate': 1.0, 'time': 0.5}}
    run = made(arm, prescribed=spin, duration=0.6).run(arm)
    first, second = arm.joint_indices
    np.testing.assert_allclose(run.qd[-1, first], 1.0, atol=1e-12)
    assert abs(run.q[-1, second]) > 0.05


def test_spin_up_is_equation_3_55() -> None:
    law, step = SpinUp(6.0, 15.0), 1e-4
    for t in (3.0, 14.9, 15.0, 20.0):
        q, qd, qdd = law(t)
        before, after = law(t - step), law(t + step)
        assert qd == pytest.approx((after[0] - before[0]) / (2 * step), abs=1e-6)
        assert qdd == pytest.approx((after[1] - before[1]) / (2 * step), abs=1e-3)
        assert q > 0.0
    assert law(3.0)[1] == pytest.approx(0.4 * (3.0 - 7.5 / np.pi * np.sin(0.4 * np.pi)))


def test_start_may_be_in_static_equilibrium(arm: dn.Robot) -> None:
    scenario = made(arm, start={'joints': [0.2, 0.1], 'amplitudes': 'static'}, duration=1.0)
    np.testing.assert_allclose(scenario.q0, arm.static_deflection([0.2, 0.1]))
    given = made(
        arm,
        start={'joints': {'joint_2': 0.3}, 'rates': [1, 2], 'amplitudes': {'link_1/y2': 0.01}},
        duration=1.0,
    )
    np.testing.assert_allclose(given.q0, [0.0, 0.0, 0.01, 0.3])
    np.testing.assert_allclose(given.qd0[arm.joint_indices], [1.0, 2.0])


def test_every_finding_is_said_at_once(arm: dn.Robot) -> None:
    with pytest.raises(dn.ConfigError) as caught:
        made(
            arm,
            torque={'kind': 'step', 'values': {'elbow': 1.0, 'joint_1': 'much'}},
            start={'joints': [1.0], 'speed': 3},
            duration=-1,
            output_rate='fast',
            rtol=0,
            method='Euler',
            colour='red',
        )
    findings = '\n'.join(caught.value.findings)
    for part in (
        "the scenario's keys must be of gravity",
        "got 'colour'",
        "torque values must name some of joint_1, joint_2, got 'elbow'",
        "torque values joint_1 must be a finite number, got 'much'",
        'start joints must have 2 numbers, got 1',
        "start's keys must be of joints, rates, amplitudes, got 'speed'",
        'duration must be a number > 0, got -1',
        "output_rate must be a number > 0, got 'fast'",
        'rtol must be a number > 0, got 0',
        "method must be one of DOP853, RK45, LSODA, Radau, BDF, got 'Euler'",
    ):
        assert part in findings


@pytest.mark.parametrize(
    ('values', 'message'),
    [
        ({'torque': {'kind': 'pulse'}, 'duration': 1}, "torque's kind must be one of zero, step"),
        ({'torque': {'kind': 'zero'}, 'reference': BOOK}, 'only one of torque, reference'),
        ({'reference': {'kind': 'book'}}, 'reference: rate must be given'),
        ({'prescribed': {'elbow': {}}, 'duration': 1}, "prescribed must name some of .*'elbow'"),
        (
            {'prescribed': {'joint_1': {'kind': 'spin_up', 'rate': 1}}, 'duration': 1},
            'time > 0 s, got 1 and 0.0',
        ),
        (
            {'torque': {'kind': 'rigid_inverse_dynamics', 'reference': SLOW, 'every': 0}},
            "torque's every must be a number > 0 s, got 0",
        ),
        (
            {'torque': {'kind': 'rigid_inverse_dynamics', 'reference': SLOW, 'between': 'hold'}},
            "torque's between must come with every",
        ),
        (
            {'torque': {'kind': 'rigid_inverse_dynamics', 'reference': SLOW, 'between': 'cubic'}},
            "torque's between must be one of hold, linear, got 'cubic'",
        ),
        ({'torque': {'kind': 'zero'}}, 'duration must be given where no reference has one'),
        ({'duration': 1, 'torque': 3}, 'torque must be a mapping, got 3'),
        (
            {'duration': 1, 'start': {'amplitudes': 'statc'}},
            "start amplitudes must be zero, static or numbers by name, got 'statc'",
        ),
    ],
)
def test_bad_scenario_is_refused(arm: dn.Robot, values: dict[str, Any], message: str) -> None:
    with pytest.raises(dn.ConfigError, match=message):
        made(arm, **values)


def test_settings_of_the_model_are_read_before_there_is_one() -> None:
    model = {'beam.a.y.ei': 2, 'payload.a.com': [0.1, 0, 0]}
    settings = model_settings(
        {'gravity': [0, -9.81, 0], 'geometric_stiffness': False, 'model': model}, 'a'
    )
    assert settings.gravity == (0.0, -9.81, 0.0)
    assert not settings.geometric_stiffness
    assert settings.overrides == model
    with pytest.raises(dn.ConfigError, match=r'a: gravity must be three numbers') as caught:
        model_settings(
            {'gravity': [1, 2], 'geometric_stiffness': 'no', 'model': {'beam.a.y.ei': []}}, 'a'
        )
    assert len(caught.value.findings) == 3


def test_plant_of_a_scenario_is_described_once_more() -> None:
    text = planar_chain(CANADARM)
    plain = model_settings({}, '').load(text)
    same = model_settings({'plant': {'modes': 2, 'shape': 'clamped-free'}}, '').load(text)
    assert same.coordinate_names == plain.coordinate_names
    rich = model_settings({'plant': {'segments': 4}, 'model': {'beam.link_1.y.ei': 2e5}}, '').load(
        text, {'beam.link_2.y.ei': 3e5}
    )
    assert [body.beam.y.stiffness for body in rich.tree.bodies if body.beam and body.beam.y] == (
        [2e5] * 4 + [3e5] * 4
    )
    with pytest.raises(dn.ConfigError, match=r'a: plant.s keys must be of modes, shape, segments'):
        model_settings({'plant': {'ei': 2}}, 'a')


def test_documentation_has_every_key_and_its_example_works(repository: Path) -> None:
    text = (repository / 'docs' / 'scenarios.md').read_text()
    rows = [line.split('`')[1] for line in text.splitlines() if line.startswith('| `')]
    assert tuple(rows) == KEYS
    example = yaml.safe_load(text.split('```yaml')[1].split('```')[0])
    robot = dn.load_robot(
        planar_chain(CANADARM_RIGID), gravity=model_settings(example, '').gravity
    )
    assert len(made(robot, **example).times) == 501
