"""`denoc warmup`: compile all kernels now, so that no first start has to."""

from __future__ import annotations

import argparse
import logging
import time
from pathlib import Path
from typing import Any

from denoc_ros.cli import kernels_ahead
from denoc_ros.cli.progress import Progress
from denoc_ros.cli.verbs import VERBS
from denoc_ros.kernels.cache import cache_folder
from denoc_ros.model.tree import Tree
from denoc_ros.model.urdf import load_tree

LOG = logging.getLogger('denoc_ros')


def add_parser(subparsers: Any) -> None:
    """Declare the verb's arguments."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        'warmup',
        help=VERBS['warmup'],
        description=(
            'Compile the kernels of all commands and nodes in two processes, and cache them for '
            'all processes of this user. Cached kernels are only loaded.'
        ),
    )
    parser.add_argument(
        'robot',
        nargs='?',
        type=Path,
        metavar='ROBOT.urdf',
        help=('leave out the kernels for kinematic loops and mimic joints if this robot has none'),
    )


def has_constraints(tree: Tree) -> bool:
    """Say whether a robot has kinematic loops or mimic joints."""
    return bool(tree.loops or tree.mimics)


def run(args: argparse.Namespace) -> int:
    """Compile and print the time it took.

    Returns
    -------
    int
        0; a bad robot is raised.
    """
    LOG.info('loading the compiler')
    loops = args.robot is None or has_constraints(load_tree(args.robot))
    wanted = kernels_ahead.all_kernels(loops)
    began = time.perf_counter()
    if kernels_ahead.missing(wanted):
        speed = kernels_ahead.measured_speed(wanted)
        left = kernels_ahead.missing(wanted)
        what = f'compiling {kernels_ahead.counted(left)}, once per version and user'
        with Progress().step(what, kernels_ahead.estimate(wanted, speed)):
            kernels_ahead.compile_all(left)
    took = time.perf_counter() - began
    said = kernels_ahead.counted(wanted)
    print(f'{said} ready after {took:.1f} s, kept in {cache_folder()}')
    return 0
