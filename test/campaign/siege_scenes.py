"""The robots that are besieged, and how each of the five nodes is set up for them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from node_robots import GRAVITY, JOINTS, LINK, two_links

CONFIG = Path(__file__).resolve().parents[2] / 'config' / 'robots'
NODES = ('feedforward', 'predictor', 'plant', 'recorder', 'viewer')
RATE, SLOW_RATE = 500.0, 100.0  # Hz of the feedforward's loop, and of predictor and plant
PRIORITY = 40
SLIDE = """
<link name="{link}"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial></link>
<joint name="{joint}" type="prismatic"><parent link="{parent}"/><child link="{link}"/>
<origin xyz="{x} 0 0"/><axis xyz="{axis}"/><limit lower="-3" upper="3" effort="80" velocity="9"/>
<dynamics damping="0.5"/></joint>"""


def sliding() -> str:
    """Return a robot of one revolute and two prismatic joints, rigid."""
    links = LINK.format(link='one', joint='j1', parent='base', x=0)
    links += SLIDE.format(link='two', joint='j2', parent='one', x=1, axis='1 0 0')
    links += SLIDE.format(link='three', joint='j3', parent='two', x=0.4, axis='0 1 0')
    return f'<robot name="slider"><link name="base"/>{links}</robot>'


def five_bar() -> str:
    """Return the mechanism of five bars, flexible."""
    return (CONFIG / 'five_bar_ffff.urdf').read_text()


@dataclass(frozen=True)
class Scene:
    """A robot, where it stands and is asked to be (rad, m), and what its torque may be."""

    name: str
    urdf: Callable[[], str]
    joints: tuple[str, ...]
    posture: tuple[float, ...]
    goal: tuple[float, ...]
    limits: tuple[float, ...]  # N m, N
    delta: float  # of these per tick
    model: str = 'flexible'
    assembled: tuple[float, ...] = ()  # near which the loops are closed
    source: str = 'joints'

    def parameters(self, node: str, folder: Path) -> dict[str, Any]:
        """Return a node's parameters; the robot comes from the topic."""
        robot: dict[str, Any] = {'gravity': GRAVITY}
        if self.assembled:
            robot['posture'] = list(self.assembled)
        moving = {**robot, 'joints': list(self.joints)}
        inputs = {'joint_state_timeout': 0.2, 'reference_timeout': 0.2}
        return {
            'feedforward': {
                **moving, **inputs, 'update_rate': RATE, 'model': self.model,
                'effort_limits': list(self.limits), 'max_delta_tau': self.delta,
                'ramp_time': 0.1, 'thread_priority': PRIORITY,
            },
            'predictor': {
                **moving, **inputs, 'update_rate': SLOW_RATE, 'horizon': 0.05,
                'source': self.source, 'max_publishers': 2,
            },
            'plant': {
                **moving, 'update_rate': SLOW_RATE, 'start': list(self.posture),
                'command': '/siege/commands', 'feedback.kp': [50.0], 'feedback.kd': [5.0],
                'max_publishers': 2,
            },
            'recorder': {'output': str(folder / 'bag'), 'max_bag_size': 20_000_000},
            'viewer': {
                **robot, 'port': 0, 'rate': 10.0, 'max_publishers': 2,
                'state_topics': ['siege/modal_state', *SHOWN], 'effort_topic': 'siege/effort',
                'residual_topic': 'siege/residual',
            },
        }[node]  # fmt: skip


SCENES = {
    scene.name: scene
    for scene in (
        Scene('links', two_links, tuple(JOINTS), (0.4, -0.7), (0.1, 0.2), (60.0, 40.0), 4.0),
        Scene(
            'slider',
            sliding,
            ('j1', 'j2', 'j3'),
            (0.3, 0.1, 0.1),
            (0.2, 0.2, 0.0),
            (80.0, 70.0, 60.0),
            5.0,
            source='torque',
        ),
        Scene(
            'five_bar',
            five_bar,
            ('joint_1', 'joint_3'),
            tuple(np.radians([108.0, 72.0]).tolist()),
            tuple(np.radians([106.0, 74.0]).tolist()),
            (40.0, 40.0),
            3.0,
            assembled=tuple(np.radians([108.0, -72.0, 72.0, 72.0]).tolist()),
        ),
    )
}
SHOWN = ('predictor/modal_state', 'plant/true_modal_state', 'joint_states')
REMAPPED = {'plant': ['-r', 'joint_states:=plant/joint_states']}  # else there were two robots
