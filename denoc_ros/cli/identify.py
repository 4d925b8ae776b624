"""`denoc identify ACTION`: damping and friction from recorded motion."""

from __future__ import annotations

import argparse
import importlib
from typing import TYPE_CHECKING

from denoc_ros.cli.verbs import ACTION_MODULES, ACTIONS

if TYPE_CHECKING:
    from denoc_ros.cli.verb_result import VerbResult

DESCRIPTION = (
    'Identify modes and their damping, joint friction and frequency responses from bags (MCAP, '
    'db3) or tables (CSV, MATLAB, JSON). `denoc identify BAG` is `denoc identify modal BAG`. Exit '
    'status: 0 good, 1 bad input, 2 doubtful, 3 not identifiable.'
)


def add_actions(parser: argparse.ArgumentParser, named: str = '') -> None:
    """Declare the named action with its arguments, or all; for -h their names only."""
    actions = parser.add_subparsers(dest='action', metavar='ACTION', required=True)
    if named in ('-h', '--help'):
        for name, text in ACTIONS.items():
            actions.add_parser(name, help=text)
        return
    modules = [ACTION_MODULES[named]] if named in ACTION_MODULES else ACTION_MODULES.values()
    for module in dict.fromkeys(modules):
        for action in importlib.import_module(f'denoc_ros.{module}').DECLARED:
            one = actions.add_parser(
                action.name, help=ACTIONS[action.name], description=action.description
            )
            action.add_options(one)
            one.set_defaults(act=action.run)


def run(args: argparse.Namespace) -> VerbResult:
    """Run the action and return its result; errors are raised."""
    result: VerbResult = args.act(args)
    return result
