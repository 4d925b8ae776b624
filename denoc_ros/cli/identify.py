"""`denoc identify ACTION`: damping and friction from recorded motion."""

from __future__ import annotations

import argparse
import importlib
import os
from typing import Any

# which module has an action
ACTIONS = {
    'info': 'identify_records',
    'segment': 'identify_records',
    'modal': 'identify_modal',
    'joint': 'identify_joint',
    'forced': 'identify_forced',
    'servo': 'identify_servo',
    'model': 'identify_model',
    'excite': 'identify_excite',
    'apply': 'identify_results',
    'compare': 'identify_results',
    'selftest': 'identify_selftest',
}
DEFAULT_ACTION = 'modal'


def add_parser(subparsers: Any) -> None:
    """Declare the actions and their arguments."""
    parser = subparsers.add_parser(
        'identify',
        help='identify damping and friction from recorded motion',
        description='Identify modes and their damping, joint friction and frequency responses '
        'from bags (MCAP, db3) or tables (CSV, MATLAB, JSON). `denoc identify BAG` is '
        '`denoc identify modal BAG`. Exit status: 0 good, 1 bad input, 2 doubtful, '
        '3 not identifiable.',
    )
    actions = parser.add_subparsers(dest='action', metavar='ACTION', required=True)
    for name in dict.fromkeys(ACTIONS.values()):
        importlib.import_module(f'denoc_ros.cli.{name}').add_actions(actions)


def run(args: argparse.Namespace) -> int:
    """Run the action and return the exit status; errors are raised."""
    # thousands of small solutions: threads wait for each other, on a busy machine for most of the
    # time; read when numpy is first imported
    os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
    return int(args.act(args))
