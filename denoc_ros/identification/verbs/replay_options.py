"""Options of `denoc replay` for numbers that are tracked along the recording."""

from __future__ import annotations

import argparse

from denoc_ros.cli.arguments import add_option, add_pairs, add_row, number_range, require
from denoc_ros.identification.tracking.tracked_recording import AdaptSettings
from denoc_ros.identification.tracking.tracker_parameters import TRACKER
from denoc_ros.identification.tracking.tracker_settings import TrackerSettings
from denoc_ros.settings import declared


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    group = parser.add_argument_group('tracked numbers, as `adapt` of the predictor')
    add_option(
        group,
        '--adapt PATH',
        'number of the model that is tracked over time: payload.tool.mass, beam.*.ei; repeatable',
        [],
    )
    text = 'its bounds (default: half to one and a half of its value)'
    add_pairs(group, '--adapt-bounds PATH=LOW:HIGH', text, number_range)
    rows = declared(TrackerSettings)
    for field, name in TRACKER.names.items():  # None: not given
        add_row(group, f'--{name.replace("_", "-")} X', rows[field])


def adapt_settings(args: argparse.Namespace) -> AdaptSettings:
    """Return which numbers are tracked, and how."""
    given = {field: getattr(args, name) for field, name in TRACKER.names.items()}
    given = {field: value for field, value in given.items() if value is not None}
    if (args.adapt_bounds or given) and not args.adapt:
        require(['--adapt must name what is tracked where its settings are given, got none'])
    return AdaptSettings(tuple(args.adapt), args.adapt_bounds, TrackerSettings(**given))
