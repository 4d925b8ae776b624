"""A robot on a base that moves: the same description on six prescribed joints, or floating."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from lxml import etree

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.types import Array

ROBOTS = Path(__file__).resolve().parents[3] / 'config' / 'robots'
SLIDES = (('x', '1 0 0'), ('y', '0 1 0'), ('z', '0 0 1'))
SIX = tuple(f'base_{name}' for name in ('x', 'y', 'z', 'rz', 'ry', 'rx'))


def description(name: str) -> str:
    return (ROBOTS / f'{name}.urdf').read_text()


def root_of(text: str) -> str:
    """Name of the link that is nobody's child."""
    robot = etree.fromstring(text.encode())
    children = {str(end.get('link')) for end in robot.iter('child')}
    parsed = [str(link.get('name')) for link in robot.findall('link')]
    return next(name for name in parsed if name not in children)


def joined(text: str, added: str) -> str:
    """A description with links and joints added before all others."""
    return re.sub(r'(<robot\b[^>]*>)', lambda found: found.group(1) + added, text, count=1)


def on_six_joints(text: str) -> str:
    """The robot on three slides and three hinges between massless links."""
    kinds = [(f'base_{name}', 'prismatic', axis) for name, axis in SLIDES]
    kinds += [(f'base_r{name}', 'revolute', axis) for name, axis in SLIDES[::-1]]
    added, parent = '<link name="world_"/>', 'world_'
    for k, (name, kind, axis) in enumerate(kinds):
        child = root_of(text) if k == 5 else f'moved_{k}'
        added += '' if k == 5 else f'<link name="{child}"/>'
        added += (
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="{child}"/><axis xyz="{axis}"/>'
            '<limit lower="-9" upper="9" effort="9" velocity="9"/></joint>'
        )
        parent = child
    return joined(text, added)


def floating(text: str, inertial: str = '', origin: str = '') -> str:
    """The robot with its root link on a floating joint; `inertial` is added to that link."""
    root = root_of(text)
    if inertial:
        bare = re.compile(rf'<link name="{root}"\s*/>')
        assert bare.search(text), 'the root link must have no inertia of its own'
        text = bare.sub(f'<link name="{root}">{inertial}</link>', text)
    added = (
        '<link name="world_"/><joint name="base" type="floating"><parent link="world_"/>'
        f'<child link="{root}"/>{origin}</joint>'
    )
    return joined(text, added)


def spacecraft(mass: float = 10e3, side: float = 3.0) -> str:
    """`<inertial>` of a cube."""
    moment = mass * side**2 / 6.0
    return (
        f'<inertial><origin xyz="0.4 -0.3 0.2"/><mass value="{mass}"/><inertia ixx="{moment}" '
        f'iyy="{1.3 * moment}" izz="{0.9 * moment}" ixy="0" ixz="0" iyz="0"/></inertial>'
    )


def base_motion(carried: Robot, root: str, state: tuple[Array, Array, Array]) -> tuple[Array, ...]:
    """Twist, acceleration and pose of a root link that six joints move, in its own axes."""
    q, qd, qdd = state
    pose = carried.frame_pose(root, q)
    turn = pose[:3, :3].T
    twist, acceleration = carried.frame_motion(root, q, qd, qdd)
    return (
        np.concatenate([turn @ twist[:3], turn @ twist[3:]]),
        np.concatenate([turn @ acceleration[:3], turn @ acceleration[3:]]),
        pose,
    )


def pair(name: str, gravity: Array) -> tuple[Robot, Robot, str]:
    """A robot, the same on six joints, and the name of its root link."""
    text = description(name)
    robot, carried = load_robot(text, gravity), load_robot(on_six_joints(text), gravity)
    return robot, carried, root_of(text)


def states(robot: Robot, rng: np.random.Generator, bend: float = 0.05) -> tuple[Array, ...]:
    """Coordinates, rates and accelerations with links bent a little."""
    q, qd, qdd = rng.uniform(-1.0, 1.0, (3, robot.n))
    q[robot.flexible_indices] *= bend
    return q, qd, 3.0 * qdd
