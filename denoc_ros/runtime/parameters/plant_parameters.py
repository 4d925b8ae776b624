"""The plant node's parameters."""

from __future__ import annotations

import math

from denoc_ros.model.beams.shapes import SHAPES
from denoc_ros.model.plant_description import LIMITS
from denoc_ros.runtime.parameters.parameter_table import ParameterTable
from denoc_ros.runtime.parameters.shared_parameters import LOOPING, PUBLISHERS, RANGES
from denoc_ros.settings import Kind, parameter

TABLE = ParameterTable(
    [
        *LOOPING,
        *RANGES,
        parameter(
            'engine',
            'denoc',
            'what moves it: our model, or MuJoCo, where each beam is a chain of rods on sprung '
            'hinges',
            choices=('denoc', 'mujoco'),
        ),
        parameter(
            'modes',
            0,
            'modes of each bending plane and of torsion of every beam of the plant, per segment; '
            '0: as in the description, which the other nodes have',
            minimum=0,
            maximum=LIMITS['modes'],
        ),
        parameter(
            'shape',
            '',
            'shape functions of the plant in bending; empty: as in the description',
            choices=('', *SHAPES),
        ),
        parameter(
            'segments',
            0,
            'segments of each beam of the plant; 0: as in the description; hinges of each beam in '
            'MuJoCo; 0: 16',
            minimum=0,
            maximum=LIMITS['segments'],
        ),
        parameter(
            'scene',
            '',
            "MJCF file of objects in the world, which the robot's collision geometry touches, for "
            'engine `mujoco`',
        ),
        parameter('joints', Kind.STRINGS, 'driven joints; empty: all but mimic joints'),
        parameter('command', 'feedforward/commands', 'topic of the commanded effort'),
        parameter(
            'impedance_command',
            '',
            'topic of commands of position, velocity, gains and effort in one, such as '
            '`feedforward/impedance_commands`, in place of `command`; empty: effort alone',
        ),
        parameter(
            'command_timeout',
            math.inf,
            'age after which the commanded effort counts as zero; until then it is held',
            's',
            positive=True,
        ),
        parameter(
            'brake', True, 'hold the joints at their start positions until the first command'
        ),
        parameter(
            'enforce_effort_limits', True, ("saturate the drives at the URDF's effort limits")
        ),
        parameter(
            'start',
            Kind.DOUBLES,
            'joint positions at the start; empty: 0; `~/reset` goes there',
            'rad, m',
            live=True,
        ),
        parameter(
            'start_deflection',
            'static',
            'amplitudes at the start: in equilibrium, or zero',
            choices=('static', 'zero'),
        ),
        parameter(
            'feedback.kp',
            [0.0],
            "the robot's own joint controller, added to the commands: stiffness towards "
            '`reference`, one value or one per joint',
            'N m/rad, N/m',
            0.0,
            kind=Kind.DOUBLES,
        ),
        parameter(
            'feedback.kd',
            [0.0],
            "the robot's own joint controller: damping relative to the reference's velocity",
            'N m s/rad, N s/m',
            0.0,
            kind=Kind.DOUBLES,
        ),
        parameter(
            'noise.position', 0.0, 'standard deviation of measured positions', 'rad, m', 0.0
        ),
        parameter(
            'noise.velocity', 0.0, 'standard deviation of measured velocities', 'rad/s, m/s', 0.0
        ),
        parameter('noise.effort', 0.0, 'standard deviation of measured effort', 'N m, N', 0.0),
        parameter(
            'noise.sensors', True, ("add the noise that the URDF's block gives for the sensors")
        ),
        parameter(
            'clock',
            'none',
            'source of time for all nodes with `use_sim_time`: `publish` tells the simulated time '
            'on /clock; `lockstep` also waits before each step until its partners have answered',
            choices=('none', 'publish', 'lockstep'),
        ),
        parameter(
            'real_time_factor',
            1.0,
            'simulated time over wall time with a clock of its own, at most; 0: no limit',
            '',
            0.0,
            live=True,
        ),
        parameter(
            'pause_at',
            math.inf,
            'simulated time at which a clock of its own stands until this is set later',
            's',
            0.0,
            live=True,
        ),
        parameter(
            'lockstep.partners',
            Kind.STRINGS,
            'nodes whose answers each step waits for, all with `use_sim_time`',
        ),
        parameter(
            'lockstep.timeout',
            10.0,
            'wall time after which a partner that has answered before and is silent ends the node',
            's',
            positive=True,
        ),
        parameter('seed', 0, 'seed of the noise', '', 0),
        PUBLISHERS,
    ]
)
