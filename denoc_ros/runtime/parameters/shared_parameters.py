"""Rows of the parameter table that several nodes have."""

from __future__ import annotations

from denoc_ros.runtime.loop.realtime_loop import LOAD_SHARE
from denoc_ros.settings import Kind, Parameter, parameter

# what parameter `base_motion` may be
SOURCES = ('off', 'odometry', 'odometry_accel', 'accel', 'imu')
# what a base may do at most by default: its parameter, what it is, value and unit
BASE_LIMITS = (
    ('rate', 'angular velocity', 35.0, 'rad/s'),
    ('acceleration', 'acceleration (of an accelerometer, with gravity)', 200.0, 'm/s^2'),
    ('angular_acceleration', 'angular acceleration, also between two messages', 1000.0, 'rad/s^2'),
)
EXTRA_JOINTS = parameter(
    'allow_extra_joints', False, 'accept joint states that also name joints unknown to the robot'
)
# of every node that has inputs
PUBLISHERS = parameter(
    'max_publishers',
    1,
    'largest number of publishers that may be active on an input topic; with more, all its'
    ' messages are rejected',
    '',
    1,
    100,
)


def priority_parameter(meaning: str) -> Parameter:
    """Return the row of a node whose threads may have a priority."""
    return parameter('thread_priority', 0, meaning, '', 0, 99)


# of every node
AUTOSTART = parameter(
    'autostart', True, 'configure and activate at start; false: leave it to a lifecycle manager'
)
# of every node that holds a robot's model
ROBOT = (
    parameter('urdf_path', '', 'URDF file of the robot; empty: the topic `robot_description`'),
    parameter(
        'gravity',
        [0.0, 0.0, -9.81],
        'gravity in the base frame (three numbers)',
        'm/s^2',
        kind=Kind.DOUBLES,
    ),
    parameter(
        'posture',
        Kind.DOUBLES,
        'seed positions of all joints of the tree, near which its loops are closed; empty: 0',
        'rad, m',
    ),
    parameter(
        'geometric_stiffness',
        True,
        'include the foreshortening of the beams; false: the model for slow motion',
    ),
    *(
        parameter(
            f'{family}.*',
            None,
            f'override of the model by its dotted path, such as `{example}`',
            'SI',
            live=True,
            kind=Kind.DOUBLE_OR_DOUBLES,
        )
        for family, example in (
            ('beam', 'beam.upper_arm.y.damping_ratio'),
            ('flexible', 'flexible.forearm.stiffness'),
            ('joint', 'joint.j2.damping'),
            ('payload', 'payload.tool.mass'),
            ('sensor', 'sensor.gauge.gain'),
            ('damping', 'damping.j2` (of a joint) or `damping.upper_arm.y'),
        )
    ),
)
# of every node with a real-time loop
LOOP = (
    parameter('update_rate', 1000.0, 'rate of the loop', 'Hz', 1.0, 10000.0),
    priority_parameter(
        'SCHED_FIFO priority of the loop thread and of those that receive and send messages, '
        'callbacks one below, where allowed; 0 = off'
    ),
    parameter('lock_memory', False, 'keep all pages in memory (mlockall)'),
    parameter(
        'cpu_affinity', -1, 'core to which the loop thread is pinned; -1 = any', '', -1, 1023
    ),
    parameter(
        'diagnostics.threshold.load',
        LOAD_SHARE,
        'share of a core that the loop takes, of a period after which half of its ticks end, '
        'or of the cores that all real-time threads fill: above it the loop warns, and gives '
        'up its priority until the machine carries it again',
        '',
        0.05,
        1.0,
        live=True,
    ),
    parameter(
        'diagnostics.threshold.late_share',
        0.02,
        'share of late ticks (by more than half a period) above which the loop warns',
        '',
        0.0,
        1.0,
        live=True,
    ),
)
# of every node that listens to joints and reference
INPUTS = (
    parameter(
        'joint_state_timeout',
        0.05,
        'age on the steady clock after which joint states are stale',
        's',
        maximum=10.0,
        positive=True,
        live=True,
    ),
    parameter(
        'reference_timeout',
        0.2,
        'age after which a streamed reference is stale',
        's',
        maximum=10.0,
        positive=True,
        live=True,
    ),
    PUBLISHERS,
)
# of every node that listens to the motion of the robot's base
BASE = (
    parameter(
        'base_motion',
        'off',
        'messages on `base_motion`: odometry (nav_msgs/Odometry, differentiated), '
        'odometry_accel (with geometry_msgs/AccelStamped on `base_acceleration`), accel '
        '(AccelStamped), imu '
        '(sensor_msgs/Imu); off: the base is at rest',
        choices=SOURCES,
    ),
    parameter(
        'base_motion_timeout',
        0.1,
        "age after which the base's motion is stale",
        's',
        maximum=10.0,
        positive=True,
    ),
    parameter(
        'base_motion_cutoff',
        20.0,
        "bandwidth of the low-pass filter on the base's differentiated rates",
        'Hz',
        positive=True,
    ),
    *(
        parameter(
            f'base_{what}_limit',
            most,
            f'largest {text} of the base; a message beyond that is refused',
            unit,
            positive=True,
        )
        for what, text, most, unit in BASE_LIMITS
    ),
    parameter(
        'base_imu_xyz',
        [0.0, 0.0, 0.0],
        'place of the IMU in the base frame (`base_motion: imu` only)',
        'm',
        kind=Kind.DOUBLES,
    ),
    parameter(
        'base_imu_rpy',
        [0.0, 0.0, 0.0],
        'roll, pitch and yaw of its axes there',
        'rad',
        kind=Kind.DOUBLES,
    ),
)
# of every node that refuses motions its robot cannot have
RANGES = (
    parameter(
        'position_margin',
        1.0,
        "how far a position may exceed the URDF's limits; a message beyond that is refused",
        'rad, m',
        0.0,
    ),
    parameter(
        'position_limit',
        1e6,
        'largest position of any joint, with or without limits',
        'rad, m',
        maximum=1e9,
        positive=True,
    ),
    parameter(
        'velocity_factor',
        10.0,
        "largest velocity, as a multiple of the URDF's velocity limit; 10000 for joints "
        'without a limit',
        '',
        1.0,
    ),
)
# of every node with a robot and a loop, and of those that measure it
LOOPING = (AUTOSTART, *ROBOT, *LOOP)
MEASURING = (*LOOPING, *INPUTS, *BASE, *RANGES)
