"""Parameters that the tracking of numbers adds to the predictor node."""

from __future__ import annotations

from denoc_ros.identification.tracking.tracker_settings import TrackerSettings
from denoc_ros.runtime.parameters.parameter_table import SettingsParameters
from denoc_ros.settings import Kind, parameter

TRACKER = SettingsParameters(
    TrackerSettings,
    {'rate': 'adapt_rate', 'memory': 'adapt_memory', 'model_error': 'adapt_error'},
    {'rate': (0.0, 1e3), 'memory': (0.05, 1e4), 'model_error': (1e-4, 1.0)},
)

ROWS = [
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
]
