"""The book's planar open chains, as URDF text and as the reference solutions' files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from data_files import DATA

from denoc_ros.types import Array


@dataclass(frozen=True)
class PlanarLink:
    """A uniform slender link along X that turns about Z; ei = 0: rigid."""

    length: float  # m
    mass: float  # kg
    ei: float = 0.0  # N m^2


SINGLE_LINK = (PlanarLink(8.0, 1.616, 336.0),)
SPINNING_BEAM = (PlanarLink(10.0, 12.0, 14000.0),)
RIGID, FLEXIBLE = PlanarLink(1.0, 5.0), PlanarLink(1.0, 5.0, 1000.0)
CANADARM = (PlanarLink(6.0, 140.0, 1e5), PlanarLink(7.0, 85.0, 2e5), PlanarLink(2.0, 95.0))
CANADARM_RIGID = tuple(PlanarLink(link.length, link.mass) for link in CANADARM)


def planar_chain(
    links: Sequence[PlanarLink],
    modes: int = 2,
    shape: str = 'clamped-free',
    damping_ratio: float = 0.0,
    sensors: str = '',
) -> str:
    """URDF text of a chain: links link_1 ..., joints joint_1 ..., all about Z of the base."""
    parts = ['<robot name="chain"><link name="base"/>']
    for number, link in enumerate(links, 1):
        inertia = link.mass * link.length**2 / 12
        parts.append(
            f'<link name="link_{number}"><inertial><origin xyz="{link.length / 2!r} 0 0"/>'
            f'<mass value="{link.mass!r}"/><inertia ixx="0" ixy="0" ixz="0" iyy="{inertia!r}"'
            f' iyz="0" izz="{inertia!r}"/></inertial></link>'
        )
        parent = f'link_{number - 1}' if number > 1 else 'base'
        offset = links[number - 2].length if number > 1 else 0.0
        parts.append(
            f'<joint name="joint_{number}" type="continuous"><parent link="{parent}"/>'
            f'<child link="link_{number}"/><origin xyz="{offset!r} 0 0"/><axis xyz="0 0 1"/>'
            '</joint>'
        )
    beams = ''.join(
        f'<beam link="link_{number}" length="{link.length!r}" shape="{shape}">'
        f'<bending direction="y" ei="{link.ei!r}" modes="{modes}"'
        f' damping_ratio="{damping_ratio!r}"/></beam>'
        for number, link in enumerate(links, 1)
        if link.ei
    )
    parts.append(f'<flexibility>{beams}{sensors}</flexibility></robot>')
    return ''.join(parts)


def reference(name: str) -> dict[str, Array]:
    """The columns of one reference solution."""
    table = np.genfromtxt(DATA / 'reference' / f'{name}.csv', delimiter=',', names=True)
    assert table.dtype.names is not None
    return {column: np.asarray(table[column]) for column in table.dtype.names}
