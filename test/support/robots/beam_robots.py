"""Uniform beams as robots, for comparison with test/support/oracles/beam_closed_forms.py."""

from __future__ import annotations

from beam_closed_forms import HubBeam

from denoc_ros.dynamics.robot import Robot, load_robot

SURFACE = 0.01  # m, of the gauge
STATION = 0.05  # of the length

TEXT = """<robot name="hub_beam"><link name="base"/><link name="arm"><inertial>
<origin xyz="{middle} 0 0"/><mass value="{mass}"/>
<inertia ixx="1e-3" ixy="0" ixz="0" iyy="{across}" iyz="0" izz="{across}"/></inertial></link>
<link name="tip"><inertial><mass value="{tip}"/>
<inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>
<joint name="hub" type="{kind}"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="100" velocity="5"/></joint>
<joint name="end" type="fixed"><parent link="arm"/><child link="tip"/>
<origin xyz="{length} 0 0"/></joint>
<flexibility><beam link="arm" length="{length}" mass_per_length="{density}" shape="{shape}">
<bending direction="y" ei="{ei}" modes="{modes}" damping_ratio="{ratio}"/></beam>
<sensor name="gauge" type="strain_gauge" link="arm" station="{station}" direction="y"
 surface="{surface}" topic="/gauge"/>{actuator}</flexibility></robot>"""


def beam_robot(
    beam: HubBeam,
    modes: int,
    kind: str = 'revolute',
    shape: str = 'clamped-free',
    ratio: float = 0,
) -> Robot:
    """A beam on a hub (or `fixed`) with so many modes, without gravity."""
    mass = beam.density * beam.length
    text = TEXT.format(
        middle=beam.length / 2, mass=mass, across=mass * beam.length**2 / 12, tip=beam.tip_mass,
        kind=kind, length=beam.length, density=beam.density, shape=shape, ei=beam.ei,
        modes=modes, ratio=ratio, station=STATION * beam.length, surface=SURFACE,
        actuator=f'<actuator joint="hub" armature="{beam.hub}"/>' if kind != 'fixed' else '',
    )  # fmt: skip
    return load_robot(text, gravity=(0, 0, 0))
