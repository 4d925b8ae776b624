"""Builders of small robots' descriptions for the model's tests."""

from __future__ import annotations

from denoc_ros.model.reading.urdf import load_tree
from denoc_ros.model.tree import Tree

# One of everything.
ARM = """<?xml version="1.0"?>
<robot name="arm">
  <link name="base"/>
  <link name="upper_arm">
    <inertial>
      <origin xyz="3 0 0" rpy="0 0 0"/><mass value="140"/>
      <inertia ixx="1.0" iyy="421" izz="421" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <visual><geometry><mesh filename="package://nowhere/arm.stl"/></geometry></visual>
  </link>
  <link name="forearm">
    <inertial>
      <origin xyz="1 0 0"/><mass value="10"/>
      <inertia ixx="0.1" iyy="3.5" izz="3.5" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <link name="tool">
    <inertial>
      <mass value="2"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper_arm"/><origin xyz="0 0 1" rpy="0 0 0"/>
    <axis xyz="0 0 2"/><limit effort="10" velocity="1" lower="-2" upper="2"/>
    <dynamics damping="0.1" friction="0.2"/>
  </joint>
  <joint name="elbow" type="prismatic">
    <parent link="upper_arm"/><child link="forearm"/><origin xyz="6 0 0"/><axis xyz="0 1 0"/>
    <limit effort="10" velocity="1" lower="-2" upper="2"/>
    <mimic joint="shoulder" multiplier="0.5" offset="0.1"/>
  </joint>
  <joint name="grip" type="fixed">
    <parent link="forearm"/><child link="tool"/><origin xyz="2 0 0.1"/>
  </joint>
  <flexibility>
    <beam link="upper_arm" length="6.0" shape="clamped-free">
      <origin xyz="0 0 0" rpy="0 0 0"/>
      <bending direction="y" ei="1.0e5" modes="2" damping_ratio="0.005 0.008"/>
      <bending direction="z" ei="2.0e5" modes="3" damping_ratio="0.005"/>
      <torsion gj="4.0e4" polar_inertia="0.02" modes="1" damping="0.01"/>
    </beam>
    <beam link="forearm" length="2.0" shape="clamped-free">
      <section type="tube" diameter="0.05" wall="0.004"/>
      <material e="7.0e10" g="2.6e10" density="2700"/>
      <bending direction="y" modes="2"/>
    </beam>
    <loop name="pin" type="revolute">
      <parent link="upper_arm" xyz="3 0 0.1" rpy="0 0 0"/><child link="forearm" xyz="1 0 0"/>
      <axis xyz="0 0 3"/><dynamics damping="0.1" friction="0.2"/>
    </loop>
    <loop name="cardan" type="universal">
      <parent link="base"/><child link="tool"/><axis xyz="1 0 0"/><axis2 xyz="0 1 0"/>
    </loop>
    <sensor name="gauge" type="strain_gauge" link="upper_arm" station="0.05" direction="y"
      surface="0.02" gain="2.0" offset="0.5" noise="1e-6" topic="/strain" field="3"/>
    <sensor name="cell" type="load_cell" component="shear" link="upper_arm" station="1.5"
      direction="z"/>
    <sensor name="scale" type="deflection" link="forearm" station="2" direction="y"/>
    <actuator joint="shoulder" armature="0.5"/>
  </flexibility>
</robot>
"""


ROD = (
    '<inertial><origin xyz="1 0 0"/><mass value="3"/><inertia ixx="0" iyy="1" izz="1"/></inertial>'
)
BALL = '<inertial><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1"/></inertial>'


def link(name: str, inertial: str = BALL) -> str:
    return f'<link name="{name}">{inertial}</link>'


def joint(name: str, parent: str, child: str, xyz: str = '0 0 0', kind: str = 'revolute') -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}"/><axis xyz="0 0 1"/></joint>'
    )


def robot(*parts: str) -> Tree:
    return load_tree(f'<robot name="r">{"".join(parts)}</robot>')


def beam(name: str, length: float = 2.0, inner: str = '', attributes: str = '') -> str:
    bending = inner or '<bending direction="y" ei="100" modes="2"/>'
    return f'<beam link="{name}" length="{length}" {attributes}>{bending}</beam>'


def block(*parts: str) -> str:
    return f'<flexibility>{"".join(parts)}</flexibility>'


def body_index(tree: Tree, name: str) -> int:
    return [body.name for body in tree.bodies].index(name)
