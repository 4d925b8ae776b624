"""Small robots that the node tests run on."""

from __future__ import annotations

LINK = """
<link name="{link}"><inertial><origin xyz="0.5 0 0"/><mass value="3"/>
<inertia ixx="0.001" ixy="0" ixz="0" iyy="0.251" iyz="0" izz="0.251"/></inertial></link>
<joint name="{joint}" type="revolute"><parent link="{parent}"/><child link="{link}"/>
<origin xyz="{x} 0 0"/><axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="80" velocity="9"/>
<dynamics damping="0.2" friction="0"/></joint>"""
SENSORS = """
<sensor name="gauge" type="strain_gauge" link="one" station="0.05" direction="y" surface="0.01"
 gain="2.0e-6" offset="1.0e-5" noise="1.0e-6" topic="/strain"/>
<sensor name="moment" type="load_cell" component="moment" link="two" station="0.0" direction="y"
 gain="0.5" topic="/loads" field="1"/>
<sensor name="bend" type="deflection" link="two" station="1.0" direction="y" topic="/named"
 field="tip"/>"""
# of a feedforward with state feedback
STATE_FEEDBACK = {
    'feedback.state': 'lqr',
    'feedback.tip_error': 0.1,
    'feedback.tip_turn': 0.05,
    'feedback.joint_error': 0.05,
    'feedback.integral_time': 0.5,
    # so that a machine that is busy with others takes nothing for silent
    'feedback.sensor_timeout': 0.5,
    'joint_state_timeout': 5.0,
}


def two_links() -> str:
    """Return two flexible links in a vertical plane (gravity along -y) with three sensors."""
    links = LINK.format(link='one', joint='j1', parent='base', x=0)
    links += LINK.format(link='two', joint='j2', parent='one', x=1)
    beams = ''.join(
        f'<beam link="{link}" length="1" shape="clamped-free">'
        '<bending direction="y" ei="300" modes="2" '
        'damping_ratio="0.02"/></beam>'
        for link in ('one', 'two')
    )
    return (
        f'<robot name="arm"><link name="base"/>{links}'
        f'<flexibility>{beams}{SENSORS}</flexibility></robot>'
    )


def gripper() -> str:
    """Return the two links with a finger on each side: joint `right` mimics `left` mirrored."""
    fingers = ''.join(
        f"""<link name="{side}_finger"><inertial><origin xyz="0.1 0 0"/><mass value="0.2"/>
<inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/></inertial></link>
<joint name="{side}" type="revolute"><parent link="two"/><child link="{side}_finger"/>
<origin xyz="1 {y} 0"/><axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="5" velocity="9"/>
<dynamics damping="0.05"/>{mimic}</joint>"""
        for side, y, mimic in (
            ('left', 0.05, ''),
            ('right', -0.05, '<mimic joint="left" multiplier="-1" offset="0.1"/>'),
        )
    )
    return two_links().replace('<flexibility>', f'{fingers}<flexibility>')


GRAVITY = [0.0, -9.81, 0.0]
JOINTS = ['j1', 'j2']
