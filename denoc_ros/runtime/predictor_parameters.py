"""The predictor node's parameters."""

from __future__ import annotations

from denoc_ros.estimation.fusion import FusionSettings
from denoc_ros.estimation.observer_settings import SOURCES
from denoc_ros.runtime.parameters import Kind, Parameter, ParameterTable
from denoc_ros.runtime.shared_parameters import (
    input_parameters,
    lifecycle_parameters,
    loop_parameters,
    range_parameters,
    robot_parameters,
)

FUSION = FusionSettings()

TABLE = ParameterTable(
    [
        *lifecycle_parameters(),
        *robot_parameters(),
        *loop_parameters(),
        *input_parameters(),
        *range_parameters(),
        Parameter(
            'joints',
            Kind.STRINGS,
            [],
            'joints that are measured, the others stand still at 0; empty: all but mimic joints',
        ),
        Parameter(
            'allow_extra_joints',
            Kind.BOOL,
            False,
            'take joint states that also have joints the robot does not have',
        ),
        Parameter(
            'source',
            Kind.STRING,
            'joints',
            'joints: measured joint motion drives the amplitudes; torque: forward dynamics from '
            'the effort, joints corrected by measurement',
            choices=SOURCES,
        ),
        Parameter(
            'effort_source',
            Kind.STRING,
            'measured',
            "effort of `source: torque`: joint_states' own, or what `effort_topic` commands",
            choices=('measured', 'commanded'),
        ),
        Parameter(
            'effort_topic',
            Kind.STRING,
            'feedforward/effort',
            'topic of the commanded effort',
        ),
        Parameter(
            'strain',
            Kind.STRING,
            'ignore',
            'ignore: sensors only show in `~/sensor_residual`; fuse: they correct the amplitudes',
            choices=('ignore', 'fuse'),
        ),
        Parameter(
            'fusion.model_error',
            Kind.DOUBLE,
            FUSION.model_error,
            "how far the model's forces may be off, as a share of the elastic ones",
            positive=True,
            live=True,
        ),
        Parameter(
            'fusion.initial_deflection',
            Kind.DOUBLE,
            FUSION.initial_deflection,
            "how far a tip may be off at the start, as a share of the beam's length",
            positive=True,
            live=True,
        ),
        Parameter(
            'fusion.gate',
            Kind.DOUBLE,
            FUSION.gate,
            'standard deviations off the prediction beyond which a value is an outlier',
            positive=True,
            live=True,
        ),
        Parameter(
            'fusion.patience',
            Kind.DOUBLE,
            FUSION.patience,
            'a sensor with outliers alone for this long is believed again; inf: never',
            's',
            positive=True,
            live=True,
        ),
        Parameter(
            'fusion.timing_error',
            Kind.DOUBLE,
            FUSION.timing_error,
            "standard deviation of when sensors' values were measured; 0: stamps are exact",
            's',
            0.0,
            1.0,
            live=True,
        ),
        Parameter(
            'horizon',
            Kind.DOUBLE,
            0.0,
            'how far ahead `~/tip_deflection_predicted` is; 0 = not published',
            's',
            0.0,
            2.0,
            live=True,
        ),
        Parameter(
            'horizon_steps',
            Kind.INTEGER,
            10,
            'steps at most in which the prediction goes there',
            '',
            1,
            1000,
            live=True,
        ),
        Parameter(
            'cutoff',
            Kind.DOUBLE,
            50.0,
            'bandwidth of the filter on measured joint motion',
            'Hz',
            positive=True,
            live=True,
        ),
        Parameter(
            'correction_cutoff',
            Kind.DOUBLE,
            10.0,
            'bandwidth at which measured joints correct those of `source: torque`',
            'Hz',
            positive=True,
            live=True,
        ),
        Parameter(
            'tip_frame',
            Kind.STRING,
            '',
            'link whose pose is `~/tip_pose`; empty: the last link of the file',
        ),
        Parameter(
            'marker_rate',
            Kind.DOUBLE,
            20.0,
            'rate of `~/markers` while anybody listens; 0 = off',
            'Hz',
            0.0,
            30.0,
        ),
    ]
)
