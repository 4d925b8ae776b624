"""Plain robots whose links' stiffness is known in closed form."""

from __future__ import annotations

import math

import numpy as np

from denoc_ros.model.reading.poses import number_text, rpy_of
from denoc_ros.reduction.suggest.materials import MATERIALS
from denoc_ros.types import Array

ALUMINIUM = MATERIALS['aluminium']
LENGTH = 2.0
DIAMETER, WALL = 0.060, 0.002
INNER = DIAMETER - 2.0 * WALL
AREA = math.pi / 4.0 * (DIAMETER**2 - INNER**2)
MOMENT = math.pi / 64.0 * (DIAMETER**4 - INNER**4)
EI = ALUMINIUM.e * MOMENT
GJ = ALUMINIUM.g * 2.0 * MOMENT
MASS = ALUMINIUM.density * AREA * LENGTH
CYLINDER = (
    '<visual><origin xyz="{xyz}" rpy="{rpy}"/>'
    '<geometry><cylinder radius="0.03" length="2"/></geometry></visual>'
)


def axis_rotation(axis: Array) -> Array:
    """Return a rotation that takes Z to a unit axis."""
    x = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(axis, x), axis])


def inertial(mass: float, centre: Array, inertia: Array) -> str:
    """Return `<inertial>` of a mass, its centre and the inertia about it."""
    names = {
        f'i{"xyz"[i]}{"xyz"[j]}': number_text(inertia[i, j]) for i in range(3) for j in range(i, 3)
    }
    numbers = ' '.join(f'{name}="{value}"' for name, value in names.items())
    return (
        f'<inertial><origin xyz="{number_text(*centre)}"/><mass value="{mass!r}"/>'
        f'<inertia {numbers}/></inertial>'
    )


def tube_arm(
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0),
    geometry: bool = True,
    motor: float = 0.0,
    payload: float = 1.0,
    effort: float = 60.0,
    beyond: float = 0.0,
) -> str:
    """Return a robot of one 2 m aluminium tube along an axis of its link, with a tool at its tip.

    `motor` [kg] is a ball of 40 mm at the root that belongs to the link; the payload's centre is
    `beyond` [m] its tip.
    """
    along = np.array(axis) / np.linalg.norm(axis)
    rotation = axis_rotation(along)
    across = MASS * ((DIAMETER**2 + INNER**2) / 16.0 + LENGTH**2 / 12.0)
    tube = rotation @ np.diag([across, across, MASS * (DIAMETER**2 + INNER**2) / 8.0]) @ rotation.T
    middle = 0.5 * LENGTH * along
    mass = MASS + motor
    centre = MASS * middle / mass
    ball = 0.4 * motor * 0.04**2 * np.eye(3)
    inertia = tube + ball
    for part, place in ((MASS, middle), (motor, np.zeros(3))):
        arm = place - centre
        inertia = inertia + part * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    pose = {'xyz': number_text(*middle), 'rpy': number_text(*rpy_of(rotation))}
    hinge = rotation[:, 0]
    tool = inertial(payload, beyond * along, 0.001 * np.eye(3)) if payload else ''
    return (
        '<robot name="boom"><!-- kept --><link name="base"/>'
        f'<link name="boom">{inertial(mass, centre, inertia)}'
        f'{CYLINDER.format(**pose) if geometry else ""}</link><link name="tool">{tool}</link>'
        '<joint name="shoulder" type="revolute"><parent link="base"/><child link="boom"/>'
        f'<axis xyz="{number_text(*hinge)}"/>'
        f'<limit effort="{effort}" velocity="1" lower="-2" upper="2"/></joint>'
        '<joint name="wrist" type="fixed"><parent link="boom"/><child link="tool"/>'
        f'<origin xyz="{number_text(*(LENGTH * along))}"/></joint></robot>'
    )
