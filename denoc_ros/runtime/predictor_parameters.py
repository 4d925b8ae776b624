"""The predictor node's parameters."""

from __future__ import annotations

from denoc_ros.estimation.fusion import FusionSettings
from denoc_ros.estimation.observer_settings import SOURCES
from denoc_ros.estimation.tracker_settings import TrackerSettings
from denoc_ros.runtime.parameters import Kind, Parameter, ParameterTable
from denoc_ros.runtime.shared_parameters import (
    EXTRA_JOINTS,
    base_parameters,
    input_parameters,
    lifecycle_parameters,
    loop_parameters,
    range_parameters,
    robot_parameters,
)

FUSION = FusionSettings()
TRACKER = TrackerSettings()

TABLE = ParameterTable(
    [
        *lifecycle_parameters(),
        *robot_parameters(),
        *loop_parameters(),
        *input_parameters(),
        *base_parameters(),
        *range_parameters(),
        Parameter(
            'joints',
            Kind.STRINGS,
            [],
            'measured joints; the others stay at 0; empty: all but mimic joints',
        ),
        EXTRA_JOINTS,
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
            'effort for `source: torque` and `adapt`: measured (joint_states) or commanded '
            '(`effort_topic`)',
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
            'ignore: sensors appear only in `~/sensor_residual`; fuse: they correct the '
            'amplitudes',
            choices=('ignore', 'fuse'),
        ),
        Parameter(
            'fusion.model_error',
            Kind.DOUBLE,
            FUSION.model_error,
            "assumed error of the model's forces, as a share of the elastic forces",
            positive=True,
            live=True,
        ),
        Parameter(
            'fusion.initial_deflection',
            Kind.DOUBLE,
            FUSION.initial_deflection,
            "assumed error of a tip's deflection at the start, as a share of the beam's length",
            positive=True,
            live=True,
        ),
        Parameter(
            'fusion.gate',
            Kind.DOUBLE,
            FUSION.gate,
            'distance from the prediction, in standard deviations, beyond which a value is an '
            'outlier',
            positive=True,
            live=True,
        ),
        Parameter(
            'fusion.patience',
            Kind.DOUBLE,
            FUSION.patience,
            'time after which a sensor that gave only outliers is trusted again; inf: never',
            's',
            positive=True,
            live=True,
        ),
        Parameter(
            'fusion.timing_error',
            Kind.DOUBLE,
            FUSION.timing_error,
            "standard deviation of the error of the sensors' stamps; 0: stamps are exact",
            's',
            0.0,
            1.0,
            live=True,
        ),
        Parameter(
            'horizon',
            Kind.DOUBLE,
            0.0,
            'prediction horizon of `~/tip_deflection_predicted`; 0 = not published',
            's',
            0.0,
            2.0,
            live=True,
        ),
        Parameter(
            'horizon_steps',
            Kind.INTEGER,
            10,
            'largest number of integration steps over the horizon',
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
            'bandwidth with which measured joints correct the integrated ones of `source: torque`',
            'Hz',
            positive=True,
            live=True,
        ),
        Parameter(
            'adapt',
            Kind.STRINGS,
            [],
            'numbers of the model that are tracked by effort and sensors: dotted paths, with `*` '
            'for any text, such as `payload.tool.mass` or `beam.*.ei`; empty: off',
            live=True,
        ),
        Parameter(
            'adapt_bounds',
            Kind.DOUBLES,
            [],
            'lowest and highest value of each number of `adapt`, in its order; empty: half to one '
            'and a half of the present values',
            'SI',
            0.0,
            1e12,
            live=True,
        ),
        Parameter(
            'adapt_rate',
            Kind.DOUBLE,
            TRACKER.rate,
            'largest change of a number of `adapt` in a second, as a share of the width of its '
            'bounds',
            '1/s',
            positive=True,
            maximum=1e3,
            live=True,
        ),
        Parameter(
            'adapt_memory',
            Kind.DOUBLE,
            TRACKER.memory,
            'time of motion after which data count less by a factor e: longer is steadier, '
            'shorter follows faster',
            's',
            0.05,
            1e4,
            live=True,
        ),
        Parameter(
            'adapt_error',
            Kind.DOUBLE,
            TRACKER.model_error,
            'assumed error of the rest of the model, as a share of its torques: what it explains '
            'moves no number of `adapt`',
            '',
            1e-4,
            1.0,
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
            'rate of `~/markers` while it has subscribers; 0 = off',
            'Hz',
            0.0,
            30.0,
        ),
    ]
)
