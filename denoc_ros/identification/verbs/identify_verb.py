"""`denoc identify ACTION`: damping and friction from recorded motion."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from denoc_ros.identification.verbs.actions import ACTIONS

if TYPE_CHECKING:
    from denoc_ros.cli.verb_result import VerbResult

DESCRIPTION = (
    'Identify stiffness, payload, damping, joint friction and frequency responses from runs, bags '
    '(MCAP, db3) or tables (CSV, MATLAB, JSON). `denoc identify RUN` is `denoc identify run RUN` '
    'where the recording holds the robot, else `denoc identify modal RUN`. Exit status: 0 good, 1 '
    'bad input, 2 doubtful, 3 not identifiable.'
)


def add_actions(parser: argparse.ArgumentParser, named: str = '') -> None:
    """Declare the named action with its arguments, or all; for -h their names only."""
    actions = parser.add_subparsers(dest='action', metavar='ACTION', required=True)
    if named in ('-h', '--help'):
        for name, row in ACTIONS.items():
            actions.add_parser(name, help=row.help)
        return
    from denoc_ros.identification.verbs.identify_options import action_of

    for name in [named] if named in ACTIONS else ACTIONS:
        row, action = ACTIONS[name], action_of(name)
        one = actions.add_parser(name, help=row.help, description=action.description)
        action.add_options(one)
        one.set_defaults(act=action.run)


def run(args: argparse.Namespace) -> VerbResult:
    """Run the action and return its result; errors are raised."""
    result: VerbResult = args.act(args)
    return result
