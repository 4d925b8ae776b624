"""The plant node's parameters."""

from __future__ import annotations

import math

from denoc_ros.model.plant_description import LIMITS
from denoc_ros.model.shapes import SHAPES
from denoc_ros.runtime.parameters import ParameterTable
from denoc_ros.runtime.shared_parameters import (
    lifecycle_parameters,
    loop_parameters,
    publishers_parameter,
    range_parameters,
    robot_parameters,
)
from denoc_ros.settings import Kind, Parameter

TABLE = ParameterTable(
    [
        *lifecycle_parameters(),
        *robot_parameters(),
        *loop_parameters(),
        *range_parameters(),
        Parameter(
            'engine',
            Kind.STRING,
            'denoc',
            'what moves it: our model, or MuJoCo, where each beam is a chain of rods on sprung '
            'hinges',
            choices=('denoc', 'mujoco'),
        ),
        Parameter(
            'modes',
            Kind.INTEGER,
            0,
            'modes of each bending plane and of torsion of every beam of the plant, per segment; '
            '0: as in the description, which the other nodes have',
            minimum=0,
            maximum=LIMITS['modes'],
        ),
        Parameter(
            'shape',
            Kind.STRING,
            '',
            'shape functions of the plant in bending; empty: as in the description',
            choices=('', *SHAPES),
        ),
        Parameter(
            'segments',
            Kind.INTEGER,
            0,
            'segments of each beam of the plant; 0: as in the description; hinges of each beam in '
            'MuJoCo; 0: 16',
            minimum=0,
            maximum=LIMITS['segments'],
        ),
        Parameter(
            'scene',
            Kind.STRING,
            '',
            "MJCF file of objects in the world, which the robot's collision geometry touches, for "
            'engine `mujoco`',
        ),
        Parameter(
            'joints',
            Kind.STRINGS,
            [],
            'driven joints; empty: all but mimic joints',
        ),
        Parameter('command', Kind.STRING, 'feedforward/commands', 'topic of the commanded effort'),
        Parameter(
            'impedance_command',
            Kind.STRING,
            '',
            'topic of commands of position, velocity, gains and effort in one, such as '
            '`feedforward/impedance_commands`, in place of `command`; empty: effort alone',
        ),
        Parameter(
            'command_timeout',
            Kind.DOUBLE,
            math.inf,
            'age after which the commanded effort counts as zero; until then it is held',
            's',
            positive=True,
        ),
        Parameter(
            'brake',
            Kind.BOOL,
            True,
            'hold the joints at their start positions until the first command',
        ),
        Parameter(
            'enforce_effort_limits',
            Kind.BOOL,
            True,
            ("saturate the drives at the URDF's effort limits"),
        ),
        Parameter(
            'start',
            Kind.DOUBLES,
            [],
            'joint positions at the start; empty: 0; `~/reset` goes there',
            'rad, m',
            live=True,
        ),
        Parameter(
            'start_deflection',
            Kind.STRING,
            'static',
            'amplitudes at the start: in equilibrium, or zero',
            choices=('static', 'zero'),
        ),
        Parameter(
            'feedback.kp',
            Kind.DOUBLES,
            [0.0],
            "the robot's own joint controller, added to the commands: stiffness towards "
            '`reference`, one value or one per joint',
            'N m/rad, N/m',
            0.0,
        ),
        Parameter(
            'feedback.kd',
            Kind.DOUBLES,
            [0.0],
            "the robot's own joint controller: damping relative to the reference's velocity",
            'N m s/rad, N s/m',
            0.0,
        ),
        Parameter(
            'noise.position',
            Kind.DOUBLE,
            0.0,
            'standard deviation of measured positions',
            'rad, m',
            0.0,
        ),
        Parameter(
            'noise.velocity',
            Kind.DOUBLE,
            0.0,
            'standard deviation of measured velocities',
            'rad/s, m/s',
            0.0,
        ),
        Parameter(
            'noise.effort',
            Kind.DOUBLE,
            0.0,
            'standard deviation of measured effort',
            'N m, N',
            0.0,
        ),
        Parameter(
            'noise.sensors',
            Kind.BOOL,
            True,
            ("add the noise that the URDF's block gives for the sensors"),
        ),
        Parameter(
            'clock',
            Kind.STRING,
            'none',
            'source of time for all nodes with `use_sim_time`: `publish` tells the simulated time '
            'on /clock; `lockstep` also waits before each step until its partners have answered',
            choices=('none', 'publish', 'lockstep'),
        ),
        Parameter(
            'real_time_factor',
            Kind.DOUBLE,
            1.0,
            'simulated time over wall time with a clock of its own, at most; 0: no limit',
            '',
            0.0,
            live=True,
        ),
        Parameter(
            'pause_at',
            Kind.DOUBLE,
            math.inf,
            'simulated time at which a clock of its own stands until this is set later',
            's',
            0.0,
            live=True,
        ),
        Parameter(
            'lockstep.partners',
            Kind.STRINGS,
            [],
            'nodes whose answers each step waits for, all with `use_sim_time`',
        ),
        Parameter(
            'lockstep.timeout',
            Kind.DOUBLE,
            10.0,
            'wall time after which a partner that has answered before and is silent ends the node',
            's',
            positive=True,
        ),
        Parameter('seed', Kind.INTEGER, 0, 'seed of the noise', '', 0),
        publishers_parameter(),
    ]
)
