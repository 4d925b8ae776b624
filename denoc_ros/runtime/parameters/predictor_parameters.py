"""The predictor node's parameters."""

from __future__ import annotations

from dataclasses import replace

from denoc_ros.estimation.fusion import FusionSettings
from denoc_ros.estimation.observer_settings import ObserverSettings
from denoc_ros.parts import added_rows
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
        *added_rows('predictor'),
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
