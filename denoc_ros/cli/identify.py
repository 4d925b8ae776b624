"""`denoc identify ACTION`: damping and friction from recorded motion."""

from __future__ import annotations

import argparse
import ast
import importlib
import os
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from denoc_ros.cli.verb_result import VerbResult

# thousands of small solutions: threads wait for each other, on a busy machine for most of the
# time; read when numpy is first imported
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
DESCRIPTION = (
    'Identify modes and their damping, joint friction and frequency responses from bags (MCAP, '
    'db3) or tables (CSV, MATLAB, JSON). `denoc identify BAG` is `denoc identify modal BAG`. Exit '
    'status: 0 good, 1 bad input, 2 doubtful, 3 not identifiable.'
)


HERE = Path(__file__).parent


class Declared(NamedTuple):
    """Module of an action, in denoc_ros, and its line of help."""

    module: str
    summary: str


@cache
def declared_actions() -> dict[str, Declared]:
    """Actions by name, from the sources of their modules: importing these takes a second."""
    found = {}
    for file in (*sorted(HERE.glob('identify_*.py')), HERE.with_name('studies') / 'selftest.py'):
        for node in ast.walk(ast.parse(file.read_bytes())):
            if isinstance(node, ast.Call) and getattr(node.func, 'id', '') == 'Action':
                name, summary = map(ast.literal_eval, node.args[:2])
                found[name] = Declared(f'denoc_ros.{file.parent.name}.{file.stem}', summary)
    return found


def add_actions(parser: argparse.ArgumentParser, named: str = '') -> None:
    """Declare the named action with its arguments, or all; for -h their names only."""
    known = declared_actions()
    actions = parser.add_subparsers(dest='action', metavar='ACTION', required=True)
    if named in ('-h', '--help'):
        for name, action in known.items():
            actions.add_parser(name, help=action.summary)
        return
    chosen = [known[named]] if named in known else known.values()
    for module in dict.fromkeys(each.module for each in chosen):
        for action in importlib.import_module(module).DECLARED:
            one = actions.add_parser(
                action.name, help=action.summary, description=action.description
            )
            action.add_options(one)
            one.set_defaults(act=action.run)


def run(args: argparse.Namespace) -> VerbResult:
    """Run the action and return its result; errors are raised."""
    result: VerbResult = args.act(args)
    return result
