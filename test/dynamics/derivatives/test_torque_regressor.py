"""The torque regressor: tau = regressor @ p + rest for any parameters p."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from strategies import law, random_state, robots, seeds

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import ConfigError, StateError
from denoc_ros.types import Array

Close = Callable[[Array, Array, float], None]
ROUNDING = 1e-9  # of torques whose parts are up to a thousand times as large


def override_paths(robot: Robot) -> dict[str, float]:
    """Paths of numbers that overrides can change one by one, and their present values."""
    values: dict[str, float] = {}
    for body in robot.tree.bodies:
        beam = body.beam
        if beam is not None:
            for name, field in (('y', 'ei'), ('z', 'ei'), ('torsion', 'gj')):
                part = getattr(beam, name)
                if part is not None:
                    values[f'beam.{body.name}.{name}.{field}'] = part.stiffness
                    values[f'beam.{body.name}.{name}.damping'] = 0.3
        joint = body.joint
        if joint is not None and joint.name in robot.joint_names:
            for field in ('damping', 'friction', 'armature'):
                values[f'joint.{joint.name}.{field}'] = getattr(joint, field)
        if body.name != 'base':
            values[f'payload.{body.name}.mass'] = 0.7
    return values


@law(15)
@given(text=robots(), seed=seeds)
def test_torque_is_linear_in_its_parameters(close: Close, text: str, seed: int) -> None:
    plain = load_robot(text)
    centre = np.random.default_rng(seed).uniform(-0.2, 0.2, 3)
    links = [body.name for body in plain.tree.bodies if body.name != 'base']
    held = {f'payload.{link}.com': tuple(centre) for link in links}
    values = override_paths(plain)
    start = plain.with_overrides({**held, **values})
    s, rng = random_state(plain.coordinate_names, seed), np.random.default_rng(seed)
    paths = list(values)
    before = np.array([values[path] for path in paths])
    after = before * rng.uniform(0.5, 2.0, len(paths)) + rng.uniform(0.0, 0.1, len(paths))
    changed = plain.with_overrides({**held, **dict(zip(paths, after.tolist(), strict=True))})
    regressor = start.torque_regressor(s.q, s.qd, s.qdd, paths)
    # a column does not depend on the values
    close(changed.torque_regressor(s.q, s.qd, s.qdd, paths), regressor, ROUNDING)
    was = start.inverse_dynamics(s.q, s.qd, s.qdd)
    rest = was - regressor @ before
    close(regressor @ after + rest, changed.inverse_dynamics(s.q, s.qd, s.qdd), ROUNDING)


@law(10)
@given(text=robots(), seed=seeds)
def test_ten_parameters_of_a_link_are_those_of_its_payload(
    close: Close, text: str, seed: int
) -> None:
    robot = load_robot(text)
    rng, s = np.random.default_rng(seed), random_state(robot.coordinate_names, seed)
    link = robot.tree.bodies[-1].name
    names = ['mass', 'first_moment.x', 'first_moment.y', 'first_moment.z']
    names += [f'inertia.{name}' for name in ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')]
    regressor = robot.torque_regressor(s.q, s.qd, s.qdd, [f'link.{link}.{x}' for x in names])
    mass, com = rng.uniform(0.5, 2.0), rng.uniform(-0.3, 0.3, 3)
    root = rng.uniform(-0.2, 0.2, (3, 3))
    central = np.trace(root @ root.T) * np.eye(3) - root @ root.T  # as a body can have it
    about_origin = central + mass * (com @ com * np.eye(3) - np.outer(com, com))
    p = np.concatenate([[mass], mass * com, about_origin[np.triu_indices(3)]])
    without = robot.inverse_dynamics(s.q, s.qd, s.qdd)
    robot.set_payload(link, mass, com, central)
    close(without + regressor @ p, robot.inverse_dynamics(s.q, s.qd, s.qdd), ROUNDING)
    # about its centre of mass, which is where it was set
    about = [f'payload.{link}.{x}' for x in ['mass', *names[4:]]]
    columns = robot.torque_regressor(s.q, s.qd, s.qdd, about)
    added = columns @ np.concatenate([[mass], central[np.triu_indices(3)]])
    close(without + added, robot.inverse_dynamics(s.q, s.qd, s.qdd), ROUNDING)


@pytest.fixture
def robot(repository: Path) -> Robot:
    """Beams that bend and twist, with damping ratios."""
    return load_robot(repository / 'config/robots/ssrms.urdf')


def random_rows(robot: Robot, k: int) -> Array:
    return np.random.default_rng(5).uniform(-0.3, 0.3, (3, k, robot.n))


ARM = """<robot name="arm"><link name="base"/><link name="arm"><inertial>
<origin xyz="0.6 0 0"/><mass value="{mass}"/>
<inertia ixx="0.05" ixy="0" ixz="0" iyy="{across}" iyz="0" izz="{across}"/></inertial></link>
<joint name="hub" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="1 2 -1"/>
<limit lower="-3" upper="3" effort="100" velocity="5"/></joint><flexibility>
<beam link="arm" length="1.2" mass_per_length="{density}">
<bending direction="y" ei="30" modes="2"/><bending direction="z" ei="40" modes="2"/>
<torsion gj="20" polar_inertia="0.02" modes="2"/></beam></flexibility></robot>"""


def flexible_arm(density: float) -> Robot:
    """An arm that is a beam of this mass per length and a ball at its middle."""
    rod = 1.2 * density
    across = rod * 1.2**2 / 12 + 0.05
    return load_robot(ARM.format(density=density, mass=rod + 0.3, across=across))


@pytest.mark.parametrize('path', ['mass_per_length', 'torsion.polar_inertia'])
def test_masses_of_a_beam_are_linear(path: str, close: Close) -> None:
    arm, whole = flexible_arm(2.0), f'beam.arm.{path}'
    q, qd, qdd = np.random.default_rng(5).uniform(-0.3, 0.3, (3, arm.n))
    if path == 'mass_per_length':
        before, after, changed = 2.0, 3.1, flexible_arm(3.1)
    else:
        before, after, changed = 0.02, 0.033, arm.with_overrides({whole: 0.033})
    change = changed.inverse_dynamics(q, qd, qdd) - arm.inverse_dynamics(q, qd, qdd)
    column = arm.torque_regressor(q, qd, qdd, [whole])[:, 0]
    assert np.abs(change).max() > 1e-5
    np.testing.assert_allclose(column * (after - before), change, rtol=0, atol=1e-13)
    close(changed.torque_regressor(q, qd, qdd, [whole])[:, 0], column, ROUNDING)


def test_a_ratio_of_all_modes_is_the_sum_of_each(robot: Robot, close: Close) -> None:
    q, qd, qdd = random_rows(robot, 1)[:, 0]
    body = next(b for b in robot.tree.bodies if b.beam is not None and b.beam.y)
    assert body.beam is not None
    assert body.beam.y is not None
    path, modes = f'beam.{body.name}.y.damping_ratio', body.beam.y.modes
    each = [f'{path}.{k + 1}' for k in range(modes)]
    whole, parts = (robot.torque_regressor(q, qd, qdd, p) for p in ([path], each))
    close(parts.sum(axis=1), whole[:, 0], 1e-14)
    with_other = robot.with_overrides({path: 0.02}), robot.with_overrides({path: 0.05})
    a, b = (x.inverse_dynamics(q, qd, qdd) for x in with_other)
    close(whole[:, 0] * 0.03, b - a, 1e-7)  # a difference of large torques
    short = f'damping.{body.name}.y'
    np.testing.assert_array_equal(robot.torque_regressor(q, qd, qdd, [short]), whole)


def test_rows_are_those_of_single_states(robot: Robot) -> None:
    q, qd, qdd = random_rows(robot, 5)
    joint, link = robot.joint_names[0], robot.tree.bodies[-1].name
    paths = [f'payload.{link}.mass', f'joint.{joint}.friction', f'link.{link}.inertia.ixy']
    out = np.full((5, robot.n, 3), np.nan)
    assert robot.torque_regressor(q, qd, qdd, paths, out=out) is out
    np.testing.assert_array_equal(out[3], robot.torque_regressor(q[3], qd[3], qdd[3], paths))
    with pytest.raises(StateError, match='out must be'):
        robot.torque_regressor(q, qd, qdd, paths, out=np.zeros((5, 3)))


@pytest.mark.parametrize(
    ('path', 'says'),
    [
        ('payload.{link}.com', 'must be a number in which torque is linear, got a centre of mass'),
        ('link.{link}.com', 'must be a number in which torque is linear, got a centre of mass'),
        ('beam.{beam}.y.modes', 'must be a number in which torque is linear, got the number of'),
        ('beam.{beam}.y.damping.9', "must end with a mode from 1 to 2, got '9'"),
        ('beam.{beam}.y.gj', r'must be one that the robot has \(beam\.'),
        ('payload.nothing.mass', r'must be one that the robot has \(payload\.'),
        ('payload.{link}.inertia', r'must be one that the robot has \(payload\.'),
        ('link.{link}.inertia.ixq', r'must be one that the robot has \(link\.'),
        ('joint.nothing.damping', r'must be one that the robot has \(joint\.'),
        (
            'sensor.gauge.gain',
            'must start with one of beam., flexible., joint., payload., link., damping.',
        ),
    ],
)
def test_paths_that_torque_is_not_linear_in_are_refused(
    robot: Robot, path: str, says: str
) -> None:
    beam = next(b.name for b in robot.tree.bodies if b.beam is not None)
    given_path = path.format(link=robot.tree.bodies[-1].name, beam=beam)
    zero = np.zeros(robot.n)
    with pytest.raises(ConfigError, match=says) as error:
        robot.torque_regressor(zero, zero, zero, ['joint.nothing.damping', given_path])
    assert "path 'joint.nothing.damping'" in str(error.value)  # every finding
