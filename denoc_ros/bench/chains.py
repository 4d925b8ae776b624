"""Serial chains as URDF text, the robots of the benchmark."""

from __future__ import annotations

import math

LENGTH = 0.5  # m, of every link
MASS = 2.0  # kg
EI = 2.0e4  # N m^2: some millimetres of sag over a chain of some metres
HUB_MASS = 0.5  # kg, of what is rigid at a flexible link's joint
HUB_INERTIA = 2.0e-3  # kg m^2, about any axis
GJ = 1.0e4  # N m^2
POLAR_INERTIA = 2.0e-3  # kg m
# Pinocchio has code of its own for joints about these axes: the chain is its best case
AXES = ('0 0 1', '0 1 0', '1 0 0')


def rigid_chain(n: int) -> str:
    """Return a chain of n rigid links, turned and offset in general, joints about z, y, x, z, …

    Parameters
    ----------
    n : int
        Number of joints.
    """
    parts = ['<robot name="rigid_chain"><link name="link_0"/>']
    for k in range(1, n + 1):
        turn = f'{0.4 * math.sin(k)!r} {0.3 * math.cos(2 * k)!r} {0.2 * math.sin(3 * k)!r}'
        parts.append(
            f'<link name="link_{k}"><inertial><origin xyz="0.2 0.03 -0.02"/>'
            f'<mass value="{MASS}"/><inertia ixx="0.03" ixy="0.002" ixz="-0.001" iyy="0.05" '
            'iyz="0.003" izz="0.06"/></inertial></link>'
        )
        parts.append(_joint(k, f'<origin xyz="0.3 0.05 0.1" rpy="{turn}"/>', AXES[k % 3]))
    return ''.join([*parts, '</robot>'])


def flexible_chain(n: int, y: int, z: int, torsion: int) -> str:
    """Return a chain of n flexible links, each clamped to its joint, axes z, y, z, …

    Parameters
    ----------
    n : int
        Number of links.
    y, z, torsion : int
        Modes per link: of bending in two directions and of torsion; 0 leaves it rigid.
    """
    parts = ['<robot name="flexible_chain"><link name="link_0"/>']
    mass = MASS + HUB_MASS
    centre = 0.5 * LENGTH * MASS / mass
    about_root = HUB_INERTIA + MASS * LENGTH**2 / 3
    across = about_root - mass * centre**2
    along = HUB_INERTIA + POLAR_INERTIA * LENGTH
    for k in range(1, n + 1):
        parts.append(
            f'<link name="link_{k}"><inertial><origin xyz="{centre!r} 0 0"/>'
            f'<mass value="{mass}"/><inertia ixx="{along!r}" ixy="0" ixz="0" iyy="{across!r}" '
            f'iyz="0" izz="{across!r}"/></inertial></link>'
        )
        origin = f'<origin xyz="{LENGTH if k > 1 else 0.0} 0 0"/>'
        parts.append(_joint(k, origin, AXES[k % 2]))
    parts.append('<flexibility>')
    parts += [_beam(k, y, z, torsion) for k in range(1, n + 1)]
    return ''.join([*parts, '</flexibility></robot>'])


def _joint(k: int, origin: str, axis: str) -> str:
    return (
        f'<joint name="joint_{k}" type="revolute"><parent link="link_{k - 1}"/>'
        f'<child link="link_{k}"/>{origin}<axis xyz="{axis}"/>'
        '<limit lower="-3" upper="3" effort="100" velocity="10"/></joint>'
    )


def _beam(k: int, y: int, z: int, torsion: int) -> str:
    parts = [f'<beam link="link_{k}" length="{LENGTH}" mass_per_length="{MASS / LENGTH}">']
    for direction, modes in (('y', y), ('z', z)):
        if modes:
            parts.append(f'<bending direction="{direction}" ei="{EI}" modes="{modes}"/>')
    if torsion:
        parts.append(f'<torsion gj="{GJ}" polar_inertia="{POLAR_INERTIA}" modes="{torsion}"/>')
    return ''.join([*parts, '</beam>'])
