"""A planar arm with two elastic joints, measured on either side of their springs."""

from __future__ import annotations

ARM = """<robot name="geared"><link name="base"/>
<link name="upper"><inertial><origin xyz="0.3 0 0"/><mass value="3"/>
<inertia ixx="0.01" iyy="0.1" izz="0.1"/></inertial></link>
<link name="fore"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>
<inertia ixx="0.01" iyy="0.05" izz="0.05"/></inertial></link><link name="tool"/>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
<axis xyz="0 1 0"/><dynamics damping="1.5" friction="0.4"/>
<limit lower="-3" upper="3" effort="200" velocity="8"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/>
<origin xyz="0.6 0 0"/><axis xyz="0 1 0"/><dynamics damping="0.8" friction="0.2"/>
<limit lower="-3" upper="3" effort="200" velocity="8"/></joint>
<joint name="flange" type="fixed"><parent link="fore"/><child link="tool"/>
<origin xyz="0.4 0 0"/></joint>
<flexibility><actuator joint="shoulder" armature="0.9"/><actuator joint="elbow" armature="0.4"/>
<spring joint="shoulder" stiffness="1.2e4" damping="8" measured="{side}"/>
<spring joint="elbow" stiffness="5e3" damping="3" measured="{side}"/></flexibility></robot>"""


def arm_text(side: str = 'motor') -> str:
    """Its description."""
    return ARM.format(side=side)
