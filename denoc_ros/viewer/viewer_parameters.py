"""The viewer node's parameters."""

from __future__ import annotations

from dataclasses import replace

from denoc_ros.runtime.parameters.parameter_table import ParameterTable
from denoc_ros.runtime.parameters.shared_parameters import AUTOSTART, PUBLISHERS, ROBOT
from denoc_ros.settings import Kind, parameter

TABLE = ParameterTable(
    [
        AUTOSTART,
        # the page is built for one model
        *(replace(row, live=False) for row in ROBOT),
        parameter(
            'host',
            '127.0.0.1',
            'interface that serves the page; beyond loopback, everybody who reaches it can watch',
        ),
        parameter(
            'origins',
            Kind.STRINGS,
            "host names of other web pages that may open this page's socket; this machine may",
        ),
        parameter('port', 8080, 'port of the page; 0: a free one', '', 0, 65535),
        parameter(
            'rate',
            30.0,
            'largest number of frames drawn per second; fewer if drawing takes more than `share`',
            'Hz',
            1.0,
            60.0,
        ),
        parameter(
            'share',
            0.25,
            'share of a core above which the process draws less often',
            '',
            maximum=1.0,
            positive=True,
        ),
        parameter(
            'niceness',
            10,
            'nice value of the process: the higher, the lower its priority',
            '',
            0,
            19,
        ),
        parameter(
            'deflection_scale',
            1.0,
            'factor that enlarges the drawn deflection at first; the page has a slider',
            '',
            1.0,
            100.0,
        ),
        parameter(
            'state_topics',
            ['predictor/modal_state', 'plant/true_modal_state', 'joint_states'],
            'topics with the state of the robot: the first fresh one is drawn, the charts show'
            ' the deflection of all',
            kind=Kind.STRINGS,
        ),
        parameter(
            'effort_topic',
            'feedforward/effort',
            'topic of the drawn torque; if empty or silent: the effort of `state_topics`',
        ),
        parameter(
            'residual_topic',
            'predictor/sensor_residual',
            'topic of the charted residuals (measured minus predicted); empty: none',
        ),
        parameter(
            'timeout',
            0.5,
            "age after which a topic's last message is no longer drawn",
            's',
            maximum=60.0,
            positive=True,
        ),
        PUBLISHERS,
    ]
)
