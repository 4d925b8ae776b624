"""Robots with loops for tests: mechanisms, and random trees closed by a random loop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from strategies import random_state, seeded_robot

from denoc_ros.dynamics.robot import Robot, load_robot

Array = NDArray[np.float64]
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


def random_closed(seed: int, kind: str, links: int = 8) -> Closed:
    """A random tree, closed by a loop of a kind, in a state that is closed, deflected, moving."""
    rng = np.random.default_rng(seed)
    text = seeded_robot(seed, links)
    tree = load_robot(text)
    state = random_state(tree.coordinate_names, seed, 0.02)
    straight = state.q.copy()
    straight[tree.flexible_indices] = 0.0
    for _ in range(20):
        loop = random_loop(tree, straight, kind, 'ring', rng)
        robot = load_robot(text.replace('</flexibility>', f'{loop}</flexibility>'))
        rows = robot.closure_jacobian(straight)
        if np.linalg.matrix_rank(rows, 1e-3) == len(rows):
            q = robot.assemble(straight + 0.3 * (state.q - straight))
            return Closed(robot, q, robot.assemble_rates(q, state.qd))
    raise AssertionError(f'seed {seed} must have a {kind} loop that constrains in all its rows')
