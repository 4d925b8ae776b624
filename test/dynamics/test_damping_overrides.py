"""Damping and friction change without the description being read again, to the same robot."""

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
from denoc_ros.dynamics.measured_side import measured_robot
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import ConfigError, DenocError, ModelError
from denoc_ros.model.damping_overrides import with_other_damping
from denoc_ros.model.override_values import override_values
from denoc_ros.model.overrides import with_overrides
from denoc_ros.runtime.live_model import LiveModel

FIELDS = ('damping', 'friction', 'damping_ratio')
ROBOTS: dict[str, Callable[[], Robot]] = {
    'arm': lambda: load_robot(ARM),
    'segments': lambda: load_robot(spatial_text()),
    'springs': lambda: load_robot(elastic_robot(3)),
    'motor side': lambda: measured_robot(load_robot(geared_arm.arm_text())),
    'link side': lambda: measured_robot(load_robot(geared_arm.arm_text('link'))),
    'loop': lambda: load_robot('config/robots/five_bar_ffff.urdf'),
}


def changes(robot: Robot, seed: int) -> Iterator[dict[str, Any]]:
    """Yield overrides: each path that damps by itself, then all but the ratios together."""
    random = np.random.default_rng(seed)
    paths = [path for path in override_values(robot.tree) if path.endswith(FIELDS)]
    joined = {}
    for path in paths:
        yield {path: float(random.uniform(0.0, 2.0))}
        if not path.endswith('ratio'):
            joined[path] = float(random.uniform(0.0, 2.0))
    yield joined


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
    assert found.tree.overrides == wanted.tree.overrides
    values, others = override_values(found.tree), override_values(wanted.tree)
    assert values.keys() == others.keys()
    for path, value in values.items():
        np.testing.assert_allclose(value, others[path], rtol=1e-11, err_msg=path)


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
    assert with_other_damping(robot.tree, {path: value}) is None
    with pytest.raises(error, match=says):
        robot.with_overrides({path: value})


def test_other_numbers_and_two_names_of_one_are_left_to_the_description() -> None:
    tree = load_robot(ARM).tree
    for overrides in (
        {'beam.upper_arm.y.ei': 1.0e5},
        {'damping.shoulder': 1.0},
        {'beam.upper_arm.y.damping': 1.0, 'beam.upper_arm.y.damping_ratio': 0.01},
        {'joint.shoulder.damping': 1.0, 'joint.shoulder.armature': 1.0},
    ):
        assert with_other_damping(tree, overrides) is None


def test_a_live_model_is_the_same_whatever_changed_before() -> None:
    base = load_robot(ARM)
    live = LiveModel(base, 'node')
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
        fresh = LiveModel(base, 'node')
        require_same(live.robot(overrides), fresh.robot(overrides))
        values, others = live.values(overrides), fresh.values(overrides)
        assert values.keys() == others.keys()
        for path, value in values.items():
            np.testing.assert_allclose(value, others[path], rtol=1e-11, err_msg=path)
