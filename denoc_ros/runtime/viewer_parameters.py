"""The viewer node's parameters."""

from __future__ import annotations

from dataclasses import replace

from denoc_ros.runtime.parameters import Kind, Parameter, ParameterTable
from denoc_ros.runtime.shared_parameters import (
    lifecycle_parameters,
    publishers_parameter,
    robot_parameters,
)

TABLE = ParameterTable(
    [
        *lifecycle_parameters(),
        # the page is built for one model
        *(replace(row, live=False) for row in robot_parameters()),
        Parameter(
            'host',
            Kind.STRING,
            '127.0.0.1',
            'interface the page is served on; beyond loopback everybody who reaches it can look',
        ),
        Parameter(
            'origins',
            Kind.STRINGS,
            [],
            "host names of other web pages that may open this page's socket; this machine may",
        ),
        Parameter('port', Kind.INTEGER, 8080, 'port of the page; 0: a free one', '', 0, 65535),
        Parameter(
            'rate',
            Kind.DOUBLE,
            30.0,
            'moments drawn per second, at most; fewer where drawing takes more than `share`',
            'Hz',
            1.0,
            60.0,
        ),
        Parameter(
            'share',
            Kind.DOUBLE,
            0.25,
            'of a core that the process may take before it draws less often',
            '',
            maximum=1.0,
            positive=True,
        ),
        Parameter(
            'niceness',
            Kind.INTEGER,
            10,
            'of the whole process: the higher, the more it lets others go first',
            '',
            0,
            19,
        ),
        Parameter(
            'deflection_scale',
            Kind.DOUBLE,
            1.0,
            'what deflection is drawn larger by at first; the page has a slider',
            '',
            1.0,
            100.0,
        ),
        Parameter(
            'state_topics',
            Kind.STRINGS,
            ['predictor/modal_state', 'plant/true_modal_state', 'joint_states'],
            'topics that say where the robot is: the first that is fresh is drawn, the charts '
            'have the deflection of all',
        ),
        Parameter(
            'effort_topic',
            Kind.STRING,
            'feedforward/effort',
            'topic of the torque that is drawn; none or silent: the effort of `state_topics`',
        ),
        Parameter(
            'residual_topic',
            Kind.STRING,
            'predictor/sensor_residual',
            'topic of the measured minus predicted values that are charted; empty: none',
        ),
        Parameter(
            'timeout',
            Kind.DOUBLE,
            0.5,
            'age after which what a topic said is not drawn any more',
            's',
            maximum=60.0,
            positive=True,
        ),
        publishers_parameter(),
    ]
)
