"""The robots that are besieged, and how each of the nodes is set up for them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from node_robots import GRAVITY, JOINTS, LINK, two_links
from trust.sieges.siege_gauges import SPOILT
from trust.sieges.siege_payload import BOUNDS, KNOWN, MIDDLE, PAYLOAD, stiff_arm

CONFIG = Path(__file__).resolve().parents[3] / 'config' / 'robots'
NODES = ('feedforward', 'predictor', 'plant', 'recorder', 'viewer')
SLOW_RATE = 100.0  # Hz of predictor and plant
FED_RATE = 250.0  # Hz where all nodes and the measuring ones share two slow cores
FEED = 100.0  # Hz of joint states, and of the clock of simulated time
READING = 0.25  # s: simulated time waits for long messages, which real time reads beside the loop
PRIORITY = 40
SENSORS = {
    '/strain': 'std_msgs/msg/Float64',
    '/loads': 'std_msgs/msg/Float64MultiArray',
    '/named': 'sensor_msgs/msg/JointState',
}
GAUGES = ('link_1_y_root', 'link_1_y_middle', 'link_2_y_root', 'link_2_y_middle')
FALLEN_SILENT = 0.2  # s without a good value of each gauge: the plan alone
# with which each siege of it begins: a dying shaper, dying gauges, an observer that is late
FEEDBACK_CASES: tuple[dict[str, Any], ...] = (
    {'do': 'kill', 'node': 'shaper', 'child': False},
    {'do': 'kill', 'node': 'shaper', 'child': True},
    {'do': 'gauges', 'node': 'feedforward', 'what': 'silent', 'seconds': 2.5},
    {'do': 'gauges', 'node': 'feedforward', 'what': 'one silent', 'seconds': 2.5},
    {'do': 'gauges', 'node': 'feedforward', 'what': 'wild', 'seconds': 2.5},
    {'do': 'gauges', 'node': 'feedforward', 'what': 'late', 'seconds': 2.5},
    {'do': 'gauges', 'node': 'feedforward', 'what': 'jumpy', 'seconds': 1.0},
    {'do': 'gauges', 'node': 'feedforward', 'what': 'lost', 'seconds': 1.0},
    {'do': 'pause', 'node': 'feedforward', 'seconds': 0.1, 'times': 3},
    {'do': 'kill', 'node': 'feedforward', 'child': True},
)
# each gauge's fault that is no failure, while the predictor fuses it
SPOILT_CASES: tuple[dict[str, Any], ...] = tuple(
    {'do': 'gauges', 'node': 'predictor', 'what': what, 'seconds': 2.5} for what in SPOILT
)
FUSING: Mapping[str, Mapping[str, Any]] = {'predictor': {'strain': 'fuse'}}
FED_BACK: Mapping[str, Mapping[str, Any]] = {
    'feedforward': {
        'feedback.state': 'lqr', 'feedback.tip_error': 0.1, 'feedback.tip_turn': 0.05,
        'feedback.joint_error': 0.05, 'feedback.integral_time': 0.5,
        'feedback.sensor_timeout': FALLEN_SILENT,
        'feedback.delay': 0.5,  # the joints of the stage are told without rates, and stand
        'max_publishers': 2,  # the shaper, and who attacks
    },
    'plant': {'update_rate': FED_RATE},  # joint states must not be much rarer than ticks
    'predictor': {'strain': 'fuse'},
    'shaper': {'method': 'zvd', 'modes': 2, 'output_step': 0.05, 'max_publishers': 2},
}  # fmt: skip
ADAPTING: Mapping[str, Mapping[str, Any]] = {
    'predictor': {PAYLOAD: KNOWN, 'adapt': [PAYLOAD], 'adapt_bounds': list(BOUNDS)},
}
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


def gauged_arm() -> str:
    """Return the planar Canadarm with strain gauges."""
    return (CONFIG / 'canadarm_gauges.urdf').read_text()


@dataclass(frozen=True)
class Scene:
    """A robot, where it stands and is asked to be (rad, m), and what its torque may be.

    With parameters of a shaper there is one between planner and feedforward.
    """

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
    gravity: tuple[float, ...] = tuple(GRAVITY)
    gauges: tuple[str, ...] = ()  # of one topic, /strain
    sensors: Mapping[str, str] = field(default_factory=lambda: SENSORS)  # topics and their types
    more: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # parameters, by node
    first: tuple[dict[str, Any], ...] = ()  # attacks before those that are drawn
    factor: float = 0.0  # simulated time over wall time; 0: by real time
    rate: float = 500.0  # Hz of the feedforward's loop

    @property
    def adapts(self) -> bool:
        """Whether the robot swings and rests, and the predictor adapts to its payload."""
        return 'adapt' in self.more.get('predictor', {})

    @property
    def feeds_back(self) -> bool:
        """Whether the feedforward has state feedback."""
        return 'feedback.state' in self.more.get('feedforward', {})

    @property
    def lull(self) -> float:
        """Return for how long torque may pause because simulated time stands [s]."""
        return 1.0 / FEED + READING if self.factor else 0.0

    @property
    def nodes(self) -> tuple[str, ...]:
        """Names of the nodes."""
        return (*NODES, 'shaper') if 'shaper' in self.more else NODES

    @property
    def plans_for(self) -> str:
        """Topic that the planner publishes on."""
        return '/shaper/input' if 'shaper' in self.more else '/reference'

    def remapped(self, node: str) -> list[str]:
        """Return the arguments that keep apart what the stage says and what the plant says."""
        if node != 'plant':
            return []
        topics = ['joint_states', *(['strain'] if self.gauges else [])]
        return [word for topic in topics for word in ('-r', f'{topic}:=plant/{topic}')]

    def parameters(self, node: str, folder: Path) -> dict[str, Any]:
        """Return a node's parameters; the robot comes from the topic."""
        robot: dict[str, Any] = {'gravity': list(self.gravity)}
        if self.assembled:
            robot['posture'] = list(self.assembled)
        moving = {**robot, 'joints': list(self.joints)}
        inputs = {'joint_state_timeout': 0.2, 'reference_timeout': 0.2}
        usual: dict[str, Any] = {
            'feedforward': {
                **moving, **inputs, 'update_rate': self.rate, 'model': self.model,
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
            'shaper': {**robot, 'update_rate': SLOW_RATE},
        }[node]  # fmt: skip
        if self.factor:
            usual['use_sim_time'] = True
        return {**usual, **self.more.get(node, {})}


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
        Scene(
            'feedback',
            gauged_arm,
            ('joint_1', 'joint_2', 'joint_3'),
            (0.20002, 0.70002, 0.50002),  # beside the goal: there is something to feed back
            (0.2, 0.7, 0.5),
            (5000.0, 5000.0, 5000.0),
            100.0,
            gravity=(0.0, 0.0, 0.0),
            gauges=GAUGES,
            sensors={'/strain': 'sensor_msgs/msg/JointState'},
            more=FED_BACK,
            rate=FED_RATE,
            first=FEEDBACK_CASES,
        ),
        Scene(
            'simulated',
            two_links,
            tuple(JOINTS),
            (0.4, -0.7),
            (0.1, 0.2),
            (60.0, 40.0),
            4.0,
            first=({'do': 'clock', 'node': 'feedforward', 'seed': 1, 'count': 50},),
            factor=1.0,
        ),
        *(
            Scene(
                name,
                gauged_arm,
                ('joint_1', 'joint_2', 'joint_3'),
                (0.2, 0.7, 0.5),
                (0.2, 0.7, 0.5),
                (5000.0, 5000.0, 5000.0),
                100.0,
                gravity=(0.0, 0.0, 0.0),
                gauges=GAUGES,
                sensors={'/strain': 'sensor_msgs/msg/JointState'},
                more=FUSING,
                first=SPOILT_CASES,
                factor=factor,
            )
            for name, factor in (('gauges', 0.0), ('simulated_gauges', 1.0))
        ),
        Scene(
            'payload',
            stiff_arm,
            tuple(JOINTS),
            MIDDLE,
            (0.1, 0.2),
            (60.0, 40.0),
            4.0,
            more=ADAPTING,
        ),
    )
}
SHOWN = ('predictor/modal_state', 'plant/true_modal_state', 'joint_states')
