"""`denoc warmup`: compile all kernels now, so that no first start has to."""

from __future__ import annotations

import argparse
import logging
import time
from pathlib import Path
from typing import Any

LOG = logging.getLogger('denoc_ros')


def add_parser(subparsers: Any) -> None:
    """Declare the verb's arguments."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        'warmup',
        help='compile the kernels that nodes and simulations need, once per version and user',
        description=(
            'Compile the kernels that nodes and simulations need, and cache them for all '
            'processes of this user. Cached kernels are only loaded.'
        ),
    )
    parser.add_argument(
        'robot',
        nargs='?',
        type=Path,
        metavar='ROBOT.urdf',
        help=(
            'compile only the kernels that this robot needs: those for kinematic loops take as'
            ' long again'
        ),
    )


def run(args: argparse.Namespace) -> int:
    """Compile and print the time it took.

    Returns
    -------
    int
        0; a bad robot is raised.
    """
    LOG.info('loading the compiler')
    from denoc_ros.dynamics.robot import load_robot
    from denoc_ros.dynamics.robot_model import CONSTRAINT_KERNELS, KERNELS
    from denoc_ros.kernels.cache import cache_folder
    from denoc_ros.kernels.compiled import ready
    from denoc_ros.kernels.correction import take_values
    from denoc_ros.kernels.joint_tracking import track_joints
    from denoc_ros.kernels.message_values import take_joint_state
    from denoc_ros.kernels.quaternion import write_quaternion
    from denoc_ros.kernels.runge_kutta import explicit_steps
    from denoc_ros.kernels.tip_deflection import tip_deflections
    from denoc_ros.kernels.torque_limits import limit_torque

    began = time.perf_counter()
    of_nodes = (
        take_values,
        take_joint_state,
        track_joints,
        tip_deflections,
        limit_torque,
        write_quaternion,
    )
    if args.robot is None:
        ready(*KERNELS, *CONSTRAINT_KERNELS, explicit_steps, *of_nodes)
    else:
        load_robot(args.robot)
        ready(*of_nodes)
    took = time.perf_counter() - began
    print(f'kernels ready after {took:.1f} s, kept in {cache_folder()}')
    return 0
