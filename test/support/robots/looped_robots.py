"""Robots with loops for tests: mechanisms, and random trees closed by a random loop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from strategies import random_state, seeded_robot

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.types import Array

LOOPS = ('revolute', 'prismatic', 'universal', 'spherical', 'fixed')


@dataclass(frozen=True)
class Closed:
    """A robot in a closed state."""

    robot: Robot
    q: Array
    qd: Array


def numbers(values: Array) -> str:
    return ' '.join(repr(float(value)) for value in values)


def origin(pose: Array) -> str:
    rpy = Rotation.from_matrix(pose[:3, :3]).as_euler('xyz')
    return f'xyz="{numbers(pose[:3, 3])}" rpy="{numbers(rpy)}"'


def random_loop(robot: Robot, q: Array, kind: str, name: str, rng: np.random.Generator) -> str:
    """`<loop>` text between two links, closed at q, where nothing is deflected."""
    bodies = [body.name for body in robot.tree.bodies]
    parent, child = (str(rng.choice(some)) for some in (['base', *bodies[:-3]], bodies[-3:]))
    seen = np.linalg.inv(robot.frame_pose(parent, q)) @ robot.frame_pose(child, q)
    side = np.eye(4)
    side[:3, :3] = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
    side[:3, 3] = rng.uniform(-0.5, 0.5, 3)
    axis, axis2 = np.linalg.qr(rng.normal(size=(3, 2)))[0].T
    inner = f'<parent link="{parent}" {origin(seen @ side)}/>'
    inner += f'<child link="{child}" {origin(side)}/>'
    if kind in ('revolute', 'prismatic', 'universal'):
        inner += f'<axis xyz="{numbers(axis)}"/>'
    if kind == 'universal':
        inner += f'<axis2 xyz="{numbers(axis2)}"/>'
    if kind in ('revolute', 'prismatic'):
        inner += '<dynamics damping="0.3" friction="0.2"/>'
    return f'<loop name="{name}" type="{kind}">{inner}</loop>'


def random_closed(seed: int, *kinds: str, mimic: bool = False, links: int = 8) -> Closed:
    """A random tree, closed by loops of some kinds, in a state that is closed and deflected.

    With a mimic joint too if asked for; all rows count. It moves.
    """
    rng = np.random.default_rng(seed)
    text = seeded_robot(seed, links)
    tree = load_robot(text)
    state = random_state(tree.coordinate_names, seed, 0.02)
    straight = state.q.copy()
    straight[tree.flexible_indices] = 0.0
    if mimic:
        text = with_mimic(text, tree, straight)
    for k, kind in enumerate(kinds):
        text = with_loop(text, tree, straight, kind, f'ring_{k}', rng)
    robot = load_robot(text)
    q = robot.assemble(straight + 0.3 * (state.q - straight))
    return Closed(robot, q, robot.assemble_rates(q, state.qd))


def with_loop(
    text: str, tree: Robot, q: Array, kind: str, name: str, rng: np.random.Generator
) -> str:
    """A robot's text with one loop more, all rows of which count."""
    for _ in range(40):
        loop = random_loop(tree, q, kind, name, rng)
        closed = text.replace('</flexibility>', f'{loop}</flexibility>')
        rows = load_robot(closed).closure_jacobian(q)
        if np.linalg.matrix_rank(rows, 1e-3) == len(rows):
            return closed
    raise AssertionError(f'{kind} loop must be found that constrains in all its rows')


def with_mimic(text: str, tree: Robot, q: Array) -> str:
    """A robot's text whose last joint follows its first one."""
    leader, follower = tree.joint_names[0], tree.joint_names[-1]
    places = tree.joint_indices
    offset = float(q[places[-1]] - 0.7 * q[places[0]])
    start = text.index(f'<joint name="{follower}"')
    end = text.index('</joint>', start)
    constraint = f'<mimic joint="{leader}" multiplier="0.7" offset="{offset!r}"/>'
    return text[:end] + constraint + text[end:]


# lengths [m] of crank, coupler and rocker, and the distance of the pivots on the ground
LENGTHS = {'crank': 0.3, 'coupler': 0.9, 'rocker': 0.7}
GROUND = 0.8
MASSES = {'crank': 1.0, 'coupler': 2.5, 'rocker': 1.7}
# joints in order round the loop: the links on both sides and where the joint is on each
ROUND = (
    ('one', 'ground', 0.0, 'crank', 0.0),
    ('two', 'crank', 1.0, 'coupler', 0.0),
    ('three', 'coupler', 1.0, 'rocker', 1.0),
    ('four', 'ground', 1.0, 'rocker', 0.0),
)


def _bar(name: str, lengths: dict[str, float]) -> str:
    length, mass = lengths[name], MASSES[name]
    spin = mass * length**2 / 12
    return (
        f'<link name="{name}"><inertial><origin xyz="{length / 2} 0 0"/><mass value="{mass}"/>'
        f'<inertia ixx="0" ixy="0" ixz="0" iyy="{spin}" iyz="0" izz="{spin}"/></inertial></link>'
    )


def four_bar(
    cut: str,
    lengths: dict[str, float] = LENGTHS,
    ground: float = GROUND,
    dynamics: str = '',
    flexibility: str = '',
) -> Robot:
    """A rigid four-bar in the x-y plane, cut at one joint; link frames start where a bar does.

    dynamics is the text inside `<dynamics …/>` of joint three, cut or not.
    """
    spans = {**lengths, 'ground': ground}
    placed, joints, loop = {'ground': 0.0}, '', ''
    todo = [joint for joint in ROUND if joint[0] != cut]
    while todo:
        name, one, at_one, other, at_other = todo.pop(0)
        if one not in placed and other not in placed:
            todo.append((name, one, at_one, other, at_other))
            continue
        if one not in placed:
            one, at_one, other, at_other = other, at_other, one, at_one
        # a link that hangs by its end has its frame there, the bar running backwards
        placed[other] = at_other
        x = (at_one - placed[one]) * spans[one]
        resist = f'<dynamics {dynamics}/>' if name == 'three' and dynamics else ''
        joints += (
            f'<joint name="{name}" type="continuous"><parent link="{one}"/><child link="{other}"/>'
            f'<origin xyz="{x!r} 0 0"/><axis xyz="0 0 1"/>{resist}</joint>'
        )
    name, one, at_one, other, at_other = next(joint for joint in ROUND if joint[0] == cut)
    resist = f'<dynamics {dynamics}/>' if name == 'three' and dynamics else ''
    loop = (
        f'<loop name="{cut}" type="revolute">'
        f'<parent link="{one}" xyz="{(at_one - placed[one]) * spans[one]!r} 0 0"/>'
        f'<child link="{other}" xyz="{(at_other - placed[other]) * spans[other]!r} 0 0"/>'
        f'<axis xyz="0 0 1"/>{resist}</loop>'
    )
    links = '<link name="ground"/>'
    for bar in lengths:
        text = _bar(bar, lengths)
        if placed[bar] == 1.0:
            text = text.replace('xyz="', 'xyz="-')
        links += text
    block = f'<flexibility>{flexibility}{loop}</flexibility>'
    text = f'<robot name="four_bar_{cut}">{links}{joints}{block}</robot>'
    return load_robot(text, gravity=(0.0, -9.81, 0.0))


BARS = ('crank', 'coupler', 'rocker')


def turning(robot: Robot) -> Array:
    """(3, n): how the bars' angles in the plane follow from the coordinates, each from zero."""
    rows = [robot.frame_jacobian(bar, np.zeros(robot.n))[5] for bar in BARS]
    return np.array(rows)
