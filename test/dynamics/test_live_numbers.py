"""Numbers change without the description being read again, to the same robot."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import geared_arm
import numpy as np
import pytest
from segmented_robots import spatial_text
from small_robots import ARM
from spring_oracle import elastic_robot

from denoc_ros.dynamics import robot_model
from denoc_ros.dynamics.driven.measured_side import measured_robot
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import ConfigError, DenocError, ModelError
from denoc_ros.model.numbers import Number, numbers_of, values_of, with_numbers
from denoc_ros.model.overrides import with_overrides
from denoc_ros.runtime.live_model import LiveModel

CELL = (
    '<sensor name="cell" type="load_cell" component="moment" link="fore" station="0.5" '
    'direction="z"/>'
)
ROBOTS: dict[str, Callable[[], Robot]] = {
    'arm': lambda: load_robot(ARM),
    'segments': lambda: load_robot(spatial_text()),
    'springs': lambda: load_robot(elastic_robot(3)),
    'motor side': lambda: measured_robot(load_robot(geared_arm.arm_text())),
    'link side': lambda: measured_robot(load_robot(geared_arm.arm_text('link'))),
    'loop': lambda: load_robot('config/robots/five_bar_ffff.urdf'),
    'sensors': lambda: load_robot('config/robots/canadarm_gauges.urdf'),
    'load cells': lambda: load_robot(spatial_text(more=CELL)),
}


def changes(robot: Robot, seed: int) -> Iterator[dict[str, Any]]:
    """Yield overrides: each number by itself, then all but the ratios together."""
    random = np.random.default_rng(seed)
    joined = {}
    for path, number in numbers_of(robot.tree).items():
        yield {path: other_value(robot, number, random)}
        if not path.endswith('ratio'):
            joined[path] = other_value(robot, number, random)
    yield joined


def other_value(robot: Robot, number: Number, random: np.random.Generator) -> Any:
    """Return a value near that of the robot; of a payload that of a body that can be."""
    if number.path.endswith('.inertia'):
        return [1.5, 0.1, 0.2, 2.0, 0.3, 3.0]
    if number.counts == (3,):
        return random.uniform(-0.5, 0.5, 3).tolist()
    present = float(np.ravel(number.get(robot.tree))[0])
    return (present or 0.5) * float(random.uniform(0.5, 2.0))


def read_again(robot: Robot, overrides: dict[str, Any]) -> Robot:
    tree = with_overrides(robot.tree, overrides)
    return type(robot)(tree, robot.gravity, robot.geometric_stiffness)


def require_same(found: Robot, wanted: Robot) -> None:
    for one, other in (
        (found.arrays, wanted.arrays),
        (found.arrays.link_side, wanted.arrays.link_side),
    ):
        assert (one is None) == (other is None)
        if one is not None and other is not None:
            np.testing.assert_array_equal(one.topology, other.topology)
            # the shapes' integrals may be worked out anew
            np.testing.assert_allclose(one.constants, other.constants, rtol=1e-12, atol=1e-300)
            np.testing.assert_allclose(one.diagonals, other.diagonals, rtol=1e-12)
    for sensor, same in zip(found.tree.sensors, wanted.tree.sensors, strict=True):
        np.testing.assert_allclose(sensor.row, same.row, rtol=1e-12)
    for body, again in zip(found.tree.bodies, wanted.tree.bodies, strict=True):
        if body.beam is not None and again.beam is not None:
            assert body.beam.surface == again.beam.surface
            assert body.beam.corners == again.beam.corners
    assert found.tree.warnings == wanted.tree.warnings
    assert found.tree.overrides == wanted.tree.overrides
    values, others = values_of(found.tree), values_of(wanted.tree)
    assert values.keys() == others.keys()
    for path, value in values.items():
        np.testing.assert_allclose(value, others[path], rtol=1e-11, err_msg=path)


@pytest.mark.long_cases('segments', 'springs')
@pytest.mark.parametrize('name', ROBOTS)
def test_the_robot_is_that_of_the_changed_description(name: str) -> None:
    robot = ROBOTS[name]()
    rows = list(changes(robot, 1))
    assert len(rows) > 2
    state = np.random.default_rng(2).normal(size=(3, robot.n))
    for overrides in rows:
        found, wanted = robot.with_overrides(overrides), read_again(robot, overrides)
        require_same(found, wanted)
        torque = wanted.inverse_dynamics(*state)
        np.testing.assert_allclose(found.inverse_dynamics(*state), torque, rtol=1e-9, atol=1e-9)
    again = robot.with_overrides(rows[0]).with_overrides(rows[-1])
    require_same(again, read_again(robot, {**rows[0], **rows[-1]}))


def test_the_description_is_not_read(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = load_robot(ARM)

    def read(*_: Any) -> None:
        raise AssertionError

    monkeypatch.setattr(robot_model, 'with_overrides', read)
    for overrides in changes(robot, 3):
        robot.with_overrides(overrides)
    robot.with_overrides({'damping.shoulder': 1.0, 'beam.upper_arm.y.damping': [1, 2]})


def test_payloads_and_the_motion_of_the_base_stay_and_the_first_robot_as_it_is() -> None:
    robot = load_robot(ARM)
    robot.set_payload('forearm', 2.0, (0.1, 0.0, 0.2))
    robot.move_base((np.arange(6.0), np.ones(6)))
    zero = np.zeros(robot.n)
    before, diagonals = robot.inverse_dynamics(zero, zero, zero), robot.diagonals()
    damped = robot.with_overrides({'joint.shoulder.damping': 7.0})
    np.testing.assert_allclose(damped.inverse_dynamics(zero, zero, zero), before, rtol=1e-12)
    damped.set_payload('forearm', 0.0)
    np.testing.assert_array_equal(robot.inverse_dynamics(zero, zero, zero), before)
    np.testing.assert_array_equal(robot.diagonals(), diagonals)


@pytest.mark.parametrize(
    ('path', 'value', 'error', 'says'),
    [
        ('joint.shoulder.damping', -1.0, ModelError, 'damping of <dynamics> must be >= 0'),
        ('joint.shoulder.damping', float('nan'), ConfigError, 'damping'),
        ('joint.shoulder.friction', [1.0, 2.0], ModelError, 'friction'),
        ('joint.nowhere.damping', 1.0, ConfigError, 'must be one that the robot has'),
        ('beam.upper_arm.y.damping', [1.0, 2.0, 3.0], ModelError, 'one for each of 2 modes'),
        ('beam.upper_arm.y.damping_ratio', float('inf'), ModelError, 'damping_ratio'),
        ('beam.upper_arm.x.damping', 1.0, ConfigError, 'must be one that the robot has'),
        ('beam.upper_arm.y.damping', True, ConfigError, 'must be a number'),
    ],
)
def test_what_is_wrong_is_refused_as_before(
    path: str, value: Any, error: type[DenocError], says: str
) -> None:
    robot = load_robot(ARM)
    with pytest.raises(error, match=says):
        robot.with_overrides({path: value})


def test_what_changes_the_coordinates_and_texts_are_left_to_the_description() -> None:
    tree = load_robot(ARM).tree
    for path, value in (
        ('beam.upper_arm.y.modes', 3),
        ('beam.upper_arm.shape', 'craig-bampton'),
        ('joint.shoulder.damping', '1.0'),
    ):
        assert with_numbers(tree, {path: value, 'joint.elbow.damping': 1.0}) is None


def test_a_rotor_that_comes_or_goes_before_a_spring_is_warned_of() -> None:
    robot = load_robot(elastic_robot(3))
    name = next(name for name, joint in robot.tree.joints.items() if joint.spring)
    without = robot.with_overrides({f'joint.{name}.armature': 0.0})
    assert any('should be > 0' in warning for warning in without.tree.warnings)


def test_a_number_that_goes_and_comes_back_is_as_before() -> None:
    """Nothing of the values between is left, to the last bit."""
    robot = ROBOTS['sensors']()
    first = next(changes(robot, 4))
    known = robot.with_overrides(values_of(robot.tree))
    again = known
    for overrides in [*changes(robot, 5), first]:
        again = again.with_overrides(overrides)
    again = again.with_overrides(values_of(robot.tree))
    np.testing.assert_array_equal(again.arrays.diagonals, known.arrays.diagonals)
    np.testing.assert_array_equal(again.arrays.constants, known.arrays.constants)


def test_a_live_model_is_the_same_whatever_changed_before() -> None:
    base = load_robot(ARM)
    live = LiveModel(base)
    y = 'beam.upper_arm.y'
    for overrides in (
        {f'{y}.damping_ratio': 0.02},
        {f'{y}.damping_ratio': 0.03, f'{y}.ei': 3.0e5},
        {f'{y}.damping_ratio': 0.01, f'{y}.ei': 3.0e5, 'joint.shoulder.damping': 4.0},
        {f'{y}.damping_ratio': 0.01, f'{y}.ei': 1.0e5, 'joint.shoulder.damping': 4.0},
        {f'{y}.ei': 1.0e5, 'payload.forearm.mass': 2.0, f'{y}.damping': [3.0, 4.0]},
        {'joint.shoulder.damping': 5.0},
        {},
    ):
        fresh = LiveModel(base)
        require_same(live.robot(overrides), fresh.robot(overrides))
        values, others = live.values(overrides), fresh.values(overrides)
        assert values.keys() == others.keys()
        for path, value in values.items():
            np.testing.assert_allclose(value, others[path], rtol=1e-11, err_msg=path)
