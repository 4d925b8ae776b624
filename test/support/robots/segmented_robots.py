"""Robots whose beams are divided into segments."""

from __future__ import annotations

import numpy as np

from denoc_ros.dynamics.robot import Robot, load_robot

ROD = """<link name="{name}"><inertial><origin xyz="{middle!r} 0 0"/><mass value="{mass!r}"/>
<inertia ixx="{about!r}" ixy="0" ixz="0" iyy="{across!r}" iyz="0" izz="{across!r}"/></inertial>
</link>"""
DIVIDED = 'segments="{}"'


def rod(name: str, length: float, mass: float, about: float = 0.0) -> str:
    """Return a uniform slender link along X."""
    across = mass * length**2 / 12
    return ROD.format(name=name, middle=length / 2, mass=mass, about=about, across=across)


def strip_text(segments: int, modes: int = 2, mass: float = 1.0, more: str = '') -> str:
    """Return a strip of length 1 m and EI 1 N m^2 that bends along y, clamped to the base.

    With one segment it has the Craig-Bampton shapes that segments have.
    """
    divided = f'segments="{segments}"' if segments > 1 else 'shape="craig-bampton"'
    return f"""<robot name="strip"><link name="base"/><link name="tip"/>
    {rod('strip', 1.0, mass)}
    <joint name="clamp" type="fixed"><parent link="base"/><child link="strip"/></joint>
    <joint name="end" type="fixed"><parent link="strip"/><child link="tip"/>
    <origin xyz="1 0 0"/></joint><flexibility><beam link="strip" length="1" {divided}>
    <bending direction="y" ei="1" modes="{modes}"/></beam>{more}</flexibility></robot>"""


def strip(segments: int, modes: int = 2, weight: float = 0.0) -> Robot:
    """Return a strip of 1 kg under a weight per length [N/m] against y."""
    return load_robot(strip_text(segments, modes), gravity=(0.0, -weight, 0.0))


def spatial_text(segments: int = 3, more: str = '') -> str:
    """Return an arm in space: two divided beams off their links' axes, bending and twisting.

    Children hang where two segments meet, within a segment, at the tip and, rigidly, on the side;
    the first link has a hub, the second carries a payload.
    """
    shape = DIVIDED.format(segments) if segments > 1 else 'shape="craig-bampton"'
    cosine, sine = np.cos(0.1), np.sin(0.1)  # the beam's place where two of three segments meet
    x = float(0.05 + cosine * 0.95 * 2 / 3 - sine * 0.1)
    y = float(0.1 + sine * 0.95 * 2 / 3 + cosine * 0.1)
    ball = """<inertial><origin xyz="0.02 -0.01 0.03"/><mass value="0.2"/>
    <inertia ixx="2e-3" iyy="3e-3" izz="2.5e-3" ixy="0" ixz="0" iyz="0"/></inertial>"""
    return f"""<robot name="spatial"><link name="base"/>
    <link name="upper"><inertial><origin xyz="0.3 0.05 0" rpy="0 0 0"/><mass value="2.5"/>
    <inertia ixx="0.15" iyy="0.9" izz="0.95" ixy="0.01" ixz="0" iyz="0"/></inertial></link>
    {rod('fore', 0.8, 0.5, 1e-3)}
    <link name="hand">{ball}</link><link name="side">{ball}</link><link name="arm">{ball}</link>
    <link name="middle">{ball}</link>
    <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <origin xyz="0 0 0.4" rpy="0.3 -0.2 0.5"/><axis xyz="0 1 1"/>
    <limit effort="9" velocity="9" lower="-3" upper="3"/></joint>
    <joint name="swing" type="prismatic"><parent link="upper"/><child link="side"/>
    <origin xyz="0.13 0.2 0.1" rpy="0.1 0.2 0.3"/><axis xyz="1 2 0"/>
    <limit effort="9" velocity="9" lower="-3" upper="3"/></joint>
    <joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/>
    <origin xyz="1.0 0.12 0.05" rpy="0.2 0.4 -0.3"/><axis xyz="1 0 2"/>
    <limit effort="9" velocity="9" lower="-3" upper="3"/></joint>
    <joint name="glue" type="fixed"><parent link="fore"/><child link="middle"/>
    <origin xyz="0.6 0.03 0"/></joint>
    <joint name="bracket" type="fixed"><parent link="upper"/><child link="arm"/>
    <origin xyz="{x!r} {y!r} 0" rpy="0 0.4 0"/></joint>
    <joint name="grip" type="fixed"><parent link="fore"/><child link="hand"/>
    <origin xyz="0.8 0 0.05"/></joint>
    <flexibility><beam link="upper" length="0.95" mass_per_length="0.6" {shape}>
    <origin xyz="0.05 0.1 0.02" rpy="0 0 0.1"/>
    <bending direction="y" ei="9" modes="2" damping_ratio="0.01"/>
    <bending direction="z" ei="14" modes="2"/>
    <torsion gj="5" polar_inertia="1e-3" modes="2" damping="0.01"/></beam>
    <beam link="fore" length="0.8" {shape}><bending direction="z" ei="4" modes="2"/>
    <torsion gj="2" modes="1"/></beam>{more}</flexibility></robot>"""


def cable_text(segments: int, length: float = 2.0, modes: int = 1) -> str:
    """Return a soft cable that hangs on a joint about Z at the base."""
    divided = DIVIDED.format(segments)
    return f"""<robot name="cable"><link name="base"/>{rod('cable', length, 0.4)}
    <joint name="pin" type="continuous"><parent link="base"/><child link="cable"/>
    <axis xyz="0 0 1"/></joint><flexibility><beam link="cable" length="{length!r}" {divided}>
    <bending direction="y" ei="0.02" modes="{modes}"/></beam></flexibility></robot>"""
