"""The predictor node's parameters."""

from __future__ import annotations

from dataclasses import replace

from denoc_ros.estimation.fusion import FusionSettings
from denoc_ros.estimation.observer_settings import ObserverSettings
from denoc_ros.identification.tracking.tracker_settings import TrackerSettings
from denoc_ros.runtime.parameters.parameter_table import ParameterTable, SettingsParameters
from denoc_ros.runtime.parameters.shared_parameters import EXTRA_JOINTS, MEASURING
from denoc_ros.settings import Kind, declared, parameter

FUSION = SettingsParameters(
    FusionSettings,
    {name: f'fusion.{name}' for name in declared(FusionSettings)},
    {'timing_error': (0.0, 1.0)},
)
OBSERVER = SettingsParameters(
    ObserverSettings,
    {name: name for name in ('horizon', 'horizon_steps', 'cutoff', 'correction_cutoff')},
    {'horizon': (0.0, 2.0), 'horizon_steps': (1, 1000)},
)
TRACKER = SettingsParameters(
    TrackerSettings,
    {'rate': 'adapt_rate', 'memory': 'adapt_memory', 'model_error': 'adapt_error'},
    {'rate': (0.0, 1e3), 'memory': (0.05, 1e4), 'model_error': (1e-4, 1.0)},
)
SOURCE = declared(ObserverSettings)['source']

TABLE = ParameterTable(
    [
        *MEASURING,
        parameter(
            'joints',
            Kind.STRINGS,
            'measured joints; the others stay at 0; empty: all but mimic joints',
        ),
        EXTRA_JOINTS,
        replace(SOURCE, name='source'),
        parameter(
            'effort_source',
            'measured',
            'effort for `source: torque` and `adapt`: measured (joint_states) or commanded '
            '(`effort_topic`)',
            choices=('measured', 'commanded'),
        ),
        parameter('effort_topic', 'feedforward/effort', 'topic of the commanded effort'),
        parameter(
            'strain',
            'ignore',
            'ignore: sensors appear only in `~/sensor_residual`; fuse: they correct the '
            'amplitudes',
            choices=('ignore', 'fuse'),
        ),
        *FUSION.rows(),
        *OBSERVER.rows(),
        parameter(
            'adapt',
            Kind.STRINGS,
            'numbers of the model that are tracked by effort and sensors: dotted paths, with `*` '
            'for any text, such as `payload.tool.mass` or `beam.*.ei`; empty: off',
            live=True,
        ),
        parameter(
            'adapt_bounds',
            Kind.DOUBLES,
            'lowest and highest value of each number of `adapt`, in its order; empty: half to one '
            'and a half of the present values',
            'SI',
            0.0,
            1e12,
            live=True,
        ),
        *TRACKER.rows(),
        parameter(
            'tip_frame', '', 'link whose pose is `~/tip_pose`; empty: the last link of the file'
        ),
        parameter(
            'marker_rate',
            20.0,
            'rate of `~/markers` while it has subscribers; 0 = off',
            'Hz',
            0.0,
            30.0,
        ),
    ]
)
